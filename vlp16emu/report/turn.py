"""How far a sensor turns in a run."""

from dataclasses import dataclass

from vlp16emu.sensor import Head
from vlp16emu.units import S_NS, seconds_to_ns

__all__ = ["Turn", "turn_of"]


@dataclass(frozen=True, slots=True)
class Turn:
    """How fast a sensor turns, how finely it looks around, and how far it gets."""

    rpm: float
    azimuth_step_deg: float
    """From one firing sequence to the next."""
    sequences_per_revolution: float
    revolutions: float
    azimuth_steps: int
    """Whole firing sequences."""


def turn_of(head: Head, simulated_s: float) -> Turn:
    """Measure the turning of a head over a run."""
    rpm, sequences_per_s = head.rotor.rpm, S_NS / head.beams.sequence_ns
    return Turn(
        rpm=rpm,
        azimuth_step_deg=6 * rpm / sequences_per_s,
        sequences_per_revolution=sequences_per_s * 60 / rpm,
        revolutions=simulated_s * rpm / 60.0,
        azimuth_steps=seconds_to_ns(simulated_s) // head.beams.sequence_ns,
    )
