"""Kinds of forest by name: what a scene's own keys are laid over."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from vlp16emu.forest.stand.settings import DENSITY_KEYS

Table = Mapping[str, Any]


@cache
def presets() -> Table:
    """All presets by name, each in the form of a `[world]` table. Sources stand in `presets.toml`."""
    text = resources.files("vlp16emu.scenario").joinpath("presets.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def with_preset(own: Table) -> Table:
    """Lay a scene's own `[world]` table over the preset that it names.

    Tables are merged key by key, unless they are of another `kind`; lists replace lists. An unknown
    preset changes nothing here, for the scene's own check names it better.
    """
    name = own.get("preset")
    base = presets().get(name, {}) if isinstance(name, str) else {}
    if own.keys() & DENSITY_KEYS:
        base = {key: value for key, value in base.items() if key not in DENSITY_KEYS}
    return merged(base, own)


def merged(base: Table, own: Table) -> dict[str, Any]:
    """Everything of both tables, the own where both have it; tables in them are merged likewise."""
    both = {**base, **own}
    for key in base.keys() & own.keys():
        if isinstance(base[key], dict) and isinstance(own[key], dict) and _same_kind(base[key], own[key]):
            both[key] = merged(base[key], own[key])
    return both


def _same_kind(base: Table, own: Table) -> bool:
    """Whether the own table says nothing else of its `kind`, and names no preset of its own (`relief`)."""
    return "relief" not in own and bool(own.get("kind", base.get("kind")) == base.get("kind"))
