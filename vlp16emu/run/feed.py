"""The packets of a run in order of sending, from an engine that can skip ahead or go on with other events."""

from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator
from collections.abc import Set as AbstractSet
from threading import Thread
from typing import Protocol

from vlp16emu.doors import Part
from vlp16emu.engine import Engine
from vlp16emu.engine.engine import sent_before
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, seconds_to_ns


class MorePackets(Protocol):
    """Packets of further kinds beside those of the sensors."""

    def merge_with(self, packets: Iterator[Packet], start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Merge the packets of a span since the first pulse with the further ones."""

    def count(self, start_ns: int, stop_ns: int) -> dict[PacketKind, int]:
        """Count the further packets of a span since the first pulse, by kind."""


BESIDE = Part[Callable[[Engine, Collection[PacketKind]], MorePackets]](
    "vlp16emu.extras.bench.outlets:DevicePackets"
)


class PacketFeed:
    """Iterator over the packets of a run in order of sending.

    It can skip ahead, or continue with other events.

    Parameters
    ----------
    engine : engine that makes the packets
    start_s, stop_s : span of the run, since the first pulse
    also : further kinds of packets to send

    Raises InputError if the engine does not have the span, or the scene lacks a device for `also`.
    """

    def __init__(
        self, engine: Engine, start_s: float, stop_s: float, *, also: Collection[PacketKind] = ()
    ) -> None:
        self.engine = engine  # Makes the packets from here on
        self._stop_s = stop_s
        self._beside = BESIDE.load()(engine, also) if also else None
        self._packets = self._from(start_s)
        self._reached_ns = engine.scenario.start_ns
        self._at_reached = set[tuple[int, PacketKind]]()
        self._from_ns: int | None = None
        self.skipped = Counter[PacketKind]()  # Packets that were skipped, by kind

    def __iter__(self) -> Iterator[Packet]:
        return self

    def __next__(self) -> Packet:
        from_ns = self._from_ns
        self._from_ns = None
        if from_ns is not None:
            self._leave_out(from_ns)
        packet = next(self._packets)
        if packet.due_ns > self._reached_ns:
            self._reached_ns = packet.due_ns
            self._at_reached.clear()
        self._at_reached.add((packet.unit, packet.kind))
        return packet

    def close(self) -> None:
        """Stop the workers, and wait for the blocks in progress."""
        self._packets = iter(())

    def go_on_from(self, due_ns: int) -> None:
        """Skip packets due before a UTC time, from the next packet on; callable from any thread."""
        self._from_ns = due_ns

    def begin_again(self, from_ns: int, engine: Engine) -> None:
        """Continue from a UTC time, or from the present packet if that is earlier, with another engine.

        Between packets.
        """
        before = self._packets
        self.engine = engine
        if isinstance(
            before, Generator
        ):  # its workers end in the background, as the next packet is due at once
            Thread(target=before.close, name="let go", daemon=True).start()
        if from_ns > self._reached_ns:
            from_ns = self._reached_ns
            there = self._at_reached.copy()
        else:
            there = set()
        self._packets = self._after(from_ns, there)

    def _from(self, start_s: float) -> Iterator[Packet]:
        packets = self.engine.packets(start_s, self._stop_s)
        if self._beside is None:
            return packets
        return iter(self._beside.merge_with(packets, seconds_to_ns(start_s), seconds_to_ns(self._stop_s)))

    def _after(self, from_ns: int, there: AbstractSet[tuple[int, PacketKind]]) -> Iterator[Packet]:
        """Yield packets due from a UTC time on.

        Packets of `there` that are due at that time have been sent, and are left out.
        """
        for packet in self._from(self._since_s(from_ns)):
            if packet.due_ns > from_ns or (packet.unit, packet.kind) not in there:
                yield packet

    def _leave_out(self, from_ns: int) -> None:
        """Continue at a UTC time, and count the packets before it as skipped."""
        from_ns = min(from_ns, self.engine.scenario.start_ns + round(self._stop_s * S_NS))
        if from_ns <= self._reached_ns:
            return
        self.close()  # generator of the earlier packets
        self.skipped += self._count(from_ns) - self._count(self._reached_ns + 1) + self._unsent_at_reached()
        self._packets = self._from(self._since_s(from_ns))

    def _count(self, before_ns: int) -> Counter[PacketKind]:
        """Count the packets of all units due before a UTC time, by kind."""
        scenario = self.engine.scenario
        units = self.engine.parts.units
        since_ns = before_ns - scenario.start_ns
        kinds = PacketKind.DATA, PacketKind.POSITION
        sent = {kind: sum(sent_before(scenario, unit, kind, since_ns) for unit in units) for kind in kinds}
        return Counter(sent | (self._beside.count(0, since_ns) if self._beside else {}))

    def _unsent_at_reached(self) -> Counter[PacketKind]:
        """Count the packets of other units due at the very time of the last packet, by kind."""
        scenario = self.engine.scenario
        since_ns = self._reached_ns - scenario.start_ns
        return Counter(
            kind
            for unit in self.engine.parts.units
            for kind in (PacketKind.DATA, PacketKind.POSITION)
            if (unit.number, kind) not in self._at_reached
            and sent_before(scenario, unit, kind, since_ns + 1) > sent_before(scenario, unit, kind, since_ns)
        )

    def _since_s(self, utc_ns: int) -> float:
        return (utc_ns - self.engine.scenario.start_ns) / S_NS
