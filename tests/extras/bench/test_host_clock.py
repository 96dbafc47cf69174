"""Stamps of a capture as a host gives them."""

import numpy as np
import pytest

from vlp16emu.elementary import log
from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.run.record import HostClock, _draw_delay_us
from vlp16emu.scenario.model import CaptureClock
from vlp16emu.types import Packet, PacketKind

START_NS = 1_700_000_000 * 10**9
PACKETS = [Packet(PacketKind.DATA, START_NS + 1_327_104 * i, b"") for i in range(1, 20_001)]


def stamps_ns(packets=PACKETS, **section):
    clock = HostClock(CaptureClock(**section), 5, START_NS)
    return np.array([clock.stamped(packet).due_ns for packet in packets])


@pytest.mark.parametrize(("preset", "low_us", "high_us"), [("quiet_pc", 14, 40), ("busy_pc", 300, 640)])
def test_a_preset_has_the_spacing_of_real_captures(preset, low_us, high_us):
    """Spacing scatters as on real hosts (14 to 640 us), stamps never fall, and the clock is 6 ppm fast."""
    stamps = stamps_ns(preset=preset, host_spread=0.0, ppm=6.0, ahead_ms=0.0)
    due = np.array([packet.due_ns for packet in PACKETS])
    assert low_us < np.diff(stamps).std() / 1e3 < high_us
    assert (np.diff(stamps) >= 0).all()
    late_ns = stamps - due
    assert late_ns.min() >= 0
    assert np.polyfit((due - START_NS) * 1e-9, late_ns * 1e-3, 1)[0] == pytest.approx(6.0, abs=1.5)


def test_hosts_differ_in_their_clocks():
    """Over many seeds the rate is within -15 to 20 ppm for most, and the offset within some milliseconds,
    before or behind."""
    clocks = [HostClock(CaptureClock(), seed, START_NS) for seed in range(200)]
    ppm, ahead_ms = np.array([(clock._ppm, clock._ahead_ms) for clock in clocks]).T
    assert 0.8 < ((ppm > -15) & (ppm < 20)).mean() < 1.0
    assert np.abs(ahead_ms).max() < 15
    assert 0.35 < (ahead_ms > 0).mean() < 0.65


def test_a_piece_has_the_stamps_of_the_whole():
    """They follow from the packet, so a recording in two pieces has those of one; an ideal host changes
    nothing."""
    whole, piece = stamps_ns(preset="quiet_pc"), stamps_ns(PACKETS[777:], preset="quiet_pc")
    np.testing.assert_array_equal(whole[777:], piece)
    assert stamps_ns(PACKETS[:10], preset="ideal").tolist() == [packet.due_ns for packet in PACKETS[:10]]


def test_a_delay_is_that_of_plain_python():
    """The kernel's delays are those of the drawn numbers, to the bit."""
    late = 0
    for number in range(1_700_000_000_000_000, 1_700_000_000_002_000):
        delay_us = 0.75 * abs(float(normal(5, Purpose.CAPTURE_STAMP, number, 1, 9)[0]))
        is_late, how = uniform(5, Purpose.CAPTURE_LATE, 2 * number, 2, 9).tolist()
        if is_late < 0.06:
            late += 1
            delay_us += -900.0 * log(1.0 - how)
        assert _draw_delay_us(5, number, 9, 0.75, 0.06, 900.0) == min(delay_us, 4_500.0)
    assert 80 < late < 160
