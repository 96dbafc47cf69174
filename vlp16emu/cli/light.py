"""What reports tell of the light that is on."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vlp16emu.scenario import Scenario

__all__ = ["light_rows", "light_tree"]


def light_tree(scenario: "Scenario") -> dict[str, Any]:
    """Name the active models of beam, noise and weather; None in clear air."""
    return {
        "beam": scenario.beam.summary,
        "noise": scenario.noise.summary,
        "weather": scenario.weather.summary,
    }


def light_rows(tree: Mapping[str, Any]) -> dict[str, str]:
    """Write that as rows of a report; none for clear air."""
    return {name: tree[name] for name in ("beam", "noise", "weather") if tree[name] is not None}
