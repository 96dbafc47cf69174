"""The kernel that converts the records of data packets into points."""

import math

import numpy as np

from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.packets import layout
from vlp16emu.packets.layout import BLOCK_PERIOD_NS, BLOCKS_PER_PACKET, LASERS
from vlp16emu.sensor.beams import LASER_NS, SEQUENCE_NS
from vlp16emu.trig import cos_sin
from vlp16emu.types import F4, F8, I8, U1, ReturnMode
from vlp16emu.units import HOUR_NS, US_NS

_BLOCK_BYTES = layout.BLOCK.itemsize
_RECORD_BYTES = layout.RECORD.itemsize
_RECORDS_AT = 4  # in a block, behind flag and azimuth
_BLOCK_RECORDS = layout.SEQUENCES_PER_BLOCK * LASERS
_STAMP_AT = BLOCKS_PER_PACKET * _BLOCK_BYTES
_MODE_AT = _STAMP_AT + 4
_DUAL = layout.RETURN_MODE_BYTE[ReturnMode.DUAL]
_LAST = layout.RETURN_MODE_BYTE[ReturnMode.LAST]


@kernel
def fill_points(
    rows: U1,
    payload_at: int,
    step_cdeg: F8,
    beams: F8,
    turn: F8,
    keep_no_returns: bool,
    keep_repeats: bool,
    numbers: I8,
    codes: U1,
    azimuth_deg: F8,
    distance_m: F4,
    xyz_m: F4,
) -> int:
    """Write the columns of the points of packets in the order of their pulses, and return their number.

    Parameters
    ----------
    rows : (n, m) bytes, in each row a payload from `payload_at` on
    step_cdeg : (n,) azimuth step over two firing sequences
    beams : (4, 16) elevations in degrees, vertical offsets in metres, and two rows that are overwritten
    turn : (3, 3) rotation of the points; (0, 0) for none
    numbers : (4, k) packet, slot, and ns since its packet and past the hour of each point, to be written
    codes : (3, k) laser, reflectivity, and 1 for a last return, to be written
    azimuth_deg, distance_m, xyz_m : (k,), (k,) and (k, 3), to be written; k is 384 n
    """
    for laser in range(LASERS):
        beams[2, laser], beams[3, laser] = cos_sin(math.radians(beams[0, laser]))
    count = 0
    for p in range(len(rows)):
        row = rows[p]
        mode = row[payload_at + _MODE_AT]
        is_dual = mode == _DUAL
        stamp_us = np.int64(0)
        for i in range(4):
            stamp_us |= np.int64(row[payload_at + _STAMP_AT + i]) << (8 * i)
        for k in range(layout.RECORDS_PER_PACKET):
            block = k // _BLOCK_RECORDS
            record = k % _BLOCK_RECORDS
            if is_dual:  # two blocks are fired together
                block = block // 2 * 2 + k % 2
                record = k % (2 * _BLOCK_RECORDS) // 2
            block_at = payload_at + block * _BLOCK_BYTES
            at = block_at + _RECORDS_AT + record * _RECORD_BYTES
            lsb = np.int64(row[at]) | np.int64(row[at + 1]) << 8
            if lsb == 0 and not keep_no_returns:
                continue
            if is_dual and block % 2 == 1 and lsb > 0 and not keep_repeats:
                even = at - _BLOCK_BYTES
                if lsb == np.int64(row[even]) | np.int64(row[even + 1]) << 8:
                    continue
            laser = record % LASERS
            in_block_ns = record // LASERS * SEQUENCE_NS + laser * LASER_NS
            since_ns = (block // 2 if is_dual else block) * BLOCK_PERIOD_NS + in_block_ns
            numbers[0, count] = p
            numbers[1, count] = block * _BLOCK_RECORDS + record
            numbers[2, count] = since_ns
            numbers[3, count] = (stamp_us * US_NS + since_ns) % HOUR_NS
            codes[0, count] = laser
            codes[1, count] = row[at + 2]
            codes[2, count] = (block % 2 == 0) if is_dual else mode == _LAST
            azimuth = np.int64(row[block_at + 2]) | np.int64(row[block_at + 3]) << 8
            cdeg = azimuth + step_cdeg[p] * (in_block_ns / BLOCK_PERIOD_NS)
            if cdeg >= layout.AZIMUTH_CODES:
                cdeg -= layout.AZIMUTH_CODES
            azimuth_deg[count] = cdeg / 100
            range_m = lsb * layout.DISTANCE_LSB_M
            distance_m[count] = range_m
            _place(azimuth_deg[count], beams, laser, range_m, turn, xyz_m[count])
            count += 1
    return count


@inline_kernel
def _place(azimuth_deg: float, beams: F8, laser: int, range_m: float, turn: F8, xyz_m: F4) -> None:
    """Write a point by the formulas of `in_sensor`; NaN without return."""
    if range_m == 0.0:
        xyz_m[:] = np.nan
        return
    cosine, sine = cos_sin(math.radians(azimuth_deg))
    x_m = range_m * beams[2, laser] * cosine
    y_m = -range_m * beams[2, laser] * sine
    z_m = range_m * beams[3, laser] + beams[1, laser]
    if len(turn):
        for i in range(3):
            xyz_m[i] = turn[i, 0] * x_m + turn[i, 1] * y_m + turn[i, 2] * z_m
        return
    xyz_m[0] = x_m
    xyz_m[1] = y_m
    xyz_m[2] = z_m
