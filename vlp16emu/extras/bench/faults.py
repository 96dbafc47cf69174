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
_DELAY_KEYS = {"delay": "by_s", "jitter": "up_to_s", "duplicate": "after_s"}
"""Key of the longest delay of a fault."""
_LONGEST_NS = 20 * MS_NS
"""Greatest time between consecutive packets at their rate: 18.6 ms for position packets (63-9243 Rev D,
section 8.2.2). If no packet follows within it, a packet is not overtaken."""

Streams = Callable[[int, int], Iterator[Packet]]
"""Packets of all units due in a span since the first pulse, in order of sending."""


def kinds_of(event: Event) -> tuple[PacketKind, ...]:
    """Return the kinds of packets that an event affects."""
    if event.packets == "both":
        return PacketKind.DATA, PacketKind.POSITION
    return (PacketKind(event.packets),)


@dataclass(frozen=True, slots=True)
class PacketFault:
    """An event that affects packets of one unit."""

    event: Event
    number: int  # index among the events of the run, from 0
    unit: Unit
    start_ns: int  # UTC of the first pulse, from which position packets count
    numbers: Mapping[PacketKind, range]
    """Numbers of the packets that it may affect, for an event with `count`; empty for others."""

    def hits(self, packet: Packet, number: int) -> bool:
        """Return True if it affects a packet.

        Parameters
        ----------
        packet : the packet before all faults
        number : its number in its unit and kind
        """
        event = self.event
        since_ns = packet.due_ns - self.start_ns
        if packet.kind not in kinds_of(event):
            return False
        if self.numbers:
            may_hit = number in self.numbers[packet.kind]
        else:
            may_hit = event.begin_ns <= since_ns < event.end_ns
        if not may_hit or not event.is_random:
            return may_hit
        return bool(self._random(Purpose.PACKET_FAULT, packet, number) < event.share)

    @property
    def longest_ns(self) -> int:
        """Greatest delay that it gives a packet."""
        if self.event.kind == "reorder":
            return int(self.event.by) * _LONGEST_NS + 1
        key = _DELAY_KEYS.get(self.event.kind)
        return seconds_to_ns(getattr(self.event, key)) if key else 0

    def change(self, packet: Packet, number: int) -> tuple[Packet, ...]:
        """Return the packets that replace an affected packet, without effects of earlier packets on it."""
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
                due_ns += self._overtaking_ns(packet, event.by)
            case "corrupt":
                payload = self._flip_bits(packet, number, event.bits)
            case "truncate":
                payload = payload[: event.to_bytes]
        return (replace(packet, due_ns=due_ns, payload=payload),)

    def jitter_ns(self, packet: Packet, number: int) -> int:
        """Draw the delay of a packet."""
        return int(self._random(Purpose.PACKET_JITTER, packet, number) * self.longest_ns)

    def _overtaking_ns(self, packet: Packet, by: int) -> int:
        """Return the time until just after the departure of the packet of its kind that is `by` later."""
        if packet.kind is PacketKind.POSITION:
            rate = require_packets(self.unit.section).position_rate
            due_ns = position_due_ns(rate, self.unit.seed, self.unit.positions_from_ns, packet.number, by + 1)
            return int(due_ns[-1] - due_ns[0]) + 1
        assert packet.fired_ns is not None
        return by * min(packet.due_ns - packet.fired_ns, _LONGEST_NS) + 1

    def _flip_bits(self, packet: Packet, number: int, bits: int) -> bytes:
        """Return the payload with `bits` different bits flipped; an empty payload stays empty."""
        if not packet.payload:
            return b""
        payload = bytearray(packet.payload)
        length = 8 * len(payload)
        random = generator(self.unit.seed, Purpose.BIT_FLIP, number, self._lane(packet))
        for bit in random.choice(length, min(bits, length), replace=False).tolist():
            payload[bit // 8] ^= 1 << bit % 8
        return bytes(payload)

    def _random(self, purpose: Purpose, packet: Packet, number: int) -> float:
        return float(uniform(self.unit.seed, purpose, number, 1, self._lane(packet))[0])

    def _lane(self, packet: Packet) -> int:
        return 2 * self.number + (packet.kind is PacketKind.POSITION)


@dataclass
class Wire:
    """Wire that applies faults to the packets of one stream."""

    faults: list[PacketFault]  # faults of all units, in `_ORDER`
    numbers: Counter[int]  # number of the next data packet of each unit
    frozen: dict[tuple[int, PacketKind], Packet]
    """Packets that hanging sensors repeat, by fault and kind."""
    left_ns: Counter[tuple[int, PacketKind]] = field(default_factory=Counter)
    """Departure of the last packet, by jitter and kind."""

    def transmit(self, packets: Iterable[Packet]) -> Iterator[Packet]:
        """Yield the packets that arrive, in order of their arrival."""
        waiting = list[tuple[int, int, Packet]]()
        serials = count()
        for packet in packets:
            for changed in self._apply_faults(packet):
                heappush(waiting, (changed.due_ns, next(serials), changed))
            while waiting and waiting[0][0] <= packet.due_ns:
                yield heappop(waiting)[-1]
        yield from (packet for *_, packet in sorted(waiting))

    def _apply_faults(self, packet: Packet) -> list[Packet]:
        number = packet.number
        if packet.kind is PacketKind.DATA:
            number = self.numbers[packet.unit]
            self.numbers[packet.unit] += 1
        packets = [packet]
        for fault in self.faults:
            if fault.unit.number != packet.unit:
                continue
            key = fault.number, packet.kind
            is_hit = fault.hits(packet, number)
            # Jitter is the first kind of `_ORDER`, so there is one packet.
            if fault.event.kind == "jitter" and packet.kind in kinds_of(fault.event):
                due_ns = packets[0].due_ns + (fault.jitter_ns(packets[0], number) if is_hit else 0)
                self.left_ns[key] = max(due_ns, self.left_ns[key])  # it does not overtake the packet before
                packets = [replace(packets[0], due_ns=self.left_ns[key])]
            elif is_hit and fault.event.kind == "freeze":
                first = self.frozen.setdefault(key, packet)
                as_first = {"payload": first.payload, "fired_ns": first.fired_ns, "slots": first.slots}
                packets = [replace(affected, **as_first) for affected in packets]  # type: ignore[arg-type]
            elif is_hit:
                packets = [changed for affected in packets for changed in fault.change(affected, number)]
        return packets


def faults_of(scenario: Scenario, units: Sequence[Unit]) -> list[PacketFault]:
    """Return the faults of packets among the events of a run."""
    faults = list[PacketFault]()
    for number, event in enumerate(scenario.events):
        if event.effect != "packets":
            continue
        unit = units[event.unit - 1]
        numbers = dict[PacketKind, range]()
        if event.count is not None:
            firsts = {kind: number_at(scenario, unit, kind, event.begin_ns) for kind in kinds_of(event)}
            numbers = {kind: range(first, first + event.count) for kind, first in firsts.items()}
        faults.append(PacketFault(event, number, unit, scenario.start_ns, numbers))
    return faults


def earliest_ns(faults: Sequence[PacketFault], start_ns: int) -> int:
    """Return the time since the first pulse of the earliest packet that may arrive at `start_ns` or later."""
    return max(start_ns - sum(fault.longest_ns for fault in faults if fault.event.begin_ns < start_ns), 0)


def arriving_packets(
    scenario: Scenario, units: Sequence[Unit], streams: Streams, start_ns: int, stop_ns: int
) -> Iterator[Packet]:
    """Return the packets that arrive in a span since the first pulse.

    Parameters
    ----------
    streams : packets that leave in a span
    start_ns, stop_ns : span, since the first pulse
    """
    faults = faults_of(scenario, units)
    if not faults:
        return streams(start_ns, stop_ns)
    faults.sort(key=lambda fault: _ORDER.index(fault.event.kind))
    begin_ns = earliest_ns(faults, start_ns)
    frozen = dict[tuple[int, PacketKind], Packet]()
    for fault in faults:
        if fault.event.kind == "freeze" and fault.event.begin_ns < begin_ns < fault.event.end_ns:
            frozen |= _frozen_packets(fault, streams, stop_ns)
    numbers = Counter({unit.number: unit.timeline.count(0, begin_ns) for unit in units})
    packets = Wire(faults, numbers, frozen).transmit(streams(begin_ns, stop_ns))
    return (packet for packet in packets if start_ns <= packet.due_ns - scenario.start_ns < stop_ns)


def _frozen_packets(
    fault: PacketFault, streams: Streams, stop_ns: int
) -> dict[tuple[int, PacketKind], Packet]:
    """Return the first packet of each kind since a sensor hangs, which it repeats, by fault and kind."""
    packets = {}
    for kind in kinds_of(fault.event):
        sender = (fault.unit.number, kind)
        for packet in streams(fault.event.begin_ns, stop_ns):
            if (packet.unit, packet.kind) == sender:
                packets[fault.number, kind] = packet
                break
    return packets
