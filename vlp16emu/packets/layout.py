"""Layout of both payloads as dtypes. All integers are little-endian.

>>> DATA_PAYLOAD.itemsize, BLOCK.itemsize, POSITION_PAYLOAD.itemsize
(1206, 100, 512)
>>> [DATA_PAYLOAD.fields[name][1] for name in ("timestamp_us", "return_mode", "factory")]
[1200, 1204, 1205]
>>> [POSITION_PAYLOAD.fields[name][1] for name in ("timestamp_us", "pps", "sentence")]
[198, 202, 206]

Source: 63-9243 Rev D, section 9.3.2 (data, p. 56, table 9-2) and section 9.3.3 (position, p. 60).
The manual counts from the start of the Ethernet frame; offsets here count from the payload, 42 less.
"""

from types import MappingProxyType

import numpy as np

from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import ReturnMode, SensorModel

LASERS = 16  # Records of one firing sequence, in firing order. Source: 63-9243 Rev D, table 9-1, p. 53.
SEQUENCES_PER_BLOCK = 2  # Source: 63-9243 Rev D, section 9.3.2, p. 56.
BLOCKS_PER_PACKET = 12  # Source: 63-9243 Rev D, section 9.3.2, p. 56.
RECORDS_PER_PACKET = BLOCKS_PER_PACKET * SEQUENCES_PER_BLOCK * LASERS  # Distances in a packet
SEQUENCES_PER_PACKET = MappingProxyType({ReturnMode.STRONGEST: 24, ReturnMode.LAST: 24, ReturnMode.DUAL: 12})
"""Firing sequences per packet; in dual return two blocks share theirs. Source: 63-9243 Rev D, section 9.3.2,
p. 57."""

BLOCK_PERIOD_NS = SEQUENCES_PER_BLOCK * SEQUENCE_NS
"""Time between the azimuths of two blocks with own firing sequences."""

DISTANCE_LSB_M = 0.002  # Source: 63-9243 Rev D, section 9.3.1
MIN_DISTANCE_LSB = 250
"""Smallest nonzero distance code (0 means no return): 0.5 m on three real units with firmware 3.0."""
AZIMUTH_CODES = 36_000  # Hundredths of a degree, 0 .. 35999. Source: 63-9243 Rev D, section 9.3.1.4.

BLOCK_FLAG = 0xEEFF  # Bytes FF EE in this order. Source: 63-9243 Rev D, section 9.3.2, p. 56.
RETURN_MODE_BYTE = MappingProxyType(
    {ReturnMode.STRONGEST: 0x37, ReturnMode.LAST: 0x38, ReturnMode.DUAL: 0x39}
)
"""First factory byte. Source: 63-9243 Rev D, table 9-2, p. 56."""
FACTORY_BYTE = MappingProxyType(
    {SensorModel.VLP_16: 0x22, SensorModel.PUCK_LITE: 0x22, SensorModel.PUCK_HI_RES: 0x24}
)
"""Second factory byte, the product. Source: 63-9243 Rev D, table 9-2, p. 56."""

RECORD = np.dtype([("distance_lsb", "<u2"), ("reflectivity", "u1")])  # One laser's return, 3 bytes
BLOCK = np.dtype(
    [("flag", "<u2"), ("azimuth_cdeg", "<u2"), ("records", RECORD, (SEQUENCES_PER_BLOCK, LASERS))]
)
"""Two firing sequences, 100 bytes; the azimuth belongs to the first pulse of the first one."""
DATA_PAYLOAD = np.dtype(
    [
        ("blocks", BLOCK, (BLOCKS_PER_PACKET,)),
        ("timestamp_us", "<u4"),  # past the hour, at the first pulse of the first block
        ("return_mode", "u1"),
        ("factory", "u1"),
    ]
)
"""UDP payload of a data packet, 1206 bytes."""
DATA_BYTES = DATA_PAYLOAD.itemsize
DATA_ROW = np.dtype(
    [
        ("number", "<i8"),  # frame number in the capture, from 1, as in Wireshark
        ("arrival_ns", "<i8"),  # UTC stamp of the capture, or of sending
        ("sensor_ns", "<i8"),  # UTC of the first pulse by the sensor's clock
        ("utc_ns", "<i8"),  # UTC of the first pulse by the chosen clock
        *DATA_PAYLOAD.descr,
    ]
)
"""Row of a table of data packets: when a packet came, when it was fired, and the fields of its payload."""

SENTENCE_BYTES = 128
"""Length of the field for the NMEA sentence, which ends with CR LF and is padded with NUL.

The VLP-16 manual gives no limit; the VLP-32C manual (63-9325) reserves 0xCE .. 0x14D.
"""
POSITION_PAYLOAD = np.dtype(
    [
        # Zero on all VLP-16 captures of 2014 to 2016; firmware of 2018 reports temperatures in the last 11.
        ("unused_head", "u1", (198,)),
        ("timestamp_us", "<u4"),  # past the hour
        ("pps", "u1"),  # PpsState
        ("unused_status", "u1", (3,)),  # thermal state in firmware of 2018
        ("sentence", f"S{SENTENCE_BYTES}"),
        ("unused_tail", "u1", (178,)),
    ]
)
"""UDP payload of a position packet, 512 bytes."""
POSITION_BYTES = POSITION_PAYLOAD.itemsize
