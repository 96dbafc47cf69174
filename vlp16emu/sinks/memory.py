"""A list of packets, for tests and for whoever wants to look at them."""

from types import TracebackType
from typing import Self

from vlp16emu.types import Packet

__all__ = ["MemorySink"]


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
