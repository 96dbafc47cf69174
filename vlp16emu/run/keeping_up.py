"""Settings with which this machine keeps up with a stream."""

import math

from vlp16emu.scenario import Scenario

_MARGIN = 0.9
"""Share of the engine's speed that is asked for: it varies along the walk."""
_SHORT_M = 45.0
_STALLED = 0.1
"""Speed below which the engine waits for something, so that its speed says nothing of settings."""
_ONE_RAY_GAIN, _SHORT_GAIN = 4.0, 2.0
"""About how much faster a forest is with one ray for each pulse, and with a reach of 45 m: `scenes/OUTPUTS.md`, "Packets"."""


def settings_that_keep_up(scenario: Scenario, engine_speed: float, speed: float) -> list[str]:
    """Return options of `stream` with which the engine keeps up, each enough by itself; if it is stalled, those that make it faster.

    Parameters
    ----------
    engine_speed : simulated seconds per second, as measured
    speed : simulated seconds per second asked for
    """
    gains = dict[str, float]()
    if scenario.beam.model != "none":
        gains["--set beam.model=none"] = _ONE_RAY_GAIN
    if scenario.sensor.max_range_m > _SHORT_M:
        gains[f"--set sensor.max_range_m={_SHORT_M:g}"] = _SHORT_GAIN
    if len(gains) > 1:
        gains[" ".join(gains)] = math.prod(gains.values())
    if engine_speed < _STALLED:
        return list(gains)[:2]
    needed = speed / (_MARGIN * engine_speed)
    enough = [options for options, gain in gains.items() if gain >= needed]
    slower = float(f"{_MARGIN * min(engine_speed, speed):.2g}")
    return [*enough[:2], f"--speed {slower:g}"]


def speed_beside_sender(engine_speed: float, sender_share: float, threads: int, cores: int) -> float:
    """Return the engine's speed if the sending thread takes its share of the same cores.

    Parameters
    ----------
    engine_speed : simulated seconds per second without other work
    sender_share : processor seconds per second of the sending thread, in [0, 1)
    threads : workers of the engine
    cores : of the machine
    """
    return engine_speed * min((cores - sender_share) / min(threads, cores), 1.0)
