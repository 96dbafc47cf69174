"""A real receiver on the sensor's line: state and clock of 63-9243 Rev D, section 9.3.3 and appendix G."""

from datetime import UTC, datetime

import numpy as np
import pynmea2
import pytest

from vlp16emu.extras.bench.gps_in import GpsLine, LineStamps
from vlp16emu.motion.settings import Gps
from vlp16emu.packets import decode_position, pack_position
from vlp16emu.packets.nmea import rmc
from vlp16emu.types import GnssFix, Packet, PacketKind, PpsState
from vlp16emu.units import HOUR_NS, MS_NS, S_NS, US_NS

UTC_NS = int(datetime(2026, 11, 23, 23, 59, 50, tzinfo=UTC).timestamp()) * S_NS  # ten seconds before midnight
HOST_NS = 123_456_789_012  # of the host's clock at that instant


def sentence(second, *, valid=True):
    """The sentence of a second after the first."""
    return rmc(GnssFix(UTC_NS + second * S_NS, valid, 62.5, 25.5, 1.0, 90.0))


def host(second):
    return HOST_NS + round(second * S_NS)


def made(*, is_pulsed=True, **settings):
    """A line that waits for 2 s of steady pulses."""
    gps = Gps(pps_window_s=2.0, sentence_delay_s=0.45, canopy_loss=False, **settings)
    return GpsLine(gps, HOST_NS - 7 * S_NS - 321, is_pulsed=is_pulsed)


def feed(line, seconds, *, valid=True, jitter_ns=0, say=sentence):
    """Pulse at each second, and let its sentence come in two pieces 0.4 s later."""
    random = np.random.default_rng(1)
    for second in seconds:
        line.pulse(host(second) + int(random.integers(jitter_ns + 1)))
        text = say(second, valid=valid)
        line.receive(text[:30], host(second + 0.4))
        line.receive(text[30:], host(second + 0.45))


