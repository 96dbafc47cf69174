"""What a sink is."""

from types import TracebackType
from typing import Protocol, Self

from vlp16emu.types import Packet

__all__ = ["PacketSink"]


class PacketSink(Protocol):
    """Where packets leave: a context manager that is open from the moment it is made."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def send(self, packet: Packet) -> None:
        """Let one packet leave at once."""
