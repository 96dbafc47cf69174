"""Kinds of forest by name: what a scene's own keys are laid over."""

import tomllib
from collections.abc import Collection
from functools import cache
from importlib import resources

from vlp16emu.settings import Table, merged


@cache
def presets() -> Table:
    """All presets by name, each in the form of a `[world]` table. Sources stand in `presets.toml`."""
    text = resources.files("vlp16emu.forest").joinpath("presets.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def with_preset(own: Table, density_keys: Collection[str]) -> Table:
    """Lay a scene's own `[world]` table over the preset that it names, as `merged` does; an unknown preset changes nothing."""
    name = own.get("preset")
    base = presets().get(name, {}) if isinstance(name, str) else {}
    if own.keys() & density_keys:
        base = {key: value for key, value in base.items() if key not in density_keys}
    return merged(base, own)