def off_ns(line, second):
    error = line.clock_ns(host(second)) - (UTC_NS + round(second * S_NS)) % HOUR_NS
    return (error + HOUR_NS // 2) % HOUR_NS - HOUR_NS // 2


def test_pulses_and_sentences_lock_after_the_window():
    """Absent, and time since power-up, without a receiver; synchronizing for the window; then locked to
    UTC, over midnight too."""
    line = made()
    assert (line.state_at(host(0)), line.sentence) == (PpsState.ABSENT, b"")
    assert line.clock_ns(host(0)) == 7 * S_NS + 321
    feed(line, range(2))
    assert line.state_at(host(1.9)) is PpsState.SYNCHRONIZING
    feed(line, range(2, 15))
    assert line.state_at(host(14.9)) is PpsState.LOCKED
    assert off_ns(line, 14.9) == 0
    assert line.sentence == sentence(14)
    assert line.heard.pulses == line.heard.sentences == 15


@pytest.mark.parametrize(
    ("whole", "alone", "states"),
    [
        (range(0), range(6), {5.5: PpsState.SYNCHRONIZING}),
        (range(6), range(0), {6.4: PpsState.LOCKED, 6.6: PpsState.ABSENT}),
        (range(6), range(6, 12), {10.0: PpsState.LOCKED, 11.0: PpsState.SYNCHRONIZING}),
    ],
)
def test_half_a_receiver_leaves_the_clock_where_it_was(whole, alone, states):
    """Pulses alone never lock, the state is absent 1.5 s after the last pulse, and synchronizing 5 s after
    the last sentence."""
    line = made()
    feed(line, whole)
    for second in alone:
        line.pulse(host(second))
    assert {second: line.state_at(host(second)) for second in states} == states
    assert off_ns(line, 100.0) % S_NS == 0  # the fraction of a second is that of the pulses
    assert not whole or off_ns(line, 100.0) == 0


def test_a_garbled_sentence_and_a_bad_pulse_are_errors():
    """A wrong checksum, and a pulse in the middle of a second, are errors until the next good ones; other
    sentences are ignored."""
    line = made()
    feed(line, range(6))
    line.receive(sentence(5).replace(b"N", b"S", 1), host(5.5))
    assert line.state_at(host(5.6)) is PpsState.ERROR
    assert line.heard.refused == 1
    feed(line, range(6, 8))
    assert line.state_at(host(7.5)) is PpsState.LOCKED
    line.receive(b"$GPGSV,1,1,00*79\r\n", host(7.6))
    assert line.state_at(host(7.6)) is PpsState.LOCKED
    line.pulse(host(7.7))
    assert line.state_at(host(7.8)) is PpsState.ERROR


@pytest.mark.parametrize("requires_valid", [True, False])
def test_void_sentences_set_the_clock_unless_valid_ones_are_required(requires_valid):
    """Status V is taken where "Require GPS receiver valid" is off, and not where it is on."""
    line = made(requires_valid=requires_valid)
    feed(line, range(6), valid=False)
    expected = PpsState.SYNCHRONIZING if requires_valid else PpsState.LOCKED
    assert line.state_at(host(5.6)) is expected
    assert (off_ns(line, 5.6) == 0) is not requires_valid


def test_a_receiver_that_searches_is_no_error():
    """A sentence of status V with empty fields, as after a cold start, neither sets the clock nor is an
    error."""

    def searching(_second, *, valid):
        fields = ("", "V", "", "", "", "", "", "", "", "", "", "N")
        return pynmea2.RMC("GP", "RMC", fields).render(newline=True).encode()

    line = made()
    feed(line, range(6), say=searching)
    assert line.state_at(host(5.6)) is PpsState.SYNCHRONIZING
    assert line.heard.refused == 0


def test_stamps_do_not_show_how_late_a_line_was_looked_at():
    """Pulses that are seen up to 1 ms late move the clock by an eighth of that at most, and their mean
    stays in it."""
    line = made()
    feed(line, range(10), jitter_ns=MS_NS)
    steps = []
    for second in range(10, 60):
        before = off_ns(line, second - 0.5)
        feed(line, [second], jitter_ns=MS_NS)
        steps.append(off_ns(line, second + 0.5) - before)
    assert max(map(abs, steps)) <= MS_NS // 8 + 1
    assert abs(off_ns(line, 60.0)) < MS_NS


def test_without_a_line_the_sentence_is_the_pulse():
    """Where no pulse comes, the second began as long before its sentence as is set, and the state locks
    all the same."""
    line = made(is_pulsed=False)
    for second in range(8):
        line.receive(sentence(second), host(second + 0.45))
    assert line.state_at(host(7.9)) is PpsState.LOCKED
    assert off_ns(line, 7.9) == 0


def test_noise_on_the_line_is_bounded():
    """A million bytes without an end of line are forgotten, and the next sentence is heard."""
    line = made()
    for _ in range(1000):
        line.receive(b"\xff" * 1000, host(0))
    line.receive(b"\n" + sentence(0), host(0.4))
    assert line.heard.sentences == 1


def test_packets_carry_the_clock_state_and_sentence_of_the_line():
    """Stamps are those of the first pulse on the receiver's time, evenly apart whatever the host's delay;
    position packets echo."""
    line = made()
    feed(line, range(10))
    delays_ns = [0, 300_000, 20_000, 4 * MS_NS]
    clock = iter(host(9.5) + i * 1_327_104 + late for i, late in enumerate(delays_ns))
    stamps_of = LineStamps(line, clock_ns=lambda: next(clock))
    dues_ns = [5 * S_NS + i * 1_327_104 for i in range(4)]
    made_packets = [
        *(Packet(PacketKind.DATA, due_ns, bytes(1206), 0, due_ns - 1_327_104) for due_ns in dues_ns[:3]),
        Packet(PacketKind.POSITION, dues_ns[3], pack_position(0, PpsState.ABSENT, b"")),
    ]
    sent = [stamps_of.stamp(packet) for packet in made_packets]
    stamps = [int.from_bytes(packet.payload[1200:1204], "little") for packet in sent[:3]]
    first_ns = (UTC_NS + round(9.5 * S_NS)) % HOUR_NS - 1_327_104
    assert stamps == [(first_ns + i * 1_327_104) // US_NS for i in range(3)]
    position = decode_position(sent[3].payload)
    assert position.pps is PpsState.LOCKED
    assert position.sentence == sentence(9)
