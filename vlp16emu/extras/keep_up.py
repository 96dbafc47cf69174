"""Settings with which a stream keeps up: a ladder of beams and ranges, and the rung for which this machine is fast enough."""

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from vlp16emu.cores import usable_cores
from vlp16emu.run.emulator import Emulator
from vlp16emu.scenario import Scenario
from vlp16emu.sinks import FellBehind

_FREE = 0.2  # share of time that a rung leaves for sending, windows of the world and other programs
_STALLED = 0.1  # speed below which the engine waits for something, so settings do not limit it
_WARM_S = 0.1
_MEASURED_S = 1.5
"""Simulated seconds of warm-up, for the window and the kernels, and of measurement."""


@dataclass(frozen=True, slots=True)
class Rung:
    """A rung of the ladder; range and rays are at most the scene's own."""

    rays: int  # greatest number of sub-rays of a pulse
    reach_m: float
    gain: float
    """Approximate speed of a forest relative to the first rung: from us per pulse in
    `tools/results/accuracy.md`, and for the range from `scenes/OUTPUTS.md`."""
    error_mm: (
        float  # mean error of the strongest echo's range in `scenes/reference_forest` by `vlp16emu accuracy`
    )

    @property
    def name(self) -> str:
        """Description of the rung."""
        rays = {1: "one ray", 64: "adaptive, at most 64 sub-rays"}.get(self.rays, f"{self.rays} sub-rays")
        return rays if math.isinf(self.reach_m) else f"{rays}, to {self.reach_m:g} m"

    @property
    def settings(self) -> list[str]:
        """Settings in the form of `--set`; none for the unchanged scene."""
        # The first eight support points are better than eight fixed sub-rays (80 to 91 mm); four support
        # points are not.
        model = "none" if self.rays == 1 else ("fixed" if self.rays == 4 else "adaptive")
        rays = [] if self.rays == 1 else [f"beam.rays={self.rays}"]
        reach = [] if math.isinf(self.reach_m) else [f"sensor.max_range_m={self.reach_m:g}"]
        return [f"beam.model={model}", *rays, *reach]

    @property
    def options(self) -> str:
        """Options of `vlp16emu stream`."""
        return " ".join(f"--set {setting}" for setting in self.settings)


LADDER = (
    Rung(64, math.inf, 1.0, 71.0),
    Rung(8, math.inf, 1.08, 80.0),
    Rung(4, math.inf, 1.25, 138.0),
    Rung(1, math.inf, 3.0, 214.0),
    Rung(1, 45.0, 6.0, 214.0),
)  # no rung has 16 sub-rays: an adaptive pulse of at most 64 casts 8.6 on average, so the gain is small


def below(scenario: Scenario) -> list[Rung]:
    """Return the rungs that make a scene faster, the best first."""
    rays = scenario.beam.rays if scenario.beam.model in ("adaptive", "fixed") else 1
    reach_m = scenario.sensor.max_range_m
    fewer = [rung for rung in LADDER if rung.rays < rays or rung.reach_m < reach_m]
    return [
        rung for rung in fewer if rung.rays <= rays and (rung.reach_m < reach_m or math.isinf(rung.reach_m))
    ]


def enough(scenario: Scenario, engine_speed: float, speed: float) -> list[Rung]:
    """Return the rungs that leave a fifth of the time free according to their gains, the best first.

    Parameters
    ----------
    engine_speed : measured simulated seconds per second of the unchanged scene
    speed : requested simulated seconds per second
    """
    lower = below(scenario)
    own = next((rung for rung in reversed(LADDER) if rung not in lower), LADDER[0])
    return [rung for rung in lower if engine_speed * rung.gain / own.gain * (1 - _FREE) >= speed]


