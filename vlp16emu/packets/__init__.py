"""The wire format: returns to the bytes of a sensor, and back."""

from vlp16emu.packets.data import azimuth_cdeg, data_payloads, pack_data, returns_in, timestamp_us
from vlp16emu.packets.decode import (
    JUMP_NS,
    SENSOR_R_MANUAL,
    PointFrame,
    Points,
    data_fields,
    decode_data,
    decode_position,
    faults_in,
    points_in,
    scan_starts,
)
from vlp16emu.packets.frames import FACTORY_LINK, Link
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
    layout_of,
)
from vlp16emu.packets.nmea import rmc
from vlp16emu.packets.position import (
    STAMP_LEAD_NS,
    first_position_packet,
    pack_position,
    position_due_ns,
    positions_from_ns,
)
from vlp16emu.packets.table import Clock, PacketClock, PacketTable, packet_row, packet_table, utc_ns_of
