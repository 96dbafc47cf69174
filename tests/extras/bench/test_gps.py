"""The receiver wired to the sensor, and what happens to its line."""

import pytest
from listening import parse_rmc

from vlp16emu.engine.build import gps_input
from vlp16emu.errors import PacketError
from vlp16emu.extras.bench.changes import gps_of
from vlp16emu.extras.bench.events import make_event
from vlp16emu.motion.settings import Gps
from vlp16emu.packets.nmea import rmc_time
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import MS_NS, S_NS

START_NS = 1_795_255_199 * S_NS
ABSENT, SYNC, LOCKED, ERROR = PpsState


def disturbed(*events, **gps):
    return gps_of(gps_input(Gps(canopy_loss=False, **gps), 1), events, START_NS)


def states(made, stop_s=25.0):
    """States of the pulse, each with the second at which it begins."""
    found = []
    for ms in range(-1000, round(1000 * stop_s), 10):
        state = made.pps.at(START_NS + ms * MS_NS)
        if not found or found[-1][1] is not state:
            found.append((ms / 1000, state))
    return found


def fix(second):
    return GnssFix(START_NS + second * S_NS, True, 62.24, 25.75, 1.1, 90.0)


VOID = make_event("void_sentence", 3.0, duration_s=2.0)
LATE = make_event("late_sentence", 3.0, duration_s=2.0, by_s=0.5)
GARBLED = make_event("wrong_sentence", 3.0, duration_s=2.0)
MISSING = make_event("missing_sentence", 3.0, duration_s=20.0)
OFF = make_event("power_cycle", 3.0, off_s=2.5)


@pytest.mark.parametrize(
    ("happening", "settings", "expected"),
    [
        # From the first edge that is missed the pulse is absent, and locked again when it was steady for the
        # window.
        (make_event("pps_loss", 1.3, duration_s=3.0), {}, [(2.0, ABSENT), (5.0, SYNC), (10.0, LOCKED)]),
        (make_event("pps_loss", 1.3, duration_s=0.5), {}, []),
        (GARBLED, {}, [(3.35, ERROR), (5.35, LOCKED)]),
        (VOID, {}, []),
        (VOID, {"requires_valid": True}, [(3.35, SYNC), (5.35, LOCKED)]),
        (LATE, {}, []),
        # One that comes after the next pulse names the wrong second.
        (make_event("late_sentence", 3.0, duration_s=2.0, by_s=0.8), {}, [(4.15, ERROR), (5.35, LOCKED)]),
        # When none came for 5 s the sensor is as one that never had any.
        (MISSING, {}, [(7.35, SYNC), (23.35, LOCKED)]),
        (OFF, {"pps_window_s": 4.0}, [(3.0, ABSENT), (5.5, SYNC), (9.5, LOCKED)]),
    ],
)
def test_the_state_follows_pulses_and_sentences(happening, settings, expected):
    """Locked are steady pulses with sentences that name the second before them; each event ends that as
    the manual says."""
    assert states(disturbed(happening, **settings)) == [(-1.0, LOCKED), *expected]


@pytest.mark.parametrize(
    ("happening", "seconds"),
    [
        (LATE, {2.34: 1, 2.35: 2, 3.84: 2, 3.85: 3, 4.85: 4, 5.35: 5}),
        (MISSING, {20.0: 2, 24.0: 23}),
        (OFF, {6.34: None, 6.35: 6}),
    ],
)
def test_the_buffer_holds_the_last_sentence_that_came(happening, seconds):
    """From 0.35 s after its second on, later if it is late; the last one stays, and after power-up there
    is none."""
    made = disturbed(happening)
    found = {at_s: made.second_ns(START_NS + round(1000 * at_s) * MS_NS) for at_s in seconds}
    assert found == {at_s: None if n is None else START_NS + n * S_NS for at_s, n in seconds.items()}


def test_a_sentence_says_what_happens_to_it():
    """Void ones have the status V, as long as that lasts; garbled ones cannot be read."""
    void, wrong = disturbed(VOID), disturbed(GARBLED)
    assert [parse_rmc(void.sentence(fix(s), 1)).valid for s in (2, 3, 4, 5)] == [True, False, False, True]
    assert parse_rmc(wrong.sentence(fix(2), 1)).t_ns == START_NS + 2 * S_NS
    with pytest.raises(PacketError):
        rmc_time(wrong.sentence(fix(3), 1))


@pytest.mark.parametrize("characters", [1, 2, 5, 40])
def test_as_many_characters_are_garbled_as_wanted(characters):
    """The sentence keeps its length and its end; so many characters differ, and its checksum is wrong for
    each seed."""
    made = disturbed(make_event("wrong_sentence", 0.0, characters=characters))
    good, seen = disturbed().sentence(fix(2), 1), set()
    for seed in range(40):
        text = made.sentence(fix(2), seed)
        differ = sum(a != b for a, b in zip(good, text, strict=True))
        assert text.endswith(b"\r\n")
        assert characters <= differ <= characters + 1
        with pytest.raises(PacketError):
            rmc_time(text)
        seen.add(text)
    assert len(seen) > 30


@pytest.mark.parametrize("window_s", [0.0, 7.7])
@pytest.mark.parametrize(
    "events",
    [
        [make_event("pps_loss", 2.2, duration_s=3.0), make_event("pps_loss", 4.0, duration_s=2.0)],
        [make_event("wrong_sentence", 2.2, duration_s=3.0), make_event("power_cycle", 15.1)],
        [
            make_event("late_sentence", 4.0, duration_s=9.0, by_s=3.3),
            make_event("missing_sentence", 8.0, duration_s=7.0),
        ],
        [make_event("missing_sentence", 4.0)],
        [],
    ],
)
def test_the_state_at_any_instant_is_one_of_the_steps(events, window_s):
    """The steps of the state have the state by the rule at each instant: every 100 ms, and at and before
    each step."""
    made = disturbed(*events, pps_window_s=window_s)
    steps_ns = {t_ns for t_ns, _ in made.pps.steps if abs(t_ns - START_NS) < 60 * S_NS}
    for t_ns in [START_NS + ms * MS_NS for ms in range(-5_000, 40_000, 100)] + [
        step_ns - n for step_ns in steps_ns for n in (0, 1)
    ]:
        assert made.pps.at(t_ns) is made._state_at(t_ns), t_ns


def test_a_valid_sentence_cannot_be_required_where_trees_decide():
    """The clock is known before light is cast, so what depends on the sky over each second is refused."""
    with pytest.raises(ValueError, match="canopy_loss = false"):
        Gps(requires_valid=True)


def test_receivers_send_their_sentence_at_times_of_their_own():
    """With a spread of 0.2 s the delay of 50 receivers fills 0.15 to 0.55 s, by seed; without one each has
    the delay of the scene."""
    spread = Gps(sentence_delay_spread_s=0.2)
    delays_s = [gps_input(spread, seed).sentence_delay_ns / S_NS for seed in range(50)]
    assert 0.15 <= min(delays_s) < 0.2
    assert 0.5 < max(delays_s) <= 0.55
    assert gps_input(spread, 7) == gps_input(spread, 7)
    assert {gps_input(Gps(), seed).sentence_delay_ns for seed in range(5)} == {350 * MS_NS}
