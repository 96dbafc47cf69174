"""Position packets: their bytes, and when they leave."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from vlp16emu.errors import InputError
from vlp16emu.packets import STAMP_LEAD_NS, first_position_packet, pack_position, position_due_ns
from vlp16emu.types import PpsState

START_NS = 1_779_267_600 * 10**9
SENTENCE = b"$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E\r\n"
rates = pytest.mark.parametrize("rate", ["measured", "manual"])


def test_bytes():
    """Without GPS all but the time is zero; with it state and sentence, of 128 bytes at most, stand at 202
    and 206; the clock rolls over."""
    payload = pack_position(0x12345678 * 1000 + 999, PpsState.ABSENT, b"")
    assert payload == bytes(198) + b"\x78\x56\x34\x12" + bytes(310)
    payload = pack_position(0, PpsState.LOCKED, SENTENCE)
    assert payload == bytes(202) + b"\x02\0\0\0" + SENTENCE + bytes(512 - 206 - len(SENTENCE))
    sentence = b"$" + b"x" * 125 + b"\r\n"
    assert pack_position(0, PpsState.LOCKED, sentence)[206:] == sentence + bytes(512 - 206 - 128)
    for clock_ns in (-350_000, 3_600 * 10**9 - 350_000):
        assert pack_position(clock_ns, PpsState.ABSENT, b"")[198:202] == (3_599_999_650).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("sentence", "message"),
    [
        (b"$" + b"x" * 126 + b"\r\n", "pack_position: sentence: 129 bytes; expected at most 128"),
        (b"$GPRMC", "pack_position: sentence: b'$GPRMC'; expected ASCII that ends with CR LF"),
        (b"\xff\r\n", "pack_position: sentence: b'\\xff\\r\\n'; expected ASCII that ends with CR LF"),
        (b"$\0\r\n", "pack_position: sentence: b'$\\x00\\r\\n'; expected ASCII that ends with CR LF"),
    ],
)
def test_refuses_sentences(sentence, message):
    """A sentence that does not fit, or that no receiver sends, is an error that shows it."""
    with pytest.raises(InputError) as error:
        pack_position(0, PpsState.LOCKED, sentence)
    assert str(error.value) == message


def test_rates_are_those_of_real_units_and_of_the_manual():
    """Mean 6.86 ms and 3.17 ms of standard deviation within 0.2 and 5 percent, stamps 0.98 ms younger than
    of data; by the manual 53.8 per second."""
    interval_ms = np.diff(position_due_ns("measured", 1, START_NS, 0, 20_000)) / 1e6
    assert interval_ms.mean() == pytest.approx(6.859, rel=0.002)
    assert interval_ms.std() == pytest.approx(3.165, rel=0.05)
    assert interval_ms.min() >= 1.47
    assert interval_ms.max() <= 10.7
    due_ns = position_due_ns("manual", 1, START_NS, 0, 1000)
    assert due_ns[0] == START_NS
    assert set(np.diff(due_ns)) == {14 * 1_327_104}
    assert pytest.approx(979_000, abs=5_000) == 1_327_104 - STAMP_LEAD_NS


def test_jitter_is_uniform_and_of_the_seed():
    """Against its place in the 102 of a cycle a packet is late by 0 to 0.38 ms, evenly, otherwise per
    seed."""
    late_ms = []
    for seed in (1, 2):
        due_ns = position_due_ns("measured", seed, 0, 0, 102 * 100).reshape(100, 102)
        place_ns = due_ns - np.arange(100)[:, None] * 33 * 16 * 1_327_104
        late_ms.append((place_ns - place_ns.min(axis=0)).ravel() / 1e6)
        assert stats.kstest(late_ms[-1], stats.uniform(0, 0.38).cdf).statistic < 0.02
    assert abs(np.corrcoef(late_ms)[0, 1]) < 0.05


@rates
def test_pieces_make_the_whole(rate):
    """A packet leaves at the same instant whether asked for alone or among others."""
    whole = position_due_ns(rate, 7, START_NS, 0, 500)
    pieces = [position_due_ns(rate, 7, START_NS, n, 1)[0] for n in range(500)]
    assert whole.tolist() == pieces
    assert (np.diff(whole) > 0).all()
    assert whole[0] >= START_NS


@rates
@given(after_ns=st.integers(-(10**9), 8 * 86_400 * 10**9), seed=st.integers(0, 2**63 - 1))
def test_first_packet_at_any_time(rate, after_ns, seed):
    """The packet found for an instant leaves at it or later, and the one before it leaves earlier."""
    t_ns = START_NS + after_ns
    number = first_position_packet(rate, seed, START_NS, t_ns)
    assert number >= 0
    assert position_due_ns(rate, seed, START_NS, number, 1)[0] >= t_ns
    if number:
        assert position_due_ns(rate, seed, START_NS, number - 1, 1)[0] < t_ns


@rates
def test_first_packet_on_the_instant(rate):
    """At the very nanosecond of a packet it is that packet, one later the next."""
    for number, due_ns in enumerate(position_due_ns(rate, 3, START_NS, 0, 300).tolist()):
        assert first_position_packet(rate, 3, START_NS, due_ns) == number
        assert first_position_packet(rate, 3, START_NS, due_ns + 1) == number + 1
