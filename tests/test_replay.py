"""Captures sent again."""

import struct
from itertools import islice, pairwise

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


def restamped(path, out, stamps_ns):
    """Write a capture with other stamps, which `stamps_ns` makes of the number and the stamp of a record."""
    content = bytearray(path.read_bytes())
    at = 24
    number = 0
    while at < len(content):
        seconds, micros, size, _ = struct.unpack_from("<4I", content, at)
        t_ns = stamps_ns(number, seconds * S_NS + micros * 1000)
        struct.pack_into("<2I", content, at, t_ns // S_NS, t_ns % S_NS // 1000)
        at += 16 + size
        number += 1
    out.write_bytes(content)
    return out


@pytest.mark.parametrize(
    ("stamps_ns", "words"),
    [
        (lambda number, _: 1_700_000_000 * S_NS + number * 1000, "us apart"),
        (lambda _, __: 0, "equal"),
        (lambda _, t_ns: t_ns // S_NS * S_NS, "host stamps"),
        (lambda _, t_ns: -(-t_ns // 40_000_000) * 40_000_000, "in batches"),
        (lambda _, t_ns: -(-t_ns // 200_000_000) * 200_000_000, "in batches"),
    ],
)
def test_stamps_that_are_no_pace_are_replaced_by_the_sensors(capture, tmp_path, stamps_ns, words):
    """With lost, rounded or bundled stamps, packets are as far apart as their own stamps are: 24 firing
    sequences of 55.296 us (63-9243 Rev D, section 8.3)."""
    unfit = Replay(restamped(capture, tmp_path / "unfit.pcap", stamps_ns))
    assert words in unfit.paced_by[0]
    data = [packet.due_ns for packet in unfit if packet.kind is PacketKind.DATA]
    steps_ns = [after - before for before, after in pairwise(data)]
    assert {abs(step_ns - 1_327_104) <= 1000 for step_ns in steps_ns} == {True}


def test_good_stamps_stay_the_pace(capture):
    """Packets of a sound capture are due at its stamps."""
    sound = Replay(capture)
    assert sound.paced_by == {}
    assert [packet.due_ns for packet in sound] == [datagram.stamp_ns for datagram in Capture(capture)]


def test_a_clock_that_is_set_back_makes_no_burst(capture, tmp_path):
    """After the host's clock is set back by five hours, packets keep their pace."""
    set_back = restamped(capture, tmp_path / "back.pcap", lambda n, t_ns: t_ns - (n > 90) * 5 * HOUR_NS)
    due_ns = [packet.due_ns for packet in Replay(set_back)]
    assert max(due_ns) - min(due_ns) == pytest.approx(0.3 * S_NS, abs=0.01 * S_NS)
    assert due_ns == sorted(due_ns)
