"""Packets stamped by a clock that a real GPS receiver sets."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from vlp16emu.device.gps_line import GpsLine
from vlp16emu.packets import STAMP_LEAD_NS
from vlp16emu.packets.retime import age_ns, restamped
from vlp16emu.sinks.pacing import TOLERANCE_NS
from vlp16emu.sinks.sink import PacketSink
from vlp16emu.types import Packet, PacketKind

__all__ = ["GpsInSink"]


class GpsInSink:
    """Passes packets on with the stamps, state and sentence that the sensor would have with that receiver on its line.

    Instants of packets are as far apart as they are due, however late each is sent: stamps show no jitter of the host. Only where
    the stream is late by more than the tolerance they are counted from then on.

    Parameters
    ----------
    sink : where they go
    line : the sensor's end of the receiver's line
    clock_ns : that of the line's instants
    """

    def __init__(
        self, sink: PacketSink, line: GpsLine, clock_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._sink, self._line, self._clock_ns = sink, line, clock_ns
        self._ahead_ns: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to close: the sink is the caller's."""

    def send(self, packet: Packet) -> None:
        """Send one packet.

        Raises
        ------
        RunError
            as of the sink
        """
        if packet.kind not in (PacketKind.DATA, PacketKind.POSITION):
            self._sink.send(packet)
            return
        now_ns = self._clock_ns()
        if self._ahead_ns is None or abs(now_ns - packet.due_ns - self._ahead_ns) > TOLERANCE_NS:
            self._ahead_ns = now_ns - packet.due_ns
        sent_ns = packet.due_ns + self._ahead_ns
        if packet.kind is PacketKind.POSITION:
            made_ns = sent_ns - STAMP_LEAD_NS
        else:
            made_ns = sent_ns - (
                age_ns(packet) if packet.fired_ns is None else packet.due_ns - packet.fired_ns
            )
        line = self._line
        stamped = restamped(packet, line.clock_ns(made_ns), line.state_at(made_ns), line.sentence)
        self._sink.send(stamped)
