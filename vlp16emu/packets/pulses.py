"""The kernel that converts the records of data packets into points."""

import math

import numpy as np

from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.packets import layout
from vlp16emu.packets.layout import BLOCKS_PER_PACKET
from vlp16emu.sensor.beams import BLOCK_RECORDS
from vlp16emu.trig import cos_sin
from vlp16emu.types import F4, F8, I8, U1, ReturnMode
from vlp16emu.units import HOUR_NS, US_NS

_BLOCK_BYTES = layout.BLOCK.itemsize
_RECORD_BYTES = layout.RECORD.itemsize
_RECORDS_AT = 4  # in a block, behind flag and azimuth
_STAMP_AT = BLOCKS_PER_PACKET * _BLOCK_BYTES
_MODE_AT = _STAMP_AT + 4
_DUAL = layout.RETURN_MODE_BYTE[ReturnMode.DUAL]
_LAST = layout.RETURN_MODE_BYTE[ReturnMode.LAST]


@kernel
def fill_points(
    rows: U1,
    payload_at: int,
    single: I8,
    dual: I8,
    reading_ns: int,
    lsb_m: float,
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
    single, dual : `Layout.places` of packets in single and in dual return
    reading_ns : time between two azimuth readings
    lsb_m : unit of the distance codes
    step_cdeg : (n,) azimuth step from reading to reading
    beams : (5, L) elevations in degrees, vertical offsets in metres, azimuth offsets in hundredths of a
        degree, and two rows that are overwritten
    turn : (3, 3) rotation of the points; (0, 0) for none
    numbers : (4, k) packet, slot, and ns since its packet's stamp and past the hour of each point, to be
        written
    codes : (3, k) laser, reflectivity, and 1 for a last return, to be written
    azimuth_deg, distance_m, xyz_m : (k,), (k,) and (k, 3), to be written; k is 384 n
    """
    for laser in range(beams.shape[1]):
        beams[3, laser], beams[4, laser] = cos_sin(math.radians(beams[0, laser]))
    count = 0
    for p in range(len(rows)):
        row = rows[p]
        mode = row[payload_at + _MODE_AT]
        is_dual = mode == _DUAL
        stamp_us = np.int64(0)
        for i in range(4):
            stamp_us |= np.int64(row[payload_at + _STAMP_AT + i]) << (8 * i)
        places = dual if is_dual else single
        for k in range(len(places)):
            slot = places[k, 0]
            laser = places[k, 2]
            since_ns = places[k, 3]
            is_other = places[k, 5] == 1
            block_at = payload_at + places[k, 1] * _BLOCK_BYTES
            at = block_at + _RECORDS_AT + slot % BLOCK_RECORDS * _RECORD_BYTES
            lsb = np.int64(row[at]) | np.int64(row[at + 1]) << 8
            if lsb == 0 and not keep_no_returns:
                continue
            if is_other and lsb > 0 and not keep_repeats:
                last = at - _BLOCK_BYTES
                if lsb == np.int64(row[last]) | np.int64(row[last + 1]) << 8:
                    continue
            numbers[0, count] = p
            numbers[1, count] = slot
            numbers[2, count] = since_ns
            numbers[3, count] = (stamp_us * US_NS + since_ns) % HOUR_NS
            codes[0, count] = laser
            codes[1, count] = row[at + 2]
            codes[2, count] = not is_other if is_dual else mode == _LAST
            azimuth = np.int64(row[block_at + 2]) | np.int64(row[block_at + 3]) << 8
            cdeg = azimuth + step_cdeg[p] * (places[k, 4] / reading_ns) + beams[2, laser]
            if cdeg < 0.0:
                cdeg += layout.AZIMUTH_CODES
            if cdeg >= layout.AZIMUTH_CODES:
                cdeg -= layout.AZIMUTH_CODES
            azimuth_deg[count] = cdeg / 100
            range_m = lsb * lsb_m
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
    x_m = range_m * beams[3, laser] * cosine
    y_m = -range_m * beams[3, laser] * sine
    z_m = range_m * beams[4, laser] + beams[1, laser]
    if len(turn):
        for i in range(3):
            xyz_m[i] = turn[i, 0] * x_m + turn[i, 1] * y_m + turn[i, 2] * z_m
        return
    xyz_m[0] = x_m
    xyz_m[1] = y_m
    xyz_m[2] = z_m
