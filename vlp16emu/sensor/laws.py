"""Constants of the laws of real units, from `laws.toml`, which has the source of each."""

import tomllib
from functools import cache
from pathlib import Path

_TABLE = Path(__file__).with_name("laws.toml")


def law(name: str) -> float:
    """Return the value of a law, for instance `loss.near_m`."""
    (value,) = span(name)
    return value


def span(name: str) -> tuple[float, ...]:
    """Return all values of a law, as a rule the ends of the span from which a unit draws."""
    section, _, key = name.partition(".")
    value = _laws()[section][key]["value"]
    return tuple(value) if isinstance(value, list) else (value,)


@cache
def _laws() -> dict[str, dict[str, dict[str, float | list[float]]]]:
    return tomllib.loads(_TABLE.read_text(encoding="utf-8"))
