"""What a run will take, from what short pieces of it took."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Spent:
    """What some piece of a run took."""

    wall_s: float
    cpu_s: float
    """Of all threads together."""
    simulated_s: float = 0.0
    """What came of it; 0 where nothing is emitted yet."""

    def __add__(self, other: "Spent") -> "Spent":
        return Spent(
            self.wall_s + other.wall_s, self.cpu_s + other.cpu_s, self.simulated_s + other.simulated_s
        )


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a run will take."""

    wall_s: float
    """Of the whole command."""
    cpu_s: float
    real_time_factor: float
    """Simulated seconds over those of the whole command."""
    steady_factor: float
    """The same without start and end: what a stream can keep up with."""


def forecast(
    *,
    until_first_packet: Spent,
    pieces: Sequence[Spent],
    windows: float,
    per_window: Spent,
    simulated_s: float,
    spare: float,
) -> Forecast:
    """Extrapolate pieces of a run to the whole.

    Windows to come are opened beside the casting. What they need is taken from cores that casting leaves idle, so
    that they cost time only where there are too few of those.

    Parameters
    ----------
    until_first_packet : from the start of the command on
    pieces : of the run as it is when it runs steadily, all worked on by as many threads as the whole
    windows : still to be opened after the first, each of them as much work as `per_window`
    simulated_s : of the whole run
    spare : cores of the machine over threads of the run, at least 1

    Raises
    ------
    ValueError
        where nothing was simulated in the pieces
    """
    steady = sum(pieces, Spent(0.0, 0.0))
    if not steady.simulated_s > 0.0:
        raise ValueError(f"pieces: found {steady.simulated_s:g} simulated seconds, expected more than 0")
    left_s = max(simulated_s - until_first_packet.simulated_s, 0.0)
    pulses_cpu_s = left_s / steady.simulated_s * steady.cpu_s
    cpu_s = pulses_cpu_s + windows * per_window.cpu_s
    busy = steady.cpu_s / steady.wall_s
    steady_s = max(left_s / steady.simulated_s * steady.wall_s, cpu_s / (busy * spare))
    wall_s = until_first_packet.wall_s + steady_s
    return Forecast(
        wall_s=wall_s,
        cpu_s=until_first_packet.cpu_s + cpu_s,
        real_time_factor=simulated_s / wall_s,
        steady_factor=left_s / steady_s if steady_s else steady.simulated_s / steady.wall_s,
    )
