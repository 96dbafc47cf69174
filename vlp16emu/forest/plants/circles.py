"""Circles along stems, for the far medium, and along branches that leave them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec, norm
from vlp16emu.foliage.tiles import STEM
from vlp16emu.forest.plants.branches import Branches
from vlp16emu.forest.plants.crown import CrownKey, crown_branches, crown_placements
from vlp16emu.forest.plants.flora import Table, Trees
from vlp16emu.forest.plants.stem_rings import FLARE_TOP_M, STEM_CIRCLE, axis_m, second_leaders, stem_rings, tip_radius_m
from vlp16emu.types import Array, PlantPart
from vlp16emu.world.vectors import determinant, places_m, unit


def branch_circles(
    trees: Trees, crowns: Sequence[CrownKey], *, seed: int, table: Table | None = None
) -> NDArray[np.void]:
    """Circles (k,) `STEM_CIRCLE` along the branches of the first order, tree by tree, each from the stem's axis to its tip.

    The crowns of trees (n,) `TREE` are their prototypes, grown from the seed and stretched; a circle has the area of the branch's
    section as it is stretched.
    """
    prototypes = {key: crown_branches(seed, key, table=table) for key in dict.fromkeys(crowns)}
    found = [np.zeros(0, STEM_CIRCLE)]
    for tree, key, world_T_crown in zip(trees, crowns, crown_placements(trees, crowns), strict=True):
        number = 1
        both = PlantPart.BRANCH_FIRST_ORDER, PlantPart.DEAD_BRANCH
        for part, branches in zip(both, prototypes[key], strict=True):
            circles = _stretched(branches, world_T_crown)
            circles["tree"], circles["leader"], circles["part"] = tree["id"], 1, part
            circles["branch"] = (number + np.arange(len(circles)))[:, None]
            circles["above_foot_m"] = circles["z_m"] - tree["z_m"]
            number += len(circles)
            found.append(circles.ravel())
    return np.concatenate(found)


def _stretched(branches: Branches, world_T_crown: Array) -> NDArray[np.void]:
    """Circles (n, m) of branches with m nodes, placed by a transform (3, 4)."""
    world_A, nodes_m = world_T_crown[:, :3], branches.nodes_m
    along = np.gradient(nodes_m, axis=1)
    longer = norm(matvec(world_A, along)) / norm(along)
    circles = np.zeros(nodes_m.shape[:2], STEM_CIRCLE)
    for axis, at_m in enumerate(np.moveaxis(matvec(world_A, nodes_m) + world_T_crown[:, 3], -1, 0)):
        circles[f"{'xyz'[axis]}_m"] = at_m
    # Area times length is volume, which the determinant stretches.
    circles["radius_m"] = branches.node_radius_m * np.sqrt(determinant(world_A) / longer)
    return circles


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
