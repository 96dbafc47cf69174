"""Faults of packets between the sensor and its receiver: changes of their bytes and times.

A fault is a function of the packet alone: its unit, its kind and its number, which counts from the run's
first pulse. So a part of a run equals the same part of the whole run, and threads change nothing.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from itertools import count

from vlp16emu.engine import Unit
from vlp16emu.engine.engine import number_at
from vlp16emu.extras.bench.events import Event
from vlp16emu.packets import position_due_ns
from vlp16emu.random import Purpose, generator, uniform
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import require_packets
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import MS_NS, seconds_to_ns

_ORDER = ("jitter", "reorder", "delay", "freeze", "drop", "corrupt", "truncate", "duplicate")
"""Order of several faults of a packet."""
_LATE_KEYS = {
    "delay": "by_s",
    "jitter": "up_to_s",
    "duplicate": "after_s",
}  # key of the longest delay of a fault
_LONGEST_NS = 20 * MS_NS
"""Greatest time between consecutive packets at their rate: 18.6 ms for position packets (63-9243 Rev D,
section 8.2.2). If no packet follows within it, a packet is not overtaken."""

Streams = Callable[[int, int], Iterator[Packet]]
"""Packets of all units due in a span since the first pulse, in order of sending."""


def kinds_of(event: Event) -> tuple[PacketKind, ...]:
    """Return the kinds of packets that an event affects."""
    both = PacketKind.DATA, PacketKind.POSITION
    return both if event.packets == "both" else (PacketKind(event.packets),)


@dataclass(frozen=True, slots=True)
class PacketFault:
    """An event of packets of one unit."""

    event: Event
    number: int  # index among the events of the run, from 0
    unit: Unit
    start_ns: int  # UTC of the first pulse, from which position packets count
    counted: Mapping[PacketKind, range]  # numbers of the packets that it may affect, for events with `count`

    def hits(self, packet: Packet, number: int) -> bool:
        """Return True if it affects a packet.

        The packet is that before all faults, with its number in its unit and kind.
        """
        event = self.event
        since_ns = packet.due_ns - self.start_ns
        if packet.kind not in kinds_of(event):
            return False
        is_in = (
            number in self.counted[packet.kind] if self.counted else event.begin_ns <= since_ns < event.end_ns
        )
        if not is_in or not event.is_random:
            return is_in
        return bool(self._random(Purpose.PACKET_FAULT, packet, number) < event.share)

    @property
    def longest_ns(self) -> int:
        """Greatest delay that it gives a packet."""
        if self.event.kind == "reorder":
            return int(self.event.by) * _LONGEST_NS + 1
        key = _LATE_KEYS.get(self.event.kind)
        return seconds_to_ns(getattr(self.event, key)) if key else 0

    def change(self, packet: Packet, number: int) -> tuple[Packet, ...]:
        """Return the packets that replace an affected packet.

        Effects that depend on earlier packets are left out.
        """
        event = self.event
        due_ns = packet.due_ns
        payload = packet.payload
        match event.kind:
            case "drop":
                return ()
            case "duplicate":
                return packet, replace(packet, due_ns=due_ns + self.longest_ns)
            case "delay":
                due_ns += self.longest_ns
            case "reorder":
                due_ns += self._overtaken_ns(packet, event.by)
            case "corrupt":
                payload = self._flipped(packet, number, event.bits)
            case "truncate":
                payload = payload[: event.to_bytes]
        return (replace(packet, due_ns=due_ns, payload=payload),)

    def jitter_ns(self, packet: Packet, number: int) -> int:
        """Draw the delay of a packet."""
        return int(self._random(Purpose.PACKET_JITTER, packet, number) * self.longest_ns)

    def _overtaken_ns(self, packet: Packet, by: int) -> int:
        """Return the time until just after the departure of a later packet.

        That packet is `by` packets of its kind later.
        """
        if packet.kind is PacketKind.POSITION:
            rate = require_packets(self.unit.section).position_rate
            due_ns = position_due_ns(rate, self.unit.seed, self.unit.positions_from_ns, packet.number, by + 1)
            return int(due_ns[-1] - due_ns[0]) + 1
        assert packet.fired_ns is not None
        return by * min(packet.due_ns - packet.fired_ns, _LONGEST_NS) + 1

    def _flipped(self, packet: Packet, number: int, bits: int) -> bytes:
        """Return the payload with `bits` different bits flipped; an empty payload stays empty."""
        payload = bytearray(packet.payload)
        random = generator(self.unit.seed, Purpose.BIT_FLIP, number, self._lane(packet))
        count = min(bits, 8 * len(payload))
        for bit in random.choice(8 * len(payload), count, replace=False).tolist() if count else ():
            payload[bit // 8] ^= 1 << bit % 8
        return bytes(payload)

    def _random(self, purpose: Purpose, packet: Packet, number: int) -> float:
        return float(uniform(self.unit.seed, purpose, number, 1, self._lane(packet))[0])

    def _lane(self, packet: Packet) -> int:
        return 2 * self.number + (packet.kind is PacketKind.POSITION)


@dataclass
class Wire:
    """Wire that applies faults to a stream of packets, once."""

    faults: list[PacketFault]  # faults of all units, in `_ORDER`
    numbers: Counter[int]  # number of the next data packet of each unit
    frozen: dict[tuple[int, PacketKind], Packet]  # packets that hanging sensors repeat, by fault and kind
    left_ns: Counter[tuple[int, PacketKind]] = field(default_factory=Counter)
    """Departure of the last packet, by jitter and kind."""

    def passed(self, packets: Iterable[Packet]) -> Iterator[Packet]:
        """Yield the arriving packets, in order of sending."""
        waiting = list[tuple[int, int, Packet]]()
        serials = count()
        for packet in packets:
            for sent in self._after_faults(packet):
                heappush(waiting, (sent.due_ns, next(serials), sent))
            while waiting and waiting[0][0] <= packet.due_ns:
                yield heappop(waiting)[-1]
        yield from (packet for *_, packet in sorted(waiting))

    def _after_faults(self, packet: Packet) -> list[Packet]:
        number = packet.number
        if packet.kind is PacketKind.DATA:
            number = self.numbers[packet.unit]
            self.numbers[packet.unit] += 1
        out = [packet]
        for fault in self.faults:
            if fault.unit.number != packet.unit:
                continue
            key = fault.number, packet.kind
            hit = fault.hits(packet, number)
            # Jitter is the first kind of `_ORDER`, so `out` has one packet.
            if fault.event.kind == "jitter" and packet.kind in kinds_of(fault.event):
                due_ns = out[0].due_ns + (fault.jitter_ns(out[0], number) if hit else 0)
                self.left_ns[key] = max(due_ns, self.left_ns[key])  # it does not overtake the packet before
                out = [replace(out[0], due_ns=self.left_ns[key])]
            elif hit and fault.event.kind == "freeze":
                first = self.frozen.setdefault(key, packet)
                as_first = {"payload": first.payload, "fired_ns": first.fired_ns, "slots": first.slots}
                out = [replace(each, **as_first) for each in out]  # type: ignore[arg-type]
            elif hit:
                out = [changed for each in out for changed in fault.change(each, number)]
        return out


def faults_of(scenario: Scenario, units: Sequence[Unit]) -> list[PacketFault]:
    """Return the faults of packets among the events of a run."""
    faults = list[PacketFault]()
    for number, event in enumerate(scenario.events):
        if event.effect != "packets":
            continue
        unit = units[event.unit - 1]
        counted = dict[PacketKind, range]()
        if event.count is not None:
            firsts = {kind: number_at(scenario, unit, kind, event.begin_ns) for kind in kinds_of(event)}
            counted = {kind: range(first, first + event.count) for kind, first in firsts.items()}
        faults.append(PacketFault(event, number, unit, scenario.start_ns, counted))
    return faults


def earliest_ns(faults: Sequence[PacketFault], start_ns: int) -> int:
    """Return the time since the first pulse of the earliest packet that may arrive at `start_ns` or later."""
    return max(start_ns - sum(fault.longest_ns for fault in faults if fault.event.begin_ns < start_ns), 0)


def arriving(
    scenario: Scenario, units: Sequence[Unit], streams: Streams, start_ns: int, stop_ns: int
) -> Iterator[Packet]:
    """Return the packets that arrive in a span since the first pulse.

    Without faults, the packets that leave in it.
    """
    faults = faults_of(scenario, units)
    if not faults:
        return streams(start_ns, stop_ns)
    faults.sort(key=lambda fault: _ORDER.index(fault.event.kind))
    from_ns = earliest_ns(faults, start_ns)
    frozen = {
        (fault.number, kind): packet
        for fault in faults
        if fault.event.kind == "freeze" and fault.event.begin_ns < from_ns < fault.event.end_ns
        for kind in kinds_of(fault.event)
        for earlier in [streams(fault.event.begin_ns, stop_ns)]
        if (
            packet := next(
                (one for one in earlier if (one.unit, one.kind) == (fault.unit.number, kind)), None
            )
        )
    }
    numbers = Counter({unit.number: unit.timeline.count(0, from_ns) for unit in units})
    passed = Wire(faults, numbers, frozen).passed(streams(from_ns, stop_ns))
    return (packet for packet in passed if start_ns <= packet.due_ns - scenario.start_ns < stop_ns)
