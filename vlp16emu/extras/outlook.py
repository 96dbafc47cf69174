"""Outlook of a stream: whether this machine keeps up with a scene.

It also says with which beams and ranges it would.
"""

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Event
from typing import Self

from vlp16emu.cores import usable_cores
from vlp16emu.run.emulator import Emulator
from vlp16emu.scenario import Scenario
from vlp16emu.sinks import FellBehind

_FREE = 0.2  # share of time that a rung leaves for sending, windows of the world and other programs
_STALLED = 0.1  # speed below which the engine waits for something, so settings do not limit it
_WARM_S = 0.1
_MEASURED_S = 1.5
"""Simulated seconds of warm-up, for the window and the kernels, and of measurement."""
_SCARCE = 1.2
"""Speed below which other programs, for instance a driver on the same machine, may make a stream late."""


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


@dataclass(frozen=True, slots=True)
class Outlook:
    """Whether a stream of a scene keeps up on this machine, and with which settings it would."""

    scenario: Scenario
    engine_speed: float  # simulated seconds per second that this machine computes of the unchanged scene
    speed: float = 1.0  # requested simulated seconds per second
    rung: Rung | None = None  # chosen by measurement; None for the unchanged scene
    rung_speed: float = math.inf  # simulated seconds per second on it

    @classmethod
    def measured(cls, emulator: Emulator, speed: float, stop: Event) -> tuple[Emulator, Self]:
        """Measure this machine for some seconds, and return the emulator with the settings of a rung.

        The unchanged scene is measured first; then the rungs that are fast enough according to their gains,
        from the best down, until one leaves a fifth of the time free. The bytes equal a recording with these
        settings.

        Parameters
        ----------
        emulator : emulator with the settings of the user
        speed : requested simulated seconds per second
        stop : ends the measurement with CancelledError from another thread
        """
        chosen = emulator
        reached = _measured(emulator)
        outlook = cls(emulator.scenario, reached, speed, None, reached)
        for rung in outlook.candidates:
            chosen = emulator.changed(rung.settings).stopped_by(stop)
            outlook = replace(outlook, rung=rung, rung_speed=_measured(chosen))
            if outlook.is_enough:
                break
        return chosen, outlook

    @classmethod
    def advice_after(cls, times: Sequence[FellBehind], scenario: Scenario, speed: float) -> list[str]:
        """Return options with which a late engine keeps up; none if it was not the cause."""
        speeds = [
            behind.engine_speed for behind in times if behind.engine and behind.engine_speed is not None
        ]
        return cls(scenario, min(speeds), speed).advice if speeds else []

    @property
    def keeps_up(self) -> bool:
        """True if the unchanged scene is computed as fast as it is sent."""
        return self.engine_speed >= self.speed

    @property
    def verdict(self) -> str:
        """Whether a stream keeps up, in words."""
        if not self.keeps_up:
            return "no, packets will be late"
        return (
            "yes"
            if self.engine_speed >= _SCARCE * self.speed
            else "yes, with next to nothing left for other programs"
        )

    @property
    def lower(self) -> list[Rung]:
        """Rungs that make the scene faster, the best first."""
        beam = self.scenario.beam
        rays = beam.rays if beam.model in ("adaptive", "fixed") else 1
        reach_m = self.scenario.sensor.max_range_m
        return [
            rung
            for rung in LADDER
            if rung.rays <= rays
            and (rung.reach_m < reach_m or (math.isinf(rung.reach_m) and rung.rays < rays))
        ]

    @property
    def enough(self) -> list[Rung]:
        """Lower rungs that leave a fifth of the time free according to their gains, the best first."""
        lower = self.lower
        present = next((rung for rung in reversed(LADDER) if rung not in lower), LADDER[0])
        return [
            rung for rung in lower if self.engine_speed * rung.gain / present.gain * (1 - _FREE) >= self.speed
        ]

    @property
    def candidates(self) -> list[Rung]:
        """Rungs to choose from, the best first; none if the scene leaves a fifth of the time free."""
        if self.engine_speed * (1 - _FREE) >= self.speed:
            return []
        return self.enough or self.lower[-1:]

    @property
    def advice(self) -> list[str]:
        """Options of `stream` with which the engine keeps up, each sufficient alone.

        For an engine that waits for something they are options that make it faster.
        """
        if self.engine_speed < _STALLED:
            return [rung.options for rung in self.lower[-2:]]
        slower = float(f"{(1 - _FREE) * min(self.engine_speed, self.speed):.2g}")
        return [*(rung.options for rung in self.enough[:2]), f"--speed {slower:g}"]

    @property
    def is_enough(self) -> bool:
        """True if the chosen rung leaves a fifth of the time free."""
        return self.rung_speed * (1 - _FREE) >= self.speed

    @property
    def line(self) -> str:
        """Measurement and choice as a sentence."""
        cores = usable_cores()
        measured = f"measured {self.rung_speed:.2g} x real time on {cores} cores"
        if self.rung is None:
            taken = "the scene as it is"
        else:
            error = f"mean range error about {self.rung.error_mm:g} mm in reference_forest"
            taken = f"{self.rung.name} ({self.rung.options}; {error})"
        line = f"keep-up: {taken}: {measured}"
        if not self.is_enough:
            line += ", which leaves less than a fifth of the time free: packets may be late"
        if self.rung is None and self.is_enough:
            return line
        needed_speed = self.speed / (1 - _FREE)
        return f"{line}; as it is with {math.ceil(cores * needed_speed / self.engine_speed)} cores"


def _measured(emulator: Emulator) -> float:
    """Return the simulated seconds per second that this machine computes."""
    engine = replace(emulator.engine, taps=())
    (_, stop_s) = emulator.scenario.span_s(0.0, None)
    deque(engine.packets(0.0, min(_WARM_S, stop_s)), 0)
    stop_s = min(_MEASURED_S, stop_s)
    began_s = time.perf_counter()
    deque(engine.packets(0.0, stop_s), 0)
    return stop_s / (time.perf_counter() - began_s)
