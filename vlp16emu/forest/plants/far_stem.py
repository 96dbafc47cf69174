"""Stems as they are seen from afar: circles along a line."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.foliage.tiles import STEM
from vlp16emu.forest.plants.flora import Table, Trees
from vlp16emu.forest.plants.stem_rings import FLARE_TOP_M, axis_m, second_leaders, stem_rings, tip_radius_m
from vlp16emu.types import Array
from vlp16emu.world.vectors import places_m, unit


def far_stems(trees: Trees, first_row: int, *, table: Table | None = None) -> NDArray[np.void]:
    """Stems of n trees as `STEM`, circles in place of their polygons, then their second leaders; rows count on from the first."""
    rings = stem_rings(trees, table=table)
    above_m = np.column_stack([rings.above_ground_m, trees["height_m"]])
    radius_m = np.column_stack([rings.radius_m, tip_radius_m(trees, table=table)])
    foot_m = places_m(trees)
    first = profiles(foot_m, axis_m(trees, rings.forms, above_m), radius_m, 1)
    first["flare_m"] = FLARE_TOP_M / first["axis"][:, 2]
    first["row"] = first_row + 2 * np.arange(len(trees))[:, None] + [0, 1]
    leaders = second_leaders(trees, rings, np.linspace(0.0, 1.0, above_m.shape[1]), table=table)
    middle_m = leaders.axis_m(leaders.above_ground_m)
    foot_m = foot_m[rings.forked]
    second = profiles(foot_m, middle_m, leaders.radius_m, 0)
    second["flare_m"], second["row"] = -1.0, first["row"][rings.forked]
    return np.concatenate([first, second])


def profiles(foot_m: Array, middle_m: Array, radius_m: Array, begin: int) -> NDArray[np.void]:
    """Make `STEM`s of circles (n, 16) with middles (n, 16, 3) relative to feet (n, 3); `begin` is that of their lines."""
    stems = np.zeros(len(foot_m), STEM)
    from_m = middle_m[:, begin]
    axis = unit(middle_m[:, -1] - from_m)
    along_m = (middle_m[..., 2] - from_m[:, None, 2]) / axis[:, 2:]
    stems["foot_m"] = foot_m + from_m
    stems["axis"], stems["along_m"], stems["radius_m"] = axis, along_m, radius_m
    aside_m = middle_m - from_m[:, None] - along_m[..., None] * axis[:, None]
    stems["aside_m"] = np.moveaxis(aside_m[..., :2], 2, 1)
    return stems
