"""How verbs report how far a sensor turns."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from vlp16emu.cli.output import count

if TYPE_CHECKING:
    from vlp16emu.sensor import Head

__all__ = ["revolutions", "turned"]


def turned(head: "Head", simulated_s: float) -> dict[str, Any]:
    """Report how fast a sensor turns, how finely it looks around, and how far it gets in a run."""
    from vlp16emu.units import S_NS, seconds_to_ns

    rpm, sequences_per_s = head.rotor.rpm, S_NS / head.beams.sequence_ns
    return {
        "rpm": rpm,
        "azimuth_step_deg": 6 * rpm / sequences_per_s,
        "sequences_per_revolution": sequences_per_s * 60 / rpm,
        "revolutions": simulated_s * rpm / 60.0,
        "azimuth_steps": seconds_to_ns(simulated_s) // head.beams.sequence_ns,
    }


def revolutions(units: Sequence[dict[str, Any]]) -> str:
    """Write how far sensors turned, once for those that turned alike."""
    texts = (
        f"{round(unit['revolutions'], 1):.12g} of {count(round(unit['sequences_per_revolution']))} firing "
        f"sequences, {unit['azimuth_step_deg']:.4g} deg apart"
        for unit in units
    )
    return "; ".join(dict.fromkeys(texts))
