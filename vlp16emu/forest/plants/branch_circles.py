"""Branches that leave the stem, as circles along their axes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec, norm
from vlp16emu.forest.plants.branches import Branches
from vlp16emu.forest.plants.crown import CrownKey, crown_branches, crown_placements
from vlp16emu.forest.plants.flora import Table, Trees
from vlp16emu.forest.plants.stem_rings import STEM_CIRCLE
from vlp16emu.types import Array, PlantPart
from vlp16emu.world.vectors import determinant


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
