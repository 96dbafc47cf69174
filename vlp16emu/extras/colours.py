"""Colours of species, parts and kinds of objects, for pictures, the page and twins.

They are colours that people expect of a species as far as all readers can distinguish them, not its look at
903 nm.
"""

from collections.abc import Mapping
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from vlp16emu.settings import toml
from vlp16emu.types import U1, PlantPart, Semantic

Rgb = tuple[int, int, int]

_TABLES = toml(files("vlp16emu.extras").joinpath("palette.toml").read_text("utf-8"))
_PLANTS: dict[str, tuple[Rgb, Rgb]] = {
    name: (tuple(leaf), tuple(bark)) for name, (leaf, bark) in _TABLES["plants"].items()
}
_KIND: dict[str, Rgb] = {name: tuple(rgb) for name, rgb in _TABLES["kinds"].items()}
PART_RGB: dict[str, Rgb] = {name: tuple(rgb) for name, rgb in _TABLES["parts"].items()}


def colour_of_species(name: str) -> Rgb:
    """Return the colour of a species' foliage; plain green for a user's species."""
    return colours_of_plant(name)[0]


def colours_of_plant(name: str) -> tuple[Rgb, Rgb]:
    """Return the colours of a species' foliage and of its bark."""
    return _PLANTS.get(name, _PLANTS[""])


def colour_of_kind(kind: str) -> Rgb:
    """Return the colour of a kind of object, or of a semantic class in lower case."""
    return _KIND.get(kind, _KIND["other"])


def surface_colours(surfaces: NDArray[np.void], species: Mapping[int, str]) -> U1:
    """Return colours (m, 3) of a table of surfaces (m,) `SURFACE`; `species` are names by number."""
    looks = np.column_stack([surfaces[name].astype(np.int64) for name in ("semantic", "part", "species")])
    different, which = np.unique(looks, axis=0, return_inverse=True)

    def colour(kind: Semantic, part: int, plant: str) -> Rgb:
        if kind not in (Semantic.TREE, Semantic.SHRUB):
            return colour_of_kind(kind.name.lower())
        return colours_of_plant(plant)[part != PlantPart.LEAF]

    colours = [colour(Semantic(s), p, species.get(n, "")) for s, p, n in different.tolist()]
    return np.array(colours, np.uint8).reshape(-1, 3)[which.ravel()]
