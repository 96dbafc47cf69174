"""The engine of a stream, which can leave out a part of its run."""

from collections import Counter
from collections.abc import Iterator

from vlp16emu.chain import Chain
from vlp16emu.packets import SEQUENCES_PER_PACKET
from vlp16emu.scenario.sensor import on_the_wire
from vlp16emu.sensor import SEQUENCE_NS
from vlp16emu.types import Packet, PacketKind, ReturnMode
from vlp16emu.units import S_NS

__all__ = ["Engine"]


class Engine:
    """Packets of a run in order of sending, an iterator.

    Parameters
    ----------
    chain : makes them
    start_s, stop_s : span of the run, since the first pulse

    Raises
    ------
    InputError
        where the chain has no such span
    """

    def __init__(self, chain: Chain, start_s: float, stop_s: float) -> None:
        self._chain, self._stop_s = chain, stop_s
        self.scenario = chain.scenario
        self._packets = chain.packets(start_s, stop_s)
        self._reached_ns = chain.scenario.start_ns
        self._from_ns: int | None = None
        self.skipped = Counter[PacketKind]()
        """Packets that were left out."""

    def __iter__(self) -> Iterator[Packet]:
        return self

    def __next__(self) -> Packet:
        from_ns, self._from_ns = self._from_ns, None
        if from_ns is not None:
            self._leave_out(from_ns)
        packet = next(self._packets)
        self._reached_ns = packet.due_ns + 1
        return packet

    def go_on_from(self, due_ns: int) -> None:
        """Compute no packet that is due before a UTC time, from the next one on; from any thread."""
        self._from_ns = due_ns

    def _leave_out(self, from_ns: int) -> None:
        """Begin again further on."""
        stop_ns = self.scenario.start_ns + round(self._stop_s * S_NS)
        from_ns = min(from_ns, stop_ns)
        if from_ns <= self._reached_ns:
            return
        self._packets = iter(())  # ends the workers of the packets before
        self.skipped += self._count(from_ns) - self._count(self._reached_ns)
        self._packets = self._chain.packets(self._since_s(from_ns), self._stop_s)

    def _count(self, before_ns: int) -> Counter[PacketKind]:
        """Count the packets of all units due from the first pulse until before a UTC time."""
        since_s, units = self._since_s(before_ns), self._chain.parts.units
        since_ns = before_ns - self.scenario.start_ns
        data = 0
        for unit in units:
            period_ns = SEQUENCES_PER_PACKET[ReturnMode(on_the_wire(unit.section).return_mode)] * SEQUENCE_NS
            data += max(-(-since_ns // period_ns) - 1, 0)  # packet p is due at (p + 1) periods
        position = sum(self._chain.first_position_packets(since_s))
        return Counter({PacketKind.DATA: data, PacketKind.POSITION: position})

    def _since_s(self, utc_ns: int) -> float:
        """Put a UTC time into seconds since the first pulse."""
        return (utc_ns - self.scenario.start_ns) / S_NS
