"""What goes wrong with packets between the sensor and its receiver: a change of what is sent, and when.

A fault is a function of the packet alone: of its unit, its kind and its number, which counts from the run's first pulse.
So a part of a run is the same as cut out of the whole, and threads change nothing.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush

from vlp16emu.engine import Unit
from vlp16emu.packets import position_due_ns
from vlp16emu.random import Purpose, generator, uniform
from vlp16emu.scenario.events import (
    Corrupt,
    Delay,
    Drop,
    Duplicate,
    Freeze,
    Jitter,
    PacketEvent,
    Reorder,
    Share,
    Truncate,
)
from vlp16emu.sensor.settings import on_the_wire
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import MS_NS, seconds_to_ns

_ORDER = (Jitter, Reorder, Delay, Freeze, Drop, Corrupt, Truncate, Duplicate)
"""Which of several faults of a packet comes first."""
_LONGEST_NS = 20 * MS_NS
"""No more than this lies between packets that follow each other at their rate: 18.6 ms of position packets (63-9243 Rev D,
section 8.2.2). Where nothing follows, because nothing is sent, a packet is not overtaken."""


def kinds_of(event: PacketEvent) -> tuple[PacketKind, ...]:
    """Kinds of packets that an event befalls."""
    both = PacketKind.DATA, PacketKind.POSITION
    return both if event.packets == "both" else (PacketKind(event.packets),)


@dataclass(frozen=True, slots=True)
class PacketFault:
    """An event of packets of one unit."""

    event: PacketEvent
    number: int
    """Its place among the events of the run, from 0."""
    unit: Unit
    start_ns: int
    """UTC of the first pulse, from which position packets count."""
    begin_ns: int
    """UTC, as the next."""
    end_ns: int
    counted: Mapping[PacketKind, range]
    """Numbers of the packets that it may befall, where they are counted."""

    def befalls(self, packet: Packet, number: int) -> bool:
        """Whether it befalls a packet with a number among those of its unit and kind, by what that was before all faults."""
        if packet.kind not in kinds_of(self.event):
            return False
        lasts = self.begin_ns <= packet.due_ns < self.end_ns
        is_in = number in self.counted[packet.kind] if self.counted else lasts
        if not is_in or not isinstance(self.event, Share) or self.event.share == 1.0:
            return is_in
        return self._random(Purpose.PACKET_FAULT, packet, number) < self.event.share

    @property
    def longest_ns(self) -> int:
        """By how much it makes packets late at most."""
        match self.event:
            case Delay(by_s=late_s) | Jitter(up_to_s=late_s) | Duplicate(after_s=late_s):
                return seconds_to_ns(late_s)
            case Reorder(by=by):
                return by * _LONGEST_NS + 1
        return 0

    def change(self, packet: Packet, number: int) -> tuple[Packet, ...]:
        """Give what becomes of a packet that it befalls, but for what depends on the packets before it."""
        match self.event:
            case Drop():
                return ()
            case Duplicate(after_s=after_s):
                return packet, replace(packet, due_ns=packet.due_ns + seconds_to_ns(after_s))
            case Delay(by_s=by_s):
                return (replace(packet, due_ns=packet.due_ns + seconds_to_ns(by_s)),)
            case Reorder(by=by):
                return (replace(packet, due_ns=self._behind_ns(packet, by)),)
            case Corrupt(bits=bits):
                return (replace(packet, payload=self._flipped(packet, number, bits)),)
            case Truncate(to_bytes=to_bytes):
                return (replace(packet, payload=packet.payload[:to_bytes]),)
        return (packet,)

    def jitter_ns(self, packet: Packet, number: int) -> int:
        """Draw the delay of a packet."""
        return int(self._random(Purpose.PACKET_JITTER, packet, number) * self.longest_ns)

    def _behind_ns(self, packet: Packet, by: int) -> int:
        """Time just after the packet leaves that is so many of its kind behind one."""
        if packet.kind is PacketKind.POSITION:
            rate = on_the_wire(self.unit.section).position_rate
            due_ns = position_due_ns(rate, self.unit.seed, self.start_ns, packet.number, by + 1)
            return packet.due_ns + int(due_ns[-1] - due_ns[0]) + 1
        assert packet.fired_ns is not None
        return packet.due_ns + by * min(packet.due_ns - packet.fired_ns, _LONGEST_NS) + 1

    def _flipped(self, packet: Packet, number: int, bits: int) -> bytes:
        """Flip different bits of the payload; none of one that was not cast."""
        payload = bytearray(packet.payload)
        random = generator(self.unit.seed, Purpose.BIT_FLIP, number, self._lane(packet))
        count = min(bits, 8 * len(payload))
        for bit in random.choice(8 * len(payload), count, replace=False).tolist() if count else ():
            payload[bit // 8] ^= 1 << bit % 8
        return bytes(payload)

    def _random(self, purpose: Purpose, packet: Packet, number: int) -> float:
        """Draw a number in [0, 1) of a packet."""
        return float(uniform(self.unit.seed, purpose, number, 1, self._lane(packet))[0])

    def _lane(self, packet: Packet) -> int:
        return 2 * self.number + (packet.kind is PacketKind.POSITION)


class Wire:
    """Passes packets on, to which faults happen; once.

    Parameters
    ----------
    faults : of all units
    numbers : of the first data packet of each unit that comes
    frozen : packets that sensors hang at since before the first one, by fault and kind
    """

    def __init__(
        self, faults: Sequence[PacketFault], numbers: Mapping[int, int], frozen: Mapping[tuple[int, PacketKind], Packet]
    ) -> None:
        self._faults = sorted(faults, key=lambda fault: _ORDER.index(type(fault.event)))
        self._numbers = Counter(numbers)
        self._frozen = dict(frozen)
        self._left_ns = Counter[tuple[int, int, PacketKind]]()

    def passed(self, packets: Iterable[Packet]) -> Iterator[Packet]:
        """Yield what arrives, in order of sending."""
        waiting = list[tuple[int, int, Packet]]()
        serial = 0
        for packet in packets:
            for sent in self._after_faults(packet):
                heappush(waiting, (sent.due_ns, serial, sent))
                serial += 1
            while waiting and waiting[0][0] <= packet.due_ns:
                yield heappop(waiting)[-1]
        while waiting:
            yield heappop(waiting)[-1]

    def _after_faults(self, packet: Packet) -> list[Packet]:
        """Let all faults happen to a packet."""
        number = packet.number
        if packet.kind is PacketKind.DATA:
            number = self._numbers[packet.unit]
            self._numbers[packet.unit] += 1
        out = [packet]
        for fault in self._faults:
            if fault.unit.number != packet.unit:
                continue
            hit = fault.befalls(packet, number)
            if isinstance(fault.event, Jitter):
                out = [self._queued(fault, each, number, hit=hit) for each in out]
            elif hit and isinstance(fault.event, Freeze):
                first = self._frozen.setdefault((fault.number, packet.kind), packet)
                as_first = {"payload": first.payload, "fired_ns": first.fired_ns, "slots": first.slots}
                out = [replace(each, **as_first) for each in out]  # type: ignore[arg-type]  # each of its own type
            elif hit:
                out = [changed for each in out for changed in fault.change(each, number)]
        return out

    def _queued(self, fault: PacketFault, packet: Packet, number: int, *, hit: bool) -> Packet:
        """Delay a packet, and hold it back behind the one before it."""
        due_ns = packet.due_ns + (fault.jitter_ns(packet, number) if hit else 0)
        key = fault.number, packet.unit, packet.kind
        if packet.kind in kinds_of(fault.event):
            due_ns = self._left_ns[key] = max(due_ns, self._left_ns[key])
        return packet if due_ns == packet.due_ns else replace(packet, due_ns=due_ns)
