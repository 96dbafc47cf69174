"""Constants of the laws of real units, from `laws.toml`, which has the source of each."""

import tomllib
from functools import cache
from importlib.resources import files


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
    return tomllib.loads(files(__package__).joinpath("laws.toml").read_text(encoding="utf-8"))
