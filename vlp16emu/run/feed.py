"""Packets of a stream, which can skip ahead and go on with other events."""

from collections import Counter
from collections.abc import Collection, Generator, Iterator
from collections.abc import Set as AbstractSet
from threading import Thread

from vlp16emu.doors import door
from vlp16emu.engine import Engine
from vlp16emu.engine.position import number_at
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, seconds_to_ns


class PacketFeed:
    """Iterator over the packets of a run in order of sending, which can skip ahead or go on with other events.

    Parameters
    ----------
    engine : makes them
    start_s, stop_s : span of the run, since the first pulse
    also : kinds that are sent beside the packets of the sensors

    Raises
    ------
    InputError
        If the engine has no such span, or the scene no device that `also` asks for
    """

    def __init__(self, engine: Engine, start_s: float, stop_s: float, *, also: Collection[PacketKind] = ()) -> None:
        self.engine, self._stop_s = engine, stop_s
        """Makes the packets from here on."""
        self._beside = door("beside")(engine, also) if also else None
        self._packets = self._from(start_s)
        self._reached_ns = engine.scenario.start_ns
        self._at_reached = set[tuple[int, PacketKind]]()
        self._from_ns: int | None = None
        self.skipped = Counter[PacketKind]()
        """Packets that were skipped, by kind."""

    def __iter__(self) -> Iterator[Packet]:
        return self

    def __next__(self) -> Packet:
        from_ns, self._from_ns = self._from_ns, None
        if from_ns is not None:
            self._leave_out(from_ns)
        packet = next(self._packets)
        if packet.due_ns > self._reached_ns:
            self._reached_ns = packet.due_ns
            self._at_reached.clear()
        self._at_reached.add((packet.unit, packet.kind))
        return packet

    def close(self) -> None:
        """Stop the workers, and wait for the blocks under way."""
        self._packets = iter(())

    def _let_go(self) -> None:
        """Stop the workers without waiting, as the next packet is wanted at once."""
        before, self._packets = self._packets, iter(())
        if isinstance(before, Generator):
            Thread(target=before.close, name="let go", daemon=True).start()

    def go_on_from(self, due_ns: int) -> None:
        """Skip packets due before a UTC time, from the next one on; from any thread."""
        self._from_ns = due_ns

    def begin_again(self, from_ns: int, engine: Engine) -> None:
        """Go on from a UTC time, or from where the run is if that is earlier, with another engine; between two packets."""
        self._let_go()
        self.engine = engine
        if from_ns > self._reached_ns:
            from_ns, there = self._reached_ns, self._at_reached
        else:
            there = set()
        self._packets = self._after(from_ns, there)

    def _from(self, start_s: float) -> Iterator[Packet]:
        packets = self.engine.packets(start_s, self._stop_s)
        if self._beside is None:
            return packets
        return iter(self._beside.among(packets, seconds_to_ns(start_s), seconds_to_ns(self._stop_s)))

    def _after(self, from_ns: int, there: AbstractSet[tuple[int, PacketKind]]) -> Iterator[Packet]:
        """Yield packets due from a UTC time on, without those of `there` due just then, which have been sent."""
        for packet in self._from(self._since_s(from_ns)):
            if packet.due_ns > from_ns or (packet.unit, packet.kind) not in there:
                yield packet

    def _leave_out(self, from_ns: int) -> None:
        """Go on at a UTC time, and count the packets before it as skipped."""
        stop_ns = self.engine.scenario.start_ns + round(self._stop_s * S_NS)
        from_ns = min(from_ns, stop_ns)
        if from_ns <= self._reached_ns:
            return
        self.close()  # of the packets before
        self.skipped += self._count(from_ns) - self._count(self._reached_ns + 1)
        self._packets = self._from(self._since_s(from_ns))

    def _count(self, before_ns: int) -> Counter[PacketKind]:
        """Count the packets of all units due before a UTC time, by kind."""
        scenario, units = self.engine.scenario, self.engine.parts.units
        since_ns = before_ns - scenario.start_ns
        kinds = PacketKind.DATA, PacketKind.POSITION
        sent = {kind: sum(number_at(scenario, unit, kind, since_ns) for unit in units) for kind in kinds}
        return Counter(sent | (self._beside.count(0, since_ns) if self._beside else {}))

    def _since_s(self, utc_ns: int) -> float:
        return (utc_ns - self.engine.scenario.start_ns) / S_NS
