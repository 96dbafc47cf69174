"""The protocol of sinks."""

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
