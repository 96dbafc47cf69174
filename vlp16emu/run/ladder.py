"""A ladder of settings with which a stream is computed faster."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from vlp16emu.scenario import Scenario

_MARGIN = 0.9
"""Share of the engine's speed that is asked for by hand: it varies along the walk."""
FREE = 0.2
"""Share of the time that a rung leaves free: for sending, for windows of the world, and for other programs."""
_STALLED = 0.1
"""Speed below which the engine waits for something, so that its speed says nothing of settings."""


@dataclass(frozen=True, slots=True)
class Rung:
    """A rung of the ladder; reach and rays are no more than the scene's own."""

    rays: int
    """Most sub-rays of a pulse."""
    reach_m: float
    gain: float
    """About how much faster a forest is than on the first rung: us per pulse in `tools/results/accuracy.md`, and for the
    reach `scenes/OUTPUTS.md`."""
    error_mm: float
    """Mean error of the strongest echo's range in `scenes/reference_forest` by `vlp16emu accuracy`."""

    @property
    def name(self) -> str:
        """The rung in words."""
        rays = {1: "one ray", 64: "adaptive, at most 64 sub-rays"}.get(self.rays, f"{self.rays} sub-rays")
        return rays if math.isinf(self.reach_m) else f"{rays}, to {self.reach_m:g} m"

    @property
    def settings(self) -> list[str]:
        """What `--set` takes; none for a scene as it is."""
        # The first eight support points are better than eight fixed sub-rays (38 to 53 mm), but no four of them are.
        model = "none" if self.rays == 1 else ("fixed" if self.rays == 4 else "adaptive")
        rays = [] if self.rays == 1 else [f"beam.rays={self.rays}"]
        reach = [] if math.isinf(self.reach_m) else [f"sensor.max_range_m={self.reach_m:g}"]
        return [f"beam.model={model}", *rays, *reach]

    @property
    def options(self) -> str:
        """Options of `vlp16emu stream`."""
        return " ".join(f"--set {setting}" for setting in self.settings)


LADDER = (
    Rung(64, math.inf, 1.0, 26.0),
    Rung(8, math.inf, 1.08, 38.0),
    Rung(4, math.inf, 1.25, 75.0),
    Rung(1, math.inf, 3.0, 120.0),
    Rung(1, 45.0, 6.0, 120.0),
)
"""No rung has 16 sub-rays: an adaptive pulse of at most 64 casts 8.6 on average, so that it gains next to nothing."""


def below(scenario: Scenario) -> list[Rung]:
    """Return the rungs on which a scene is faster than as it is, the best first."""
    beam = scenario.beam
    rays = beam.rays if beam.model in ("adaptive", "fixed") else 1
    reach_m = scenario.sensor.max_range_m
    fewer = [rung for rung in LADDER if rung.rays < rays or rung.reach_m < reach_m]
    return [rung for rung in fewer if rung.rays <= rays and (rung.reach_m < reach_m or math.isinf(rung.reach_m))]


def gain(scenario: Scenario, rung: Rung) -> float:
    """Return about how much faster a scene is on a rung."""
    lower = below(scenario)
    own = next((each for each in reversed(LADDER) if each not in lower), LADDER[0])
    return rung.gain / own.gain


def rung_for(scenario: Scenario, engine_speed: float, speed: float) -> Rung | None:
    """Return the rung that `keep_up` takes by the gains alone; None for the scene as it is."""
    needed = speed / (1 - FREE)
    if engine_speed >= needed or not (lower := below(scenario)):
        return None
    return next((rung for rung in lower if engine_speed * gain(scenario, rung) >= needed), lower[-1])


def settings_that_keep_up(scenario: Scenario, engine_speed: float, speed: float) -> list[str]:
    """Return options of `stream` with which the engine keeps up, each enough by itself; if it is stalled, those that make it faster.

    Parameters
    ----------
    engine_speed : simulated seconds per second, as measured
    speed : simulated seconds per second asked for
    """
    lower = below(scenario)
    if engine_speed < _STALLED:
        return _options(lower[-2:])
    needed = speed / (_MARGIN * engine_speed)
    slower = float(f"{_MARGIN * min(engine_speed, speed):.2g}")
    enough = [rung for rung in lower if gain(scenario, rung) >= needed]
    return [*_options(enough[:2]), f"--speed {slower:g}"]


def _options(rungs: Iterable[Rung]) -> list[str]:
    return [rung.options for rung in rungs]


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
