"""Faults of packets on their way, found in what a run sends."""

from collections import Counter
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from kit import DEFAULT_UNIT
from listening import MemorySink

from vlp16emu import Emulator
from vlp16emu.errors import ScenarioError
from vlp16emu.extras.bench.faults import arriving_packets
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.stream import Stream
from vlp16emu.scenario import load
from vlp16emu.sinks import Pacer
from vlp16emu.types import PacketKind
from vlp16emu.units import MS_NS, S_NS

DATA, POSITION = PacketKind.DATA, PacketKind.POSITION
SETTINGS = {"seed": 5, "duration_s": 1.5, "gps.connected": True}
START_NS = load(DEFAULT_UNIT, SETTINGS).start_ns


def emulator(*events, threads=2, **settings):
    return Emulator(DEFAULT_UNIT, SETTINGS | {"events": list(events)} | settings, threads=threads)


@lru_cache
def made():
    return list(emulator().packets())


@pytest.fixture(scope="module")
def clean():
    return made()


def sent(*events, start_s=0.0, stop_s=1.5, **settings):
    """Packets of a run to which events happen, in order of sending; light is cast again only where the
    scene is another."""
    run = emulator(*events, **settings)
    begin_ns = run.scenario.start_ns

    def streams(start_ns, stop_ns):
        return (packet for packet in made() if start_ns <= packet.due_ns - begin_ns < stop_ns)

    if settings:
        packets = list(run.packets(start_s, stop_s))
    else:
        span_ns = round(start_s * S_NS), round(stop_s * S_NS)
        packets = list(arriving_packets(run.scenario, run.parts.units, streams, *span_ns))
    due_ns = [packet.due_ns for packet in packets]
    assert due_ns == sorted(due_ns)
    return packets


def of(packets, kind):
    return [packet for packet in packets if packet.kind is kind]


def since(packets, at_s):
    begin_ns = START_NS + round(at_s * S_NS)
    return [packet for packet in packets if packet.due_ns >= begin_ns]


EVERY = (
    {"kind": "drop", "at_s": 0.5, "share": 0.1, "packets": "both"},
    {"kind": "duplicate", "at_s": 0.3, "share": 0.1, "after_s": 0.003},
    {"kind": "reorder", "at_s": 0.2, "share": 0.1, "by": 2, "packets": "both"},
    {"kind": "jitter", "at_s": 0.1, "up_to_s": 0.02},
    {"kind": "corrupt", "at_s": 0.1, "share": 0.2, "packets": "both"},
    {"kind": "truncate", "at_s": 0.1, "share": 0.1, "packets": "both"},
    {"kind": "freeze", "at_s": 0.6, "duration_s": 0.4},
    {"kind": "delay", "at_s": 1.0, "by_s": 0.03, "count": 10},
)


@pytest.mark.parametrize("cut_s", [0.25, 0.61, 0.99, 1.02])
def test_faults_do_not_depend_on_the_span(cut_s):
    """All faults at once: what comes before a time and after it are the whole run; so is a span that one
    thread casts anew."""
    whole, after = sent(*EVERY), sent(*EVERY, start_s=cut_s)
    assert sent(*EVERY, stop_s=cut_s) + after == whole
    part = list(emulator(*EVERY, threads=1).packets(cut_s, cut_s + 0.1))
    assert part == after[: len(part)]


def test_faults_depend_on_the_seed_and_on_their_place():
    """Another seed lets other packets be lost; so does the same event as the second of the scene."""
    drop = {"kind": "drop", "at_s": 0.0, "share": 0.3}
    other = {"kind": "pps_loss", "at_s": 1.0}
    runs = [sent(drop), sent(drop, seed=6), sent(other, drop)]
    kept = [frozenset(packet.due_ns for packet in of(run, DATA)) for run in runs]
    assert len(set(kept)) == 3
    assert kept[0] == frozenset(packet.due_ns for packet in of(sent(drop), DATA))


@pytest.mark.parametrize("packets", ["data", "position", "both"])
def test_a_share_of_packets_is_lost(clean, packets):
    """The share of missing packets of each chosen kind is that of the event, within 4 sigma; the others are
    the same to the bit."""
    kept = sent({"kind": "drop", "at_s": 0.5, "share": 0.3, "packets": packets})
    assert all(packet in clean for packet in kept)
    for kind in (DATA, POSITION):
        there, left = len(since(of(clean, kind), 0.5)), len(since(of(kept, kind), 0.5))
        share = 1 - left / there
        expected = 0.3 if packets in (kind, "both") else 0.0
        assert abs(share - expected) <= 4 * (expected * 0.7 / there) ** 0.5
        assert of(clean, kind)[:-there] == of(kept, kind)[: len(of(kept, kind)) - left]


