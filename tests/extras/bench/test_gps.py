"""The receiver wired to the sensor, and what happens to its line."""

import pytest
from listening import parse_rmc

from vlp16emu.errors import PacketError
from vlp16emu.extras.bench.changes import DisturbedGps
from vlp16emu.motion.settings import Gps
from vlp16emu.packets.nmea import rmc_time
from vlp16emu.scenario import Scenario
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import MS_NS, S_NS

START_NS = 1_795_255_199 * S_NS
TABLES = {
    "schema": 1,
    "motion": {"kind": "static"},
    "world": {"kind": "hall", "length_m": 20.0, "width_m": 16.0, "height_m": 5.0},
}
ABSENT, SYNC, LOCKED, ERROR = PpsState


def gps_input(*events, **gps):
    made = Scenario.model_validate({**TABLES, "events": list(events)}).events
    return DisturbedGps.of(Gps(canopy_loss=False, **gps), made, START_NS)


def states(made, stop_s=25.0):
    """States of the pulse, each with the second at which it begins."""
    found = []
    for ms in range(-1000, round(1000 * stop_s), 10):
        state = made.pps_at(START_NS + ms * MS_NS)
        if not found or found[-1][1] is not state:
            found.append((ms / 1000, state))
    return found


def fix(second):
    return GnssFix(START_NS + second * S_NS, True, 62.24, 25.75, 1.1, 90.0)


def test_a_lost_pulse_is_absent_and_then_synchronizing():
    """From the first edge that is missed the pulse is absent, and locked again when it was steady for the window."""
    made = gps_input({"kind": "pps_loss", "at_s": 1.3, "duration_s": 3.0}, pps_window_s=4.0)
    assert states(made) == [(-1.0, LOCKED), (2.0, ABSENT), (5.0, SYNC), (9.0, LOCKED)]
    between = gps_input({"kind": "pps_loss", "at_s": 1.3, "duration_s": 0.5})
    assert states(between) == [(-1.0, LOCKED)]


def test_garbled_sentences_are_an_error():
    """From the first garbled sentence to the next good one the state is error, and no such sentence can be read."""
    made = gps_input({"kind": "wrong_sentence", "at_s": 3.0, "duration_s": 2.0})
    assert states(made) == [(-1.0, LOCKED), (3.35, ERROR), (5.35, LOCKED)]
    assert parse_rmc(made.sentence(fix(2), 1)).t_ns == START_NS + 2 * S_NS
    for second in (3, 4):
        with pytest.raises(PacketError):
            rmc_time(made.sentence(fix(second), 1))


@pytest.mark.parametrize("characters", [1, 2, 5, 40])
def test_as_many_characters_are_garbled_as_wanted(characters):
    """The sentence keeps its length and its end; so many characters differ, and its checksum is wrong for each seed."""
    made = gps_input({"kind": "wrong_sentence", "at_s": 0.0, "characters": characters})
    good, seen = gps_input().sentence(fix(2), 1), set()
    for seed in range(40):
        text = made.sentence(fix(2), seed)
        differ = sum(a != b for a, b in zip(good, text, strict=True))
        assert text.endswith(b"\r\n")
        assert characters <= differ <= characters + 1
        with pytest.raises(PacketError):
            rmc_time(text)
        seen.add(text)
    assert len(seen) > 30


def test_void_sentences_count_only_where_valid_ones_are_required():
    """Status V leaves the state locked; where a valid sentence is required the sensor synchronizes anew."""
    event = {"kind": "void_sentence", "at_s": 3.0, "duration_s": 2.0}
    assert states(gps_input(event)) == [(-1.0, LOCKED)]
    made = gps_input(event, requires_valid=True)
    assert states(made) == [(-1.0, LOCKED), (3.35, SYNC), (5.35, LOCKED)]
    assert [parse_rmc(made.sentence(fix(s), 1)).valid for s in (2, 3, 4, 5)] == [True, False, False, True]


def test_late_sentences_are_in_the_buffer_later():
    """A sentence that comes before the next pulse is only late; one that comes after it names the wrong second."""
    made = gps_input({"kind": "late_sentence", "at_s": 3.0, "duration_s": 2.0, "by_s": 0.5})
    assert states(made) == [(-1.0, LOCKED)]
    changes = [
        ms
        for ms in range(1000, 8000, 10)
        if made.second_ns(START_NS + ms * MS_NS) != made.second_ns(START_NS + (ms - 10) * MS_NS)
    ]
    assert changes == [1350, 2350, 3850, 4850, 5350, 6350, 7350]
    later = gps_input({"kind": "late_sentence", "at_s": 3.0, "duration_s": 2.0, "by_s": 0.8})
    assert states(later) == [(-1.0, LOCKED), (4.15, ERROR), (5.35, LOCKED)]


def test_missing_sentences_end_the_lock_after_five_seconds():
    """The last sentence stays in the buffer; when none came for 5 s, the sensor is as one that never had any."""
    made = gps_input({"kind": "missing_sentence", "at_s": 3.0, "duration_s": 20.0})
    assert states(made) == [(-1.0, LOCKED), (7.35, SYNC), (23.35, LOCKED)]
    assert made.second_ns(START_NS + 20 * S_NS) == START_NS + 2 * S_NS
    assert made.second_ns(START_NS + 24 * S_NS) == START_NS + 23 * S_NS


def test_a_sensor_that_starts_has_no_sentence_and_waits_for_its_window():
    """After power-up the buffer is empty until a sentence comes, and the pulse is synchronizing for the window."""
    made = gps_input({"kind": "power_cycle", "at_s": 3.0, "off_s": 2.5})
    assert states(made) == [(-1.0, LOCKED), (3.0, ABSENT), (5.5, SYNC), (10.5, LOCKED)]
    assert made.second_ns(START_NS + 6_340 * MS_NS) is None
    assert made.second_ns(START_NS + 6_350 * MS_NS) == START_NS + 6 * S_NS


@pytest.mark.parametrize("window_s", [0.0, 7.7])
@pytest.mark.parametrize(
    "events",
    [
        [{"kind": "pps_loss", "at_s": 2.2, "duration_s": 3.0}, {"kind": "pps_loss", "at_s": 4.0, "duration_s": 2.0}],
        [{"kind": "wrong_sentence", "at_s": 2.2, "duration_s": 3.0}, {"kind": "power_cycle", "at_s": 15.1}],
        [
            {"kind": "late_sentence", "at_s": 4.0, "duration_s": 9.0, "by_s": 3.3},
            {"kind": "missing_sentence", "at_s": 8.0, "duration_s": 7.0},
        ],
        [{"kind": "missing_sentence", "at_s": 4.0}],
        [],
    ],
)
def test_spans_are_those_of_the_state(events, window_s):
    """Each instant is in the spans of its state alone: every 100 ms, and at and before each border of a span."""
    made = gps_input(*events, pps_window_s=window_s)
    spans = {state: made.spans_ns(state) for state in PpsState}
    borders_ns = {t_ns for some in spans.values() for span in some for t_ns in span if abs(t_ns - START_NS) < 60 * S_NS}
    for t_ns in [START_NS + ms * MS_NS for ms in range(-5_000, 40_000, 100)] + [
        b - n for b in borders_ns for n in (0, 1)
    ]:
        there = [state for state in PpsState if any(begin <= t_ns < end for begin, end in spans[state])]
        assert there == [made.pps_at(t_ns)], t_ns


def test_a_valid_sentence_cannot_be_required_where_trees_decide():
    """The clock is known before light is cast, so what depends on the sky over each second is refused."""
    with pytest.raises(ValueError, match="canopy_loss = false"):
        Gps(requires_valid=True)
