"""What a sink is, and the simplest one.

A list of packets, for tests and for anybody who wants to look at them.
"""

from types import TracebackType
from typing import Protocol, Self

from vlp16emu.types import Packet

__all__ = ["MemorySink", "PacketSink"]


class PacketSink(Protocol):
    """Where packets leave: a context manager that is open from the moment it is made."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def send(self, packet: Packet) -> None:
        """Let one packet leave at once."""


class MemorySink:
    """Keeps every packet it is sent, in `packets`."""

    def __init__(self) -> None:
        self.packets: list[Packet] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to close."""

    def send(self, packet: Packet) -> None:
        """Append the packet."""
        self.packets.append(packet)
