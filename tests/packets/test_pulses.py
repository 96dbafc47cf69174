"""The kernel of points against plain numpy."""

import numpy as np
import pytest

from vlp16emu.elementary import matvec
from vlp16emu.packets import DATA_PAYLOAD, SENSOR_R_MANUAL, PointFrame, layout, points_in
from vlp16emu.packets.decode import _steps_cdeg, block_since_ns, is_dual, repeats_in
from vlp16emu.sensor.beams import BEAM_TABLES, LASER_NS, SEQUENCE_NS
from vlp16emu.sensor.head import in_sensor
from vlp16emu.types import ReturnMode, SensorModel
from vlp16emu.units import HOUR_NS, US_NS


def random_packets(mode):
    """Packets with random ranges, a third of them missing, that turn across azimuth 0 and the hour."""
    random = np.random.default_rng(7)
    packets = np.zeros(40, DATA_PAYLOAD)
    blocks = packets["blocks"]
    blocks["flag"] = layout.BLOCK_FLAG
    turned = np.cumsum(random.integers(15, 45, (40, 12)), axis=None).reshape(40, 12)
    blocks["azimuth_cdeg"] = (turned + 35_000) % 36_000
    lsb = random.integers(1, 2**16, blocks["records"].shape)
    blocks["records"]["distance_lsb"] = np.where(random.random(lsb.shape) < 0.3, 0, lsb)
    blocks["records"]["reflectivity"] = random.integers(0, 256, lsb.shape)
    if mode is ReturnMode.DUAL:
        blocks["azimuth_cdeg"][:, 1::2] = blocks["azimuth_cdeg"][:, ::2]
        is_single = random.random(lsb[:, ::2].shape) < 0.5
        odd = blocks["records"][:, 1::2]
        odd[is_single] = blocks["records"][:, ::2][is_single]
    packets["timestamp_us"] = (3_599_990_000 + 1327 * np.arange(40)) % 3_600_000_000
    packets["return_mode"] = layout.RETURN_MODE_BYTE[mode]
    packets["factory"] = 0x22
    return packets


def pulse_order(fields):
    place = np.arange(layout.RECORDS_PER_PACKET)
    pairs = place.reshape(layout.BLOCKS_PER_PACKET // 2, 2, -1).swapaxes(1, 2).ravel()
    inside = np.where(is_dual(fields)[:, None], pairs, place)
    return (np.arange(len(fields))[:, None] * layout.RECORDS_PER_PACKET + inside).ravel()


def slow_points(fields, frame, keep_no_returns, keep_repeats):
    beams = BEAM_TABLES[SensorModel.VLP_16]
    records = fields["blocks"]["records"]
    order = pulse_order(fields)
    kept = np.ones(records.shape, np.bool_) if keep_no_returns else records["distance_lsb"] > 0
    if not keep_repeats:
        kept &= ~repeats_in(fields)
    source = order[kept.ravel()[order]]
    packet, slot = np.divmod(source, layout.RECORDS_PER_PACKET)
    block, record = np.divmod(slot, layout.SEQUENCES_PER_BLOCK * layout.LASERS)
    sequence, laser = np.divmod(record, layout.LASERS)
    since_block_ns = sequence * SEQUENCE_NS + laser * LASER_NS
    since_ns = block_since_ns(fields)[packet, block] + since_block_ns
    clock_ns = fields["timestamp_us"].astype(np.int64)[packet] * US_NS
    step_cdeg = _steps_cdeg(fields)[packet] * (since_block_ns / layout.BLOCK_PERIOD_NS)
    azimuth_cdeg = fields["blocks"]["azimuth_cdeg"][packet, block] + step_cdeg
    azimuth_deg = azimuth_cdeg % layout.AZIMUTH_CODES / 100
    distance_m = records["distance_lsb"].ravel()[source] * layout.DISTANCE_LSB_M
    xyz_m = in_sensor(azimuth_deg, beams.elevation_deg[laser], beams.vertical_offset_m[laser], distance_m)
    xyz_m[distance_m == 0.0] = np.nan
    if frame is PointFrame.MANUAL:
        xyz_m = matvec(SENSOR_R_MANUAL.T, xyz_m)
    last_mode = fields["return_mode"] == layout.RETURN_MODE_BYTE[ReturnMode.LAST]
    return {
        "packet": packet,
        "slot": slot,
        "since_ns": since_ns,
        "time_ns": (clock_ns + since_ns) % HOUR_NS,
        "laser": laser.astype(np.uint8),
        "ring": beams.ring.astype(np.uint8)[laser],
        "azimuth_deg": azimuth_deg,
        "distance_m": distance_m.astype(np.float32),
        "xyz_m": xyz_m.astype(np.float32),
        "reflectivity": records["reflectivity"].ravel()[source],
        "is_last": np.where(is_dual(fields)[packet], block % 2 == 0, last_mode[packet]),
    }


@pytest.mark.parametrize("frame", PointFrame)
@pytest.mark.parametrize("keeps", [(False, False), (False, True), (True, True), (True, False)])
def test_points_have_the_bytes_of_plain_numpy(frame, keeps):
    """In all return modes, and with several in one table, each column is that of numpy to the bit."""
    fields = np.concatenate([random_packets(mode) for mode in ReturnMode])
    keep_no_returns, keep_repeats = keeps
    points = points_in(fields, frame=frame, keep_no_returns=keep_no_returns, keep_repeats=keep_repeats)
    for name, column in slow_points(fields, frame, keep_no_returns, keep_repeats).items():
        found = getattr(points, name)
        assert found.dtype == column.dtype
        assert found.tobytes() == column.tobytes(), name
