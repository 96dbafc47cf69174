"""The rung of the ladder on which this machine keeps up with a stream, by measurement."""

import math
import os
import time
from dataclasses import dataclass, replace

from vlp16emu.run.ladder import FREE, Rung, below, gain
from vlp16emu.run.run import Run

_WARM_S, _MEASURED_S = 0.1, 1.5
"""Simulated seconds that open the window and load the kernels, and those that are measured."""


@dataclass(frozen=True, slots=True)
class KeptUp:
    """Rung of a stream, as measured on this machine."""

    rung: Rung | None
    """None for the scene as it is."""
    speed: float
    """Simulated seconds per second on it."""
    enough: bool
    """True if the rung leaves a fifth of the time free."""
    cores: int
    """Cores that this process may use."""
    cores_as_it_is: int
    """Cores like these with which the scene would keep up as it is."""

    @property
    def line(self) -> str:
        """What was found, in words."""
        measured = f"measured {self.speed:.2g} x real time on {self.cores} cores"
        if self.rung is None:
            taken = "the scene as it is"
        else:
            error = f"mean range error about {self.rung.error_mm:g} mm in reference_forest"
            taken = f"{self.rung.name} ({self.rung.options}; {error})"
        line = f"keep-up: {taken}: {measured}"
        if not self.enough:
            line += ", which leaves less than a fifth of the time free: packets may be late"
        return line if self.rung is None and self.enough else f"{line}; as it is with {self.cores_as_it_is} cores"


def keep_up(run: Run, speed: float) -> tuple[Run, KeptUp]:
    """Measure this machine for some seconds, and return the run on the best rung that leaves a fifth of its time free.

    The run as it is comes first; then the rungs that would be fast enough by their gains, from the best one down. A run on
    a rung has the bytes of a recording with its settings.

    Parameters
    ----------
    run : with the settings of the user
    speed : simulated seconds per second asked for
    """
    needed = speed / (1 - FREE)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    own = measured = _speed(run)
    taken, chosen = run, None
    if measured < needed:
        lower = below(run.scenario)
        hopeful = [rung for rung in lower if own * gain(run.scenario, rung) >= needed]
        for rung in hopeful or lower[-1:]:
            taken, chosen = run.with_texts(rung.settings), rung
            measured = _speed(taken)
            if measured >= needed:
                break
    return taken, KeptUp(chosen, measured, measured >= needed, cores, math.ceil(cores * needed / own))


def _speed(run: Run) -> float:
    """Compute a stretch of a run, and return the simulated seconds per second."""
    engine, (_, stop_s) = replace(run.engine, taps=()), run.scenario.span_s(0.0, None)
    for _ in engine.packets(0.0, min(_WARM_S, stop_s)):
        pass
    stop_s, began_s = min(_MEASURED_S, stop_s), time.perf_counter()
    for _ in engine.packets(0.0, stop_s):
        pass
    return stop_s / (time.perf_counter() - began_s)
