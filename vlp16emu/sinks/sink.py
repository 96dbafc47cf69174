"""The protocol of sinks, and a list of packets as the simplest one."""

from typing import Protocol, Self

from vlp16emu.types import Packet


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
