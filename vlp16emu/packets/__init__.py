"""The wire: how returns become the bytes of a VLP-16, and how those bytes are read back."""

from vlp16emu.packets.capture import Capture
from vlp16emu.packets.clock import Clock, PacketClock, UnitClock, check_stamps, packet_clock, unit_clocks
from vlp16emu.packets.data import azimuth_cdeg, data_payloads, pack_data, timestamp_us
from vlp16emu.packets.decode import (
    JUMP_NS,
    SENSOR_R_MANUAL,
    PointFrame,
    Points,
    data_fields,
    decode_data,
    decode_position,
    faults_in,
    frame_named,
    scan_starts,
)
from vlp16emu.packets.frames import FACTORY_LINK, Link
from vlp16emu.packets.imu import IMU_FRAME, decode_imu, imu_frames
from vlp16emu.packets.layout import (
    BLOCK_PERIOD_NS,
    BLOCKS_PER_PACKET,
    DATA_BYTES,
    DATA_PAYLOAD,
    DISTANCE_LSB_M,
    LASERS,
    POSITION_BYTES,
    RETURN_MODE_BYTE,
    SEQUENCES_PER_BLOCK,
    SEQUENCES_PER_PACKET,
)
from vlp16emu.packets.nmea import parse_rmc, rmc
from vlp16emu.packets.position import (
    STAMP_LEAD_NS,
    PositionRate,
    first_position_packet,
    pack_position,
    position_due_ns,
    positions_from_ns,
)
from vlp16emu.packets.reading import CaptureReader, PacketChunk, Summary, returns_in
from vlp16emu.packets.units import CapturedUnit, chosen_unit, units_in

__all__ = [
    "BLOCKS_PER_PACKET",
    "BLOCK_PERIOD_NS",
    "DATA_BYTES",
    "DATA_PAYLOAD",
    "DISTANCE_LSB_M",
    "FACTORY_LINK",
    "IMU_FRAME",
    "JUMP_NS",
    "LASERS",
    "POSITION_BYTES",
    "RETURN_MODE_BYTE",
    "SENSOR_R_MANUAL",
    "SEQUENCES_PER_BLOCK",
    "SEQUENCES_PER_PACKET",
    "STAMP_LEAD_NS",
    "Capture",
    "CaptureReader",
    "CapturedUnit",
    "Clock",
    "Link",
    "PacketChunk",
    "PacketClock",
    "PointFrame",
    "Points",
    "PositionRate",
    "Summary",
    "UnitClock",
    "azimuth_cdeg",
    "check_stamps",
    "chosen_unit",
    "data_fields",
    "data_payloads",
    "decode_data",
    "decode_imu",
    "decode_position",
    "faults_in",
    "first_position_packet",
    "frame_named",
    "imu_frames",
    "pack_data",
    "pack_position",
    "packet_clock",
    "parse_rmc",
    "position_due_ns",
    "positions_from_ns",
    "returns_in",
    "rmc",
    "scan_starts",
    "timestamp_us",
    "unit_clocks",
    "units_in",
]
