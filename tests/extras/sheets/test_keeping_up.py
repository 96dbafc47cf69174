"""Settings with which a stream keeps up."""

import pytest

from vlp16emu.run.keeping_up import settings_that_keep_up, speed_beside_sender
from vlp16emu.scenario import load

ONE_RAY, SHORT = "--set beam.model=none", "--set sensor.max_range_m=45"


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        (0.9, [ONE_RAY, SHORT, "--speed 0.81"]),
        (0.4, [ONE_RAY, f"{ONE_RAY} {SHORT}", "--speed 0.36"]),
        (0.2, [f"{ONE_RAY} {SHORT}", "--speed 0.18"]),
        (0.11, ["--speed 0.099"]),
        (0.01, [ONE_RAY, SHORT]),
    ],
)
def test_only_settings_that_are_enough_are_named(speed, expected):
    """What gains less than is needed is left out; an engine that stands still has no speed to go by."""
    assert settings_that_keep_up(load("reference_forest"), speed, 1.0) == expected


def test_settings_that_are_on_already_are_not_named():
    """With one ray and a short reach only a lower speed is left."""
    scenario = load("reference_forest", ["beam.model=none", "sensor.max_range_m=40"])
    assert settings_that_keep_up(scenario, 0.8, 1.0) == ["--speed 0.72"]


def test_the_sender_takes_its_share_only_where_no_core_is_free():
    """On two cores 10 % of a core cost two workers a twentieth, and one worker nothing."""
    assert speed_beside_sender(2.0, 0.1, 2, 2) == pytest.approx(1.9)
    assert speed_beside_sender(2.0, 0.1, 1, 2) == 2.0
    assert speed_beside_sender(2.0, 0.1, 8, 2) == pytest.approx(1.9)
