"""Layout of both payloads, stated once as dtypes. All integers are little-endian.

>>> DATA_PAYLOAD.itemsize, BLOCK.itemsize, POSITION_PAYLOAD.itemsize
(1206, 100, 512)
>>> [DATA_PAYLOAD.fields[name][1] for name in ("timestamp_us", "return_mode", "factory")]
[1200, 1204, 1205]
>>> [POSITION_PAYLOAD.fields[name][1] for name in ("timestamp_us", "pps", "sentence")]
[198, 202, 206]

Source: 63-9243 Rev D, section 9.3.2 (data, p. 56, table 9-2) and section 9.3.3 (position, p. 60).
The manual counts from the start of the Ethernet frame; offsets here count from the payload, 42 less.

Also whose datagrams are whose in a capture of several sensors.
"""

from collections import Counter, defaultdict
from ipaddress import IPv4Address
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from vlp16emu.errors import InputError
from vlp16emu.packets.capture import Capture, Datagram
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import ReturnMode, SensorModel

_STRAY = 0.02
"""Less than this share of the data packets of the busiest unit is no unit but an accident."""
_NAMED = 16
"""Units listed in an error line; as many as a rig may have."""


class CapturedUnit(NamedTuple):
    """A sensor, known by its address and by the port to which it sends its data packets."""

    source: bytes
    """IPv4 address, 4 bytes."""
    data_port: int
    position_ports: tuple[int, ...]
    """To which it sends position packets; none where none were captured."""

    def __str__(self) -> str:
        return f"{IPv4Address(self.source)}:{self.data_port}"

    def owns(self, datagram: Datagram) -> bool:
        """Whether this unit has sent a datagram."""
        port = datagram.destination_port
        return datagram.source == self.source and (port == self.data_port or port in self.position_ports)


def units_in(path: Path) -> list[CapturedUnit]:
    """Find the sensors in a capture by reading all of it, in order of address, then of port.

    Of two that share an address, as behind a router, the one with the lower data port has the lower
    position port.

    Raises
    ------
    CaptureError : where the file is no capture, or is damaged
    """
    data, position = Counter[tuple[bytes, int]](), defaultdict[bytes, set[int]](set)
    with Capture(path) as capture:
        for datagram in capture:
            size = len(datagram.payload)
            if size == DATA_BYTES:
                data[datagram.source, datagram.destination_port] += 1
            elif size == POSITION_BYTES:
                position[datagram.source].add(datagram.destination_port)
    least = _STRAY * max(data.values(), default=0)
    data_ports = defaultdict[bytes, list[int]](list)
    for source, port in sorted(key for key, count in data.items() if count >= least):
        data_ports[source].append(port)
    return [
        CapturedUnit(source, port, tuple(sorted(position[source])[place :: len(ports)]))
        for source, ports in data_ports.items()
        for place, port in enumerate(ports)
    ]


def chosen_unit(path: Path, unit: str | None, *, where: str = "unit") -> CapturedUnit | None:
    """Find one sensor of a capture; None in a capture of a single one, unless it is named.

    Parameters
    ----------
    unit : its number from 1, or its address and data port, as `192.168.1.201:2368`
    where : what error lines call the choice

    Raises
    ------
    CaptureError : where the file is no capture, or is damaged
    InputError : where there is no such unit, or there are several and none is named
    """
    units = units_in(path) if path.is_file() else []  # a pipe can be read only once
    if not units or (unit is None and len(units) == 1):
        return None
    for number, known in enumerate(units, start=1):
        if unit in (str(number), str(known)):
            return known
    found = f"{len(units)} units in {path}" if unit is None else f"found {unit}"
    names = [f"{number} ({known})" for number, known in enumerate(units[:_NAMED], start=1)]
    names += [f"... {len(units)}"] if len(units) > _NAMED else []
    raise InputError(where, found, f"one of {', '.join(names)}")


LASERS = 16
"""Records of one firing sequence, in firing order. Source: 63-9243 Rev D, table 9-1, p. 53."""
SEQUENCES_PER_BLOCK = 2
"""Source: 63-9243 Rev D, section 9.3.2, p. 56."""
BLOCKS_PER_PACKET = 12
"""Source: 63-9243 Rev D, section 9.3.2, p. 56."""
RECORDS_PER_PACKET = BLOCKS_PER_PACKET * SEQUENCES_PER_BLOCK * LASERS
"""Distances in a packet."""
SEQUENCES_PER_PACKET = MappingProxyType({ReturnMode.STRONGEST: 24, ReturnMode.LAST: 24, ReturnMode.DUAL: 12})
"""In dual return two blocks share their firing sequences. Source: 63-9243 Rev D, section 9.3.2, p. 57."""

BLOCK_PERIOD_NS = SEQUENCES_PER_BLOCK * SEQUENCE_NS
"""From the azimuth of one block to that of the next, the twin block of dual return left out."""

DISTANCE_LSB_M = 0.002
"""Source: 63-9243 Rev D, section 9.3.1."""
MIN_DISTANCE_LSB = 250
"""Smallest distance code but 0, which means no return: 0.5 m on three real units with firmware 3.0."""
AZIMUTH_CODES = 36_000
"""Hundredths of a degree, 0 .. 35999. Source: 63-9243 Rev D, section 9.3.1.4."""

BLOCK_FLAG = 0xEEFF
"""Bytes FF EE in this order. Source: 63-9243 Rev D, section 9.3.2, p. 56."""
RETURN_MODE_BYTE = MappingProxyType({ReturnMode.STRONGEST: 0x37, ReturnMode.LAST: 0x38, ReturnMode.DUAL: 0x39})
"""First factory byte. Source: 63-9243 Rev D, table 9-2, p. 56."""
FACTORY_BYTE = MappingProxyType({SensorModel.VLP_16: 0x22, SensorModel.PUCK_LITE: 0x22, SensorModel.PUCK_HI_RES: 0x24})
"""Second factory byte, the product. Source: 63-9243 Rev D, table 9-2, p. 56."""

RECORD = np.dtype([("distance_lsb", "<u2"), ("reflectivity", "u1")])
"""One laser's return, 3 bytes."""
SLOT = np.dtype(
    [
        ("t_ns", "<i8"),  # UTC of the pulse
        ("echo", "u1"),  # which return it is, place on the last axis of `Returns`; `NO_ECHO` without any
        ("range_m", "<f4"),  # before errors of range and the 2 mm of the wire
        ("sensor_m", "<f4", 3),  # at that range, in the sensor at the instant of the pulse
        ("world_m", "<f8", 3),
        ("semantic", "u1"),
        ("part", "u1"),
        ("instance", "<u4"),
        ("species", "<u2"),
        ("share", "<f4"),  # of the footprint that met the surface of the return
        ("repeat", "?"),  # in dual return: of the same return as the record of the block before
    ]
)
"""Truth behind one record of a data packet."""

NO_ECHO = 255
"""Echo of a record without distance."""

BLOCK = np.dtype([("flag", "<u2"), ("azimuth_cdeg", "<u2"), ("records", RECORD, (SEQUENCES_PER_BLOCK, LASERS))])
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

SENTENCE_BYTES = 128
"""Room for the NMEA sentence, which ends with CR LF and is followed by NUL.

The VLP-16 manual gives no bound; the VLP-32C manual (63-9325) reserves 0xCE .. 0x14D.
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
