"""Settings with which this machine would keep up with a stream."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vlp16emu.scenario import Scenario

__all__ = ["settings_that_keep_up"]

_MARGIN = 0.9
"""Share of the engine's speed that is asked for: it varies along the walk."""
_SHORT_M = 45.0
_ONE_RAY_GAIN, _SHORT_GAIN = 4.0, 2.0
"""About how much faster a forest is with one ray for each pulse, and with a reach of 45 m: README, "Use"."""


def settings_that_keep_up(scenario: "Scenario", engine_speed: float, speed: float) -> list[str]:
    """Options of `stream` with which the engine keeps up, each enough by itself; those of quality first.

    Parameters
    ----------
    engine_speed : simulated seconds per second, as measured, above 0
    speed : simulated seconds per second asked for
    """
    gains = dict[str, float]()
    if scenario.beam.model != "none":
        gains["--set beam.model=none"] = _ONE_RAY_GAIN
    if scenario.sensor.max_range_m > _SHORT_M:
        gains[f"--set sensor.max_range_m={_SHORT_M:g}"] = _SHORT_GAIN
    if len(gains) > 1:
        gains[" ".join(gains)] = math.prod(gains.values())
    needed = speed / (_MARGIN * engine_speed)
    enough = [options for options, gain in gains.items() if gain >= needed]
    slower = float(f"{_MARGIN * min(engine_speed, speed):.2g}")
    return [*enough[:2], f"--speed {max(slower, 0.001):g}"]
