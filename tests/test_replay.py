"""Captures sent again."""

from itertools import islice

import pytest
from listening import opened, port_of, waiting

from vlp16emu import Emulator, replay
from vlp16emu.captures import Capture
from vlp16emu.errors import InputError
from vlp16emu.extras.bench.retime import stamp_ns
from vlp16emu.extras.replay import Replay
from vlp16emu.types import PacketKind

S_NS, HOUR_NS = 1_000_000_000, 3_600_000_000_000


@pytest.fixture(scope="module")
def capture(each_unit, tmp_path_factory):
    """A third of a second of the hall, with a receiver."""
    path = tmp_path_factory.mktemp("replay") / "bench.pcap"
    Emulator(each_unit, {"gps.connected": True}).record(path, duration_s=0.3)
    return path


@pytest.fixture
def listening():
    """A socket on a free port of the loopback."""
    with opened() as receiver:
        yield receiver


def test_a_capture_is_sent_as_it_is(capture, listening):
    """All payloads arrive in their order and unchanged, and the report counts them."""
    port = port_of(listening)
    report = replay(capture, data_port=port, position_port=port)
    payloads = [datagram.payload for datagram in Capture(capture)]
    assert waiting(listening) == payloads
    assert report.packets + report.position_packets == len(payloads)
    assert report.sent.simulated_s == pytest.approx(0.3, abs=0.01)
    assert (report.passes, report.sent.moved_s, report.left_out, report.interrupted) == (1, 0, 0, False)


def test_time_goes_on_from_pass_to_pass(capture):
    """A loop repeats all packets, a whole number of seconds later each time: deadlines, stamps and
    sentences."""
    once = list(Replay(capture))
    looping = Replay(capture, loop=True)
    thrice = list(islice(looping, 3 * len(once)))
    assert (thrice[: len(once)], looping.passes) == (once, 3)
    for number in (1, 2):
        again = thrice[number * len(once) : (number + 1) * len(once)]
        for before, after in zip(once, again, strict=True):
            assert (after.due_ns - before.due_ns) == number * S_NS
            assert (stamp_ns(after) - stamp_ns(before)) % HOUR_NS == number * S_NS
    sentences = [p.payload[206:221] for p in thrice if p.kind is PacketKind.POSITION]
    assert len({*sentences}) == 3


def test_the_present_is_in_the_bytes(capture, listening):
    """With `now` the stamps of all packets are the capture's, moved by the same whole seconds, and of this
    hour."""
    port = port_of(listening)
    report = replay(capture, data_port=port, position_port=port, now=True)
    arrived = waiting(listening)
    for packet, payload in zip(Replay(capture), arrived, strict=True):
        stamp_us = int.from_bytes(payload[1200:1204] if len(payload) == 1206 else payload[198:202], "little")
        assert stamp_us * 1000 == (stamp_ns(packet) + report.sent.moved_s * S_NS) % HOUR_NS
    assert report.sent.moved_s != 0


def test_the_present_has_its_own_speed(capture):
    """The present at another speed than its own is an error."""
    with pytest.raises(InputError, match="--now"):
        replay(capture, now=True, speed=2.0)
