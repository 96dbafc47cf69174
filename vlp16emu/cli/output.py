"""How verbs print what they did, and the rows that several of them share."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from vlp16emu.fidelity import AuditFinding
    from vlp16emu.report.turn import Turn

__all__ = ["audit_rows", "count", "light_rows", "print_json", "print_rows", "revolutions", "size", "tree_of"]


def tree_of(result: "DataclassInstance") -> dict[str, Any]:
    """Put a result into the types of JSON; what it says of its `turn` goes beside the rest."""

    def flat(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        """Make the object of one dataclass."""
        tree = dict[str, Any]()
        for name, value in pairs:
            tree |= value if name == "turn" else {name: value}
        return tree

    return asdict(result, dict_factory=flat)


def print_json(tree: Mapping[str, object]) -> None:
    """Print one JSON object."""
    print(json.dumps(tree, indent=2))


def print_rows(title: str, rows: Mapping[str, str]) -> None:
    """Print a title and under it names and values in two columns."""
    print(title)
    width = max(map(len, rows))
    for name, value in rows.items():
        print(f"  {name:<{width}}  {value}")


def count(number: int) -> str:
    """Write a whole number in groups of three digits (ISO 80000-1, section 7.3.1)."""
    return f"{number:,}".replace(",", " ")


def size(number_of_bytes: int) -> str:
    """Write a file's size in MB of a million bytes."""
    return f"{number_of_bytes / 1e6:.1f} MB"


def light_rows(beam: str, noise: str, weather: str | None) -> dict[str, str]:
    """Rows of the active models of beam, noise and weather; none for clear air."""
    return {"beam": beam, "noise": noise} | ({} if weather is None else {"weather": weather})


def revolutions(turns: "Sequence[Turn]") -> str:
    """Write how far sensors turned, once for those that turned alike."""
    texts = (
        f"{round(turn.revolutions, 1):.12g} of {count(round(turn.sequences_per_revolution))} firing "
        f"sequences, {turn.azimuth_step_deg:.4g} deg apart"
        for turn in turns
    )
    return "; ".join(dict.fromkeys(texts))


def audit_rows(found: "AuditFinding | None") -> dict[str, str]:
    """Row of what an audit found; none without one."""
    if found is None:
        return {}
    if found.exact:
        return {"range error": "rounding to float32 only: by the scene's choice a pulse is one ray"}
    if found.range_rmse_m is None:
        return {"range error": f"not known: {found.pulses} pulses cast again had no return"}
    sure = "interval not known from so few"
    if found.range_rmse_low_m is not None and found.range_rmse_high_m is not None:
        sure = f"95 %: {1e3 * found.range_rmse_low_m:.1f} to {1e3 * found.range_rmse_high_m:.1f} mm"
    lost, invented, other = (
        f"{100 * (share or 0.0):.1f} %" for share in (found.lost, found.invented, found.other_echo)
    )
    return {
        "range error": f"RMSE {1e3 * found.range_rmse_m:.1f} mm before noise ({sure}), "
        f"{lost} lost, {invented} invented, {other} of another echo"
    }
