"""Which datagram of a capture is from which sensor."""

from collections import defaultdict
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import NamedTuple

from vlp16emu.errors import InputError
from vlp16emu.packets.capture import Capture, Datagram
from vlp16emu.packets.layout import BLOCK, BLOCK_FLAG, DATA_BYTES, POSITION_BYTES

_STRAY = 0.02
"""Smallest share of the data packets of the busiest unit that counts as a unit; fewer are an accident."""
_NAMED = 16
"""Units listed in an error line; as many as a rig may have."""
_FLAG = BLOCK_FLAG.to_bytes(2, "little")


class CapturedUnit(NamedTuple):
    """A sensor, known by its address and the port of its data packets; if two share these, by its MAC address too."""

    source: bytes
    """IP address, 4 bytes, or 16 of IPv6."""
    data_port: int
    position_ports: tuple[int, ...]
    """Ports of its position packets; none if none were captured."""
    mac: bytes = b""
    """6 bytes; empty if address and port are enough."""

    def __str__(self) -> str:
        return f"{ip_address(self.source)}:{self.data_port}{'@' + self.mac.hex(':') if self.mac else ''}"

    def owns(self, datagram: Datagram) -> bool:
        """Return whether this unit has sent a datagram."""
        port = datagram.destination_port
        is_ours = datagram.source == self.source and (port == self.data_port or port in self.position_ports)
        return is_ours and (not self.mac or datagram.mac == self.mac)


@dataclass(slots=True)
class _Stream:
    """Datagrams of the length of data packets, from one sender to one port."""

    first: int
    last: int = 0
    packets: int = 0
    """Those that begin as data packets of Velodyne do."""


def units_in(path: Path, *, required: bool = False) -> list[CapturedUnit]:
    """Find the sensors in a capture by reading all of it, in order of address, port and MAC address.

    Of two that share an address, as behind a router, the one with the lower data port has the lower
    position port.

    Raises
    ------
    CaptureError
        If the file is no capture, or is damaged, or there is no sensor in it and one is required.
    """
    return _units_and_others(path, required=required)[0]


def chosen_unit(path: Path, unit: str | None, *, where: str = "unit") -> CapturedUnit | None:
    """Find one sensor of a capture; None in a capture of a single one, unless it is named or others send packets of that length.

    Parameters
    ----------
    unit : its number from 1, or its address and data port, as `192.168.1.201:2368`
    where : the option's name in error lines

    Raises
    ------
    CaptureError
        If the file is no capture, or is damaged.
    InputError
        If there is no such unit, or there are several and none is named.
    """
    units, others = ([], False) if path.is_fifo() else _units_and_others(path)  # a pipe can be read only once
    if not units or (unit is None and len(units) == 1):
        return units[0] if others and units else None
    for number, known in enumerate(units, start=1):
        if unit in (str(number), str(known)):
            return known
    found = f"{len(units)} units in {path}" if unit is None else f"found {unit}"
    names = [f"{number} ({known})" for number, known in enumerate(units[:_NAMED], start=1)]
    names += [f"... {len(units)}"] if len(units) > _NAMED else []
    raise InputError(where, found, f"one of {', '.join(names)}")


def _units_and_others(path: Path, *, required: bool = False) -> tuple[list[CapturedUnit], bool]:
    """Find the sensors, and whether somebody else sends datagrams as long as data packets."""
    streams: dict[tuple[bytes, int], dict[bytes, _Stream]] = defaultdict(dict)
    position = defaultdict[bytes, set[int]](set)
    with Capture(path) as capture:
        for datagram in capture:
            payload = datagram.payload
            if len(payload) == DATA_BYTES:
                own = streams[datagram.source, datagram.destination_port]
                stream = own.setdefault(datagram.mac, _Stream(datagram.number))
                stream.last = datagram.number
                stream.packets += payload.startswith(_FLAG) and payload.startswith(_FLAG, BLOCK.itemsize)
            elif len(payload) == POSITION_BYTES:
                position[datagram.source].add(datagram.destination_port)
    counts = {key: sum(stream.packets for stream in own.values()) for key, own in streams.items()}
    least = max(_STRAY * max(counts.values(), default=0), 1)
    ports = defaultdict[bytes, list[int]](list)
    for source, port in sorted(key for key, packets in counts.items() if packets >= least):
        ports[source].append(port)
    units = [
        CapturedUnit(source, port, tuple(sorted(position[source])[place :: len(own)]), mac)
        for source, own in ports.items()
        for place, port in enumerate(own)
        for mac in _macs(streams[source, port], least)
    ]
    if required and not units:
        raise capture.no_data()
    return units, not all(counts.values())


def _macs(streams: dict[bytes, _Stream], least: float) -> list[bytes]:
    """Return the MAC addresses of sensors that send at the same time; of one that is replaced by another, none."""
    busy = {mac: stream for mac, stream in streams.items() if stream.packets >= least}
    latest_first, earliest_last = (max(one.first for one in busy.values()), min(one.last for one in busy.values()))
    return sorted(busy) if len(busy) > 1 and latest_first < earliest_last else [b""]
