"""Settings with which a stream keeps up."""

import math

import pytest

from vlp16emu import Emulator
from vlp16emu.extras import keep_up
from vlp16emu.extras.keep_up import LADDER, choose, settings_that_keep_up
from vlp16emu.scenario import load

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
    assert settings_that_keep_up(load("reference_forest"), speed, 1.0) == expected


def test_settings_that_are_on_already_are_not_named():
    """With one ray and a short reach only a lower speed is left."""
    scenario = load("reference_forest", ["beam.model=none", "sensor.max_range_m=40"])
    assert settings_that_keep_up(scenario, 0.8, 1.0) == ["--speed 0.64"]


@pytest.mark.parametrize(
    ("speed", "rung"),
    [(2.0, None), (1.25, None), (1.2, LADDER[1]), (1.0, LADDER[2]), (0.5, LADDER[3]), (0.05, LADDER[4])],
)
def test_the_best_rung_that_leaves_a_fifth_free_is_forecast(speed, rung):
    """A rung is as much faster as the ladder says, and the last one is taken where none is enough."""
    forecast = choose(load("reference_forest"), 1.0, lambda rung: math.inf if rung else speed)
    assert forecast[0] == rung


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
    """Rungs are measured from the best one that may be enough down; the emulator then has the settings of the one taken."""
    left = iter(speeds)
    monkeypatch.setattr(keep_up, "_speed", lambda _run: next(left))
    monkeypatch.setattr("os.sched_getaffinity", lambda _process: {0, 1}, raising=False)
    emulator = Emulator("static_bench", {"beam.model": "adaptive", "beam.rays": 64})
    kept = emulator.keep_up()
    assert (kept.rung.name if kept.rung else None, kept.enough, kept.cores_as_it_is) == (taken, enough, cores)
    assert next(left, None) is None
    asked = load("static_bench", ["beam.model=adaptive", *(kept.rung.settings if kept.rung else [])])
    assert emulator.scenario == asked


def test_the_line_names_rung_settings_error_and_cores(monkeypatch):
    """One line says all that one needs to record the same bytes."""
    kept = keep_up.KeptUp(LADDER[2], 1.4, enough=True, cores=2, cores_as_it_is=3)
    assert kept.line == (
        "keep-up: 4 sub-rays (--set beam.model=fixed --set beam.rays=4; mean range error about 138 mm in "
        "reference_forest): measured 1.4 x real time on 2 cores; as it is with 3 cores"
    )
    monkeypatch.setattr(keep_up, "_speed", lambda _run: 8.0)
    assert (
        Emulator("static_bench")
        .keep_up()
        .line.startswith("keep-up: the scene as it is: measured 8 x real time on ")
    )
