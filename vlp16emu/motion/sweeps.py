"""How much a sensor turns and fires on the way."""

from dataclasses import dataclass

from vlp16emu.units import seconds_to_ns

__all__ = ["Sweeps", "sweeps_over"]


@dataclass(frozen=True, slots=True)
class Sweeps:
    """What a run time comes to."""

    revolutions: float
    azimuth_steps: int
    """Whole firing sequences."""


def sweeps_over(run_time_s: float, rpm: float, sequence_ns: int) -> Sweeps:
    """Revolutions and azimuth steps of a sensor that turns for a finite run time.

    Parameters
    ----------
    sequence_ns : from one firing sequence to the next
    """
    return Sweeps(run_time_s * rpm / 60.0, seconds_to_ns(run_time_s) // sequence_ns)