def choose(
    scenario: Scenario, speed: float, measured: Callable[[Rung | None], float]
) -> tuple[Rung | None, float, float]:
    """Return the best rung that leaves a fifth of the time free, its speed, and the speed of the unchanged scene.

    The unchanged scene (None) is first; then the rungs that are fast enough according to their gains, from
    the best down.

    Parameters
    ----------
    speed : requested simulated seconds per second
    measured : returns the simulated seconds per second on a rung
    """
    own = reached = measured(None)
    chosen = None
    lower = below(scenario)
    for rung in (enough(scenario, own, speed) or lower[-1:]) if reached * (1 - _FREE) < speed else ():
        chosen = rung
        reached = measured(rung)
        if reached * (1 - _FREE) >= speed:
            break
    return chosen, reached, own


def settings_that_keep_up(scenario: Scenario, engine_speed: float, speed: float) -> list[str]:
    """Return options of `stream` with which the engine keeps up, each sufficient alone; for a stalled engine, options that make it faster.

    Parameters
    ----------
    engine_speed : measured simulated seconds per second
    speed : requested simulated seconds per second
    """
    if engine_speed < _STALLED:
        return [rung.options for rung in below(scenario)[-2:]]
    slower = float(f"{(1 - _FREE) * min(engine_speed, speed):.2g}")
    return [*(rung.options for rung in enough(scenario, engine_speed, speed)[:2]), f"--speed {slower:g}"]


def keeps_up_with(times: Sequence[FellBehind], scenario: Scenario, speed: float) -> list[str]:
    """Return options with which an engine that fell behind keeps up; none if the engine was not the cause."""
    speeds = [behind.engine_speed for behind in times if behind.engine and behind.engine_speed is not None]
    return settings_that_keep_up(scenario, min(speeds), speed) if speeds else []


@dataclass(frozen=True, slots=True)
class KeptUp:
    """Rung of a stream, chosen by measurement on this machine."""

    rung: Rung | None  # None for the unchanged scene
    speed: float  # simulated seconds per second on it
    enough: bool  # True if the rung leaves a fifth of the time free
    cores: int  # cores that this process may use
    cores_as_it_is: int  # number of such cores with which the unchanged scene would keep up

    @property
    def line(self) -> str:
        """Result as a sentence."""
        measured = f"measured {self.speed:.2g} x real time on {self.cores} cores"
        if self.rung is None:
            taken = "the scene as it is"
        else:
            error = f"mean range error about {self.rung.error_mm:g} mm in reference_forest"
            taken = f"{self.rung.name} ({self.rung.options}; {error})"
        line = f"keep-up: {taken}: {measured}"
        if not self.enough:
            line += ", which leaves less than a fifth of the time free: packets may be late"
        return (
            line
            if self.rung is None and self.enough
            else f"{line}; as it is with {self.cores_as_it_is} cores"
        )


def keep_up(emulator: Emulator, speed: float) -> tuple[Emulator, KeptUp]:
    """Measure this machine for some seconds, and return the emulator with the settings of the rung that `choose` selects.

    Its bytes equal a recording with these settings.

    Parameters
    ----------
    emulator : emulator with the settings of the user
    speed : requested simulated seconds per second
    """
    cores = usable_cores()
    on: dict[Rung | None, Emulator] = {}

    def measured(rung: Rung | None) -> float:
        on[rung] = emulator.changed(rung.settings) if rung else emulator
        return _speed(on[rung])

    rung, reached, own = choose(emulator.scenario, speed, measured)
    needed = speed / (1 - _FREE)
    return on[rung], KeptUp(rung, reached, reached >= needed, cores, math.ceil(cores * needed / own))


def _speed(emulator: Emulator) -> float:
    engine = replace(emulator.engine, taps=())
    (_, stop_s) = emulator.scenario.span_s(0.0, None)
    deque(engine.packets(0.0, min(_WARM_S, stop_s)), 0)
    stop_s = min(_MEASURED_S, stop_s)
    began_s = time.perf_counter()
    deque(engine.packets(0.0, stop_s), 0)
    return stop_s / (time.perf_counter() - began_s)