def test_a_run_of_packets_is_lost(clean):
    """With a count just so many of a kind are missing, one after the other, and the frames' numbers leave
    a gap."""
    kept = sent({"kind": "drop", "at_s": 0.5, "count": 12, "packets": "both"})
    for kind in (DATA, POSITION):
        lost = [packet for packet in of(clean, kind) if packet not in kept]
        assert lost == since(of(clean, kind), 0.5)[:12]
    numbers = [packet.number for packet in of(kept, POSITION)]
    assert Counter(np.diff(numbers).tolist()) == {1: len(numbers) - 2, 13: 1}


def test_duplicates_follow_their_packet(clean):
    """A fifth of the packets comes twice, the second time 3 ms later, with the same bytes and the same
    number."""
    twice = Counter(
        sent({"kind": "duplicate", "at_s": 0.5, "share": 0.2, "after_s": 0.003, "packets": "both"})
    )
    copies = twice - Counter(clean)
    late = round(0.003 * S_NS)
    assert all(replace(copy, due_ns=copy.due_ns - late) in clean for copy in copies)
    assert abs(len(list(copies)) / len(since(clean, 0.5)) - 0.2) < 0.06
    at_once = sent({"kind": "duplicate", "at_s": 0.5, "count": 1})
    place = next(i for i, pair in enumerate(pairwise(at_once)) if pair[0] == pair[1])
    assert at_once[:place] + at_once[place + 1 :] == clean


@pytest.mark.parametrize(("by", "settings"), [(1, {}), (3, {}), (1, {"sensor.return_mode": "dual"})])
def test_a_packet_comes_behind_later_ones(by, settings):
    """One data packet comes right behind the one that follows it by so many; position packets and dual
    return too."""
    fault = {"kind": "reorder", "at_s": 0.1, "by": by, "count": 1, "packets": "both"}
    clean, moved = (sent(*events, stop_s=0.3, **settings) for events in ((), (fault,)))
    for kind in (DATA, POSITION):
        expected = [packet.payload for packet in of(clean, kind)]
        first = len(expected) - len(since(of(clean, kind), 0.1))
        expected.insert(first + by, expected.pop(first))
        assert [packet.payload for packet in of(moved, kind)] == expected


