"""Colours that pictures and twins share: what people expect of a species, not what 903 nm would show."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import U1, PlantPart, Semantic

Rgb = tuple[int, int, int]

_UNKNOWN: tuple[Rgb, Rgb] = (108, 150, 92), (122, 106, 90)
_PLANTS: dict[str, tuple[Rgb, Rgb]] = {
    "norway_spruce": ((47, 93, 74), (110, 84, 67)),
    "scots_pine": ((118, 132, 72), (168, 101, 60)),
    "silver_birch": ((164, 186, 62), (226, 222, 212)),
    "european_beech": ((92, 158, 58), (150, 150, 142)),
    "english_oak": ((140, 138, 44), (107, 95, 82)),
    "sycamore": ((58, 142, 98), (143, 133, 119)),
    "douglas_fir": ((52, 110, 118), (95, 74, 60)),
    "sugar_maple": ((196, 158, 48), (122, 112, 104)),
    "red_maple": ((184, 88, 62), (134, 124, 116)),
    "white_oak": ((152, 160, 84), (141, 135, 123)),
    "black_walnut": ((122, 176, 132), (90, 74, 64)),
    "snag": ((143, 138, 130), (143, 138, 130)),
    "hazel": ((126, 160, 84), (122, 106, 90)),
    "elder": ((84, 130, 72), (122, 106, 90)),
    "hawthorn": ((98, 138, 60), (122, 106, 90)),
    "dogwood": ((150, 164, 96), (122, 106, 90)),
    "honeysuckle": ((112, 152, 112), (122, 106, 90)),
}
"""Of leaves, and of crowns on plans; and of bark."""

_KIND: dict[str, Rgb] = {
    "ground": (150, 128, 94),
    "sapling": (150, 190, 110),
    "shrub": (112, 128, 44),
    "stone": (158, 158, 160),
    "deadwood": (128, 106, 82),
    "log": (128, 106, 82),
    "broken_log": (128, 106, 82),
    "stump": (104, 82, 62),
    "broken_stump": (104, 82, 62),
    "root_plate": (120, 92, 64),
    "grass": (134, 172, 84),
    "tuft": (176, 200, 128),
    "herb": (152, 196, 112),
    "fern": (92, 158, 72),
    "dwarf_shrub": (124, 142, 66),
    "other": (150, 162, 182),
}


def colour_of_species(name: str) -> Rgb:
    """Colour of a species' foliage; of a species that a user has added, a plain green."""
    return _PLANTS.get(name, _UNKNOWN)[0]


def colour_of_kind(kind: str) -> Rgb:
    """Colour of a kind of thing, or of a semantic class in small letters."""
    return _KIND.get(kind, _KIND["other"])


def surface_colours(surfaces: NDArray[np.void], species: Mapping[int, str]) -> U1:
    """Colours (m, 3) of a table of surfaces (m,) `SURFACE`, by the names of species by number."""
    looks = np.column_stack([surfaces[name].astype(np.int64) for name in ("semantic", "part", "species")])
    different, which = np.unique(looks, axis=0, return_inverse=True)
    colours = [_colour(Semantic(s), PlantPart(p), species.get(n, "")) for s, p, n in different.tolist()]
    return np.array(colours, np.uint8).reshape(-1, 3)[which.ravel()]


def _colour(kind: Semantic, part: PlantPart, species: str) -> Rgb:
    if kind not in (Semantic.TREE, Semantic.SHRUB):
        return colour_of_kind(kind.name.lower())
    return _PLANTS.get(species, _UNKNOWN)[part != PlantPart.LEAF]
