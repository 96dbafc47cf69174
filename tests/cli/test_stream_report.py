"""What a stream reports where it falls behind."""

import pytest

from vlp16emu.cli.printer import behind_text
from vlp16emu.cli.stream import behind_line
from vlp16emu.scenario import load
from vlp16emu.sinks import FellBehind, Late


def test_the_line_names_seconds_cause_policy_and_settings():
    """Where the engine is too slow, one line has how late it is, how fast the engine is, and what keeps up."""
    line = behind_line(FellBehind(14.2, 0.051, True, 0.83), load("birch_walk"), Late.PACE, 1.0)
    assert line == (
        "behind: 0.051 s late at 14.2 s, as the engine computes 0.83 x real time; the delay stays, at the sensor's own "
        "spacing (--late pace); to keep up: --set beam.model=none, or "
        "--set beam.model=none --set sensor.max_range_m=45, or --speed 0.66"
    )


def test_a_stop_is_no_fault_of_the_settings():
    """Where the process stood still no settings are named."""
    line = behind_line(FellBehind(12.3, 5.01, False, 0.1), load("birch_walk"), Late.SKIP, 1.0)
    assert line == (
        "behind: 5.010 s late at 12.3 s, as the process stood still or got no core; late packets are dropped until the "
        "stream is at now (--late skip)"
    )


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "never"),
        (1, "once, by 5.01 s, at 12.3 s: the process stood still or got no core"),
        (2, "2 times, by 5.01 s at most, first at 12.3 s: the process stood still or got no core"),
    ],
)
def test_times_are_summed_up(count, text):
    """Without such a time it is never; one is given as it is; of several the worst and the first."""
    assert behind_text([FellBehind(12.3 + 10 * i, 5.01, False, None, 5.01) for i in range(count)]) == text
