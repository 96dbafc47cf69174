"""The protocol of sinks, a list of packets as the simplest one, and a switch by kind of packet."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, Self

from vlp16emu.types import Packet, PacketKind


class PacketSink(Protocol):
    """A destination of packets: a context manager that is open from the moment it is made.

    Classes derived from it have nothing to close unless they say so.
    """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close what was opened."""
        return

    def send(self, packet: Packet) -> None:
        """Let one packet leave at once."""


class MemorySink(PacketSink):
    """Keeps every packet it is sent, in `packets`."""

    def __init__(self) -> None:
        self.packets: list[Packet] = []

    def send(self, packet: Packet) -> None:
        """Append the packet."""
        self.packets.append(packet)


@dataclass(frozen=True, slots=True)
class Away:
    """One time that a device was not there."""

    at_s: float
    """Time since the port was opened."""
    away_s: float
    """Until it was there again, or the stream ended."""


@dataclass(frozen=True, slots=True)
class OutletResult:
    """Messages that left by an outlet."""

    to: str
    messages: int
    """Sentences, or samples."""
    bytes: int
    dropped: int
    """Messages that were too late: the device was away, or took no more."""
    away: tuple[Away, ...] = ()
    line: str | None = None
    """Line of the pulses, rts or dtr."""
    pulses: int | None = None
    """Pulses on that line; None if the port has no such line."""


class Outlet(PacketSink, Protocol):
    """A sink that reports what it sent."""

    @property
    def result(self) -> OutletResult:
        """Messages that left so far."""


class SinkByKind(PacketSink):
    """Gives packets to the sink of their kind. Sinks are the caller's, who opens and closes them.

    Parameters
    ----------
    sensors : of data and position packets
    others : of other kinds
    """

    def __init__(self, sensors: PacketSink, others: Mapping[PacketKind, PacketSink]) -> None:
        self._sensors, self._others = sensors, others

    def send(self, packet: Packet) -> None:
        """Send one packet; errors are the sink's."""
        self._others.get(packet.kind, self._sensors).send(packet)