def test_a_delay_moves_sending_and_nothing_else(clean):
    """Packets of half a second leave 50 ms later, with the stamps that they had; those that follow
    overtake the last ones."""
    late = of(sent({"kind": "delay", "at_s": 0.5, "duration_s": 0.5, "by_s": 0.05}), DATA)
    due_ns = {packet.payload: packet.due_ns for packet in of(clean, DATA)}
    behind = Counter((packet.due_ns - due_ns[packet.payload]) // MS_NS for packet in late)
    moved = len(since(of(clean, DATA), 0.5)) - len(since(of(clean, DATA), 1.0))
    assert behind == {0: len(late) - moved, 50: moved}
    assert [packet.payload for packet in late] != [packet.payload for packet in of(clean, DATA)]


def test_jitter_is_a_queue(clean):
    """Delays of all sizes up to the greatest, without a change of order; where packets are far apart they
    are uniform."""
    late = of(sent({"kind": "jitter", "at_s": 0.2, "up_to_s": 0.02}), DATA)
    before = of(clean, DATA)[: len(late)]
    assert [packet.payload for packet in late] == [packet.payload for packet in before]
    extra_ms = np.array([b.due_ns - a.due_ns for a, b in zip(before, late, strict=True)]) / MS_NS
    assert extra_ms.min() == 0.0
    assert 18.0 < extra_ms.max() < 20.0
    sparse = of(sent({"kind": "jitter", "at_s": 0.0, "up_to_s": 0.0013}), DATA)
    extra = np.array([b.due_ns - a.due_ns for a, b in zip(of(clean, DATA), sparse, strict=False)]) / 1.3e6
    assert np.histogram(extra, 4, (0.0, 1.0))[0] / len(extra) == pytest.approx(0.25, abs=0.05)


def test_so_many_bits_are_flipped(clean):
    """Each corrupted packet differs in as many bits as wanted, anywhere in its payload, and leaves at its
    time."""
    bad = sent({"kind": "corrupt", "at_s": 0.0, "bits": 5, "packets": "both"})
    places = []
    for a, b in zip(clean, bad, strict=True):
        flipped = np.flatnonzero(
            np.unpackbits(np.frombuffer(a.payload, np.uint8) ^ np.frombuffer(b.payload, np.uint8))
        )
        assert len(flipped) == 5
        assert a.due_ns == b.due_ns
        places += (flipped / (8 * len(a.payload))).tolist()
    assert np.histogram(places, 5, (0.0, 1.0))[0] / len(places) == pytest.approx(0.2, abs=0.03)


def test_cut_payloads(clean):
    """What is left is the beginning of the payload; shorter payloads stay whole."""
    cut = sent({"kind": "truncate", "at_s": 0.5, "to_bytes": 600, "packets": "both"})
    for a, b in zip(clean, cut, strict=True):
        is_cut = a.kind is DATA and a in since([a], 0.5)
        assert b.payload == (a.payload[:600] if is_cut else a.payload)


def test_a_hanging_sensor_repeats_one_payload(clean):
    """For its time each packet of the kind has the bytes of the first one; numbers of position packets go
    on."""
    frozen = sent({"kind": "freeze", "at_s": 0.5, "duration_s": 0.5, "packets": "both"})
    for kind in (DATA, POSITION):
        before, after = of(clean, kind), of(frozen, kind)
        hung = since(after, 0.5)[: len(since(after, 0.5)) - len(since(after, 1.0))]
        assert {packet.payload for packet in hung} == {since(before, 0.5)[0].payload}
        assert [packet.due_ns for packet in after] == [packet.due_ns for packet in before]
        assert [packet.number for packet in after] == [packet.number for packet in before]
        assert since(after, 1.0) == since(before, 1.0)


def test_faults_are_those_of_their_unit():
    """In a rig the packets of the other units stay as they are."""
    rig = {"rig": [{"mount": {"lever_arm_m": [0.0, 0.0, 0.5]}}], "duration_s": 0.4}
    before, after = sent(stop_s=0.4, **rig), sent({"kind": "drop", "at_s": 0.1, "unit": 2}, stop_s=0.4, **rig)
    assert [packet for packet in before if packet.unit == 0] == [
        packet for packet in after if packet.unit == 0
    ]
    assert not [packet for packet in since(of(after, DATA), 0.1) if packet.unit == 1]


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"events": [{"kind": "drop", "at_s": 1.0, "unit": 2}]}, "events[0].unit of at most 1"),
        ({"events": [{"kind": "drop", "at_s": 1.0, "count": 3, "duration_s": 2.0}]}, "duration_s or count"),
        ({"events": [{"kind": "pps_loss", "at_s": 1.0}], "gps.connected": False}, "gps.connected = true"),
        (
            {"events": [{"kind": "rpm_wobble", "at_s": 1.0}], "sensor": {"model": "free", "beams": 4}},
            'no rpm_wobble (events[0]) beside sensor.model = "free"',
        ),
    ],
)
def test_events_that_cannot_be_are_refused(settings, line):
    """One line names the table and what was expected."""
    with pytest.raises(ScenarioError) as refused:
        load(DEFAULT_UNIT, SETTINGS | settings)
    assert line in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("now", [False, True])
def test_a_stream_sends_the_same(now):
    """What a stream sends is what a recording holds, in its order; moved into the present too, where cut
    packets stay as they are."""
    run, sink = emulator(*EVERY), MemorySink()
    feed = PacketFeed(run.engine, 0.0, 0.4)
    Stream(feed, dict.fromkeys(PacketKind, sink), Pacer(1.0), now=now).run()
    expected = list(run.packets(0.0, 0.4))
    assert [(p.due_ns, p.kind) for p in sink.packets] == [(p.due_ns, p.kind) for p in expected]
    same = [a.payload == b.payload for a, b in zip(sink.packets, expected, strict=True)]
    cut = [len(packet.payload) < (1204 if packet.kind is DATA else 202) for packet in expected]
    assert any(cut)
    assert all(same) if not now else same == cut
