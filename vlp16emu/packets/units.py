"""Whose datagrams are whose in a capture of several sensors."""

from collections import Counter, defaultdict
from ipaddress import IPv4Address
from pathlib import Path
from typing import NamedTuple

from vlp16emu.errors import InputError
from vlp16emu.packets.capture import Capture, Datagram
from vlp16emu.packets.layout import DATA_BYTES, POSITION_BYTES

__all__ = ["CapturedUnit", "chosen_unit", "units_in"]

_STRAY = 0.02
"""Less than this share of the data packets of the busiest unit is no unit but an accident."""


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
    CaptureError
        where the file is no capture, or is damaged
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
    CaptureError
        where the file is no capture, or is damaged
    InputError
        where there is no such unit, or there are several and none is named
    """
    units = units_in(path) if path.is_file() else []  # a pipe can be read only once
    if not units or (unit is None and len(units) == 1):
        return None
    for number, known in enumerate(units, start=1):
        if unit in (str(number), str(known)):
            return known
    found = f"{len(units)} units in {path}" if unit is None else f"found {unit}"
    names = [f"{number} ({known})" for number, known in enumerate(units, start=1)]
    raise InputError(where, found, f"one of {', '.join(names)}")
