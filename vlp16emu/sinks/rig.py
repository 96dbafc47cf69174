"""The sockets of all sensors of a rig as one sink."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from vlp16emu.packets.frames import Link
from vlp16emu.sinks.udp import UdpResult, UdpSink
from vlp16emu.types import Packet

__all__ = ["RigSink"]


class RigSink:
    """Sends the packets of each unit to the ports of its own link.

    Parameters
    ----------
    links : of each unit
    host : as `UdpSink` takes it
    as_sensor : send from the units' own addresses, with their headers
    sent : called after each packet with its due time, UTC ns

    Raises
    ------
    OutputError
        as `UdpSink`
    """

    def __init__(
        self,
        links: Sequence[Link],
        host: str,
        *,
        as_sensor: bool = False,
        sent: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._sent = sent
        with ExitStack() as stack:
            self._sinks = [
                stack.enter_context(
                    UdpSink(
                        host,
                        data_port=link.data_port,
                        position_port=link.position_port,
                        as_sensor=link.source if as_sensor else None,
                    )
                )
                for link in links
            ]
            self._open = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def send(self, packet: Packet) -> None:
        """Send one packet.

        Raises
        ------
        RunError
            as `UdpSink.send`
        """
        self._sinks[packet.unit].send(packet)
        self._sent(packet.due_ns)

    @property
    def results(self) -> list[UdpResult]:
        """What each unit has sent so far."""
        return [sink.result for sink in self._sinks]
