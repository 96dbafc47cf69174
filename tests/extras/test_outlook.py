"""Settings with which a stream keeps up."""

from threading import Event

import pytest

from vlp16emu import Emulator
from vlp16emu.extras import outlook
from vlp16emu.extras.outlook import LADDER, Outlook
from vlp16emu.scenario import load
from vlp16emu.sinks import FellBehind

FEW, ONE_RAY, SHORT = (rung.options for rung in LADDER[2:])


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        (1.02, [FEW, ONE_RAY, "--speed 0.8"]),
        (0.9, [ONE_RAY, SHORT, "--speed 0.72"]),
        (0.22, [SHORT, "--speed 0.18"]),
        (0.11, ["--speed 0.088"]),
        (0.01, [ONE_RAY, SHORT]),
    ],
)
def test_only_settings_that_are_enough_are_named(speed, expected):
    """What gains less than is needed is left out; an engine that stands still has no speed to go by."""
    assert Outlook(load("reference_forest"), speed).advice == expected


def test_settings_that_are_on_already_are_not_named():
    """With one ray and a short reach only a lower speed is left."""
    scenario = load("reference_forest", ["beam.model=none", "sensor.max_range_m=40"])
    assert Outlook(scenario, 0.8).advice == ["--speed 0.64"]


@pytest.mark.parametrize(
    ("speed", "rung"),
    [(2.0, None), (1.25, None), (1.2, LADDER[1]), (1.0, LADDER[2]), (0.5, LADDER[3]), (0.05, LADDER[4])],
)
def test_the_best_rung_that_leaves_a_fifth_free_is_forecast(speed, rung):
    """A rung is as much faster as the ladder says, and the last one is taken where none is enough."""
    assert next(iter(Outlook(load("reference_forest"), speed).candidates), None) == rung


@pytest.mark.parametrize(
    ("speeds", "taken", "enough", "cores"),
    [
        ([1.3], None, True, 2),
        ([1.0, 1.1, 1.9], "one ray", True, 3),
        ([0.1, 0.6], "one ray, to 45 m", False, 25),
    ],
)
def test_a_stream_takes_the_first_rung_that_is_measured_to_be_enough(
    monkeypatch, speeds, taken, enough, cores
):
    """Rungs are measured from the best one that may be enough down; the emulator then has the settings of
    the one taken."""
    left = iter(speeds)
    monkeypatch.setattr(outlook, "_measured", lambda _run: next(left))
    monkeypatch.setattr("os.sched_getaffinity", lambda _process: {0, 1}, raising=False)
    emulator = Emulator("static_bench", {"beam.model": "adaptive", "beam.rays": 64})
    chosen, found = Outlook.measured(emulator, 1.0, Event())
    assert (found.rung.name if found.rung else None, found.is_enough) == (taken, enough)
    assert found.rung is None or found.line.endswith(f"as it is with {cores} cores")
    assert next(left, None) is None
    asked = load("static_bench", ["beam.model=adaptive", *(found.rung.settings if found.rung else [])])
    assert chosen.scenario == asked


def test_the_line_names_rung_settings_error_and_cores(monkeypatch):
    """One line says all that one needs to record the same bytes."""
    monkeypatch.setattr("os.sched_getaffinity", lambda _process: {0, 1}, raising=False)
    scenario = load("reference_forest")
    assert Outlook(scenario, 1.0, rung=LADDER[2], rung_speed=1.4).line == (
        "keep-up: 4 sub-rays (--set beam.model=fixed --set beam.rays=4; mean range error about 138 mm in "
        "reference_forest): measured 1.4 x real time on 2 cores; as it is with 3 cores"
    )
    assert Outlook(scenario, 8.0, rung_speed=8.0).line == (
        "keep-up: the scene as it is: measured 8 x real time on 2 cores"
    )


@pytest.mark.parametrize(
    ("factor", "line"),
    [
        (3.1, "yes"),
        (1.1, "yes, with next to nothing left for other programs"),
        (0.9, "no, packets will be late"),
    ],
)
def test_people_read_whether_a_stream_keeps_up(factor, line):
    """The page says yes or no; a speed that leaves nothing to spare is called that."""
    assert Outlook(load("static_bench"), factor).verdict == line


def test_only_an_engine_that_was_the_cause_is_a_matter_of_settings():
    """A process that stood still gets no advice; of several times the slowest engine counts."""
    birch = load("birch_walk")
    stood_still = FellBehind(12.3, 5.01, False, 0.1)
    times = [stood_still, FellBehind(14.2, 0.051, True, 0.83), FellBehind(20.0, 0.051, True, 0.9)]
    assert Outlook.advice_after([stood_still], birch, 1.0) == []
    assert Outlook.advice_after(times, birch, 1.0) == Outlook(birch, 0.83).advice
