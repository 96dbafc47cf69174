"""Branches on the bole, below the crown: dead ones with what is left of their twigs, and some that still live.

The crown base of inventories is the lowest whorl with three living branches (conifers) or the lowest branch that is no
epicormic shoot (broadleaves), so single living branches below it are no contradiction.
"""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.world.plants.branches import GOLDEN_ANGLE, THINNEST_M, Branches, curves, side_branches
from vlp16emu.world.plants.species import Habit

__all__ = ["bole_branches"]

Array = NDArray[np.float64]

_FREE_M = 0.3
"""Foot of the stem without branches: 0.3 m on average in 4368 unpruned spruces of 45 stands (Forestry Studies 66, 2017,
10.1515/fsmu-2017-0005)."""

_KEPT_AT_FOOT = 0.5
"""Share of branches that has not fallen yet where the dead ones end, over that at the crown base; assumption."""

_LENGTH_AT_FOOT = 0.45
"""Length of a branch there over that at the crown base: it grew on a smaller tree; assumption."""

_BROKEN = (0.3, 1.0)
"""What is left of a dead branch's length, least and most; assumption."""

_SLENDERNESS = 75.0
"""Length of an unbroken branch over its diameter, which follows from its length (Karkkainen 1972, Silva Fennica 6(2),
2118 spruce branches); the number is an assumption."""

_TWIGS_KEPT = (0.7, 0.25)
"""Share of a dead branch's twigs still on it, at the crown base and where dead branches end; assumption."""

_NODES, _TWIG_ORDER = 9, 3
"""Nodes of the curves, as of other branches of the first order; and what order dead twigs are as fine as."""


def bole_branches(
    rng: np.random.Generator, habit: Habit, crown_base_m: float, longest_m: float
) -> tuple[Branches, Branches, Branches]:
    """Branches below the crown, in the crown's own frame.

    The chance that one still lives falls with the light: by e for each `living_depth_m` below the crown base.

    Parameters
    ----------
    longest_m : length of branches at the crown base

    Returns
    -------
    Living branches of the first order; dead ones; and the dead ones' twigs
    """
    span_m = habit.dead_reach * max(crown_base_m - _FREE_M, 0.0)
    n = round(span_m * habit.dead_per_m)
    way = (np.arange(n) + rng.random(n)) / max(n, 1)
    way = way[rng.random(n) < 1 - (1 - _KEPT_AT_FOOT) * way]
    n, depth_m = len(way), way * span_m
    if habit.branches_per_whorl > 1:
        depth_m = np.minimum(np.ceil(depth_m / habit.whorl_spacing_m) * habit.whorl_spacing_m, span_m)
        depth_m -= 0.25 * habit.whorl_spacing_m * rng.random(n)
    lives = rng.random(n) < np.exp(-depth_m / habit.living_depth_m)
    whole_m = longest_m * (1 - (1 - _LENGTH_AT_FOOT) * way) * rng.uniform(0.6, 1.0, n)
    length_m = np.where(lives, whole_m, whole_m * rng.uniform(*_BROKEN, n))
    azimuth = GOLDEN_ANGLE * np.arange(n) + rng.normal(0.0, 0.4, n)
    at = (np.arange(_NODES - 1) + 0.5) / (_NODES - 1)
    rise = habit.rise_deg[0] + rng.normal(0.0, 10.0, (n, 1))
    upturn = np.where(lives, habit.upturn_deg[0], 0.0)[:, None]
    elevation = np.radians(rise - habit.droop_deg[0] * at + upturn * at**3)
    base = np.column_stack([np.zeros((n, 2)), -depth_m])
    nodes = curves(rng, base, azimuth, elevation, length_m, habit.crook_deg)
    radius_m = np.maximum(whole_m / _SLENDERNESS / 2, THINNEST_M)
    living, dead = (
        Branches(nodes[own], azimuth[own], length_m[own], radius_m[own]) for own in (lives, ~lives)
    )
    twigs = side_branches(rng, habit.twigs, dead, _TWIG_ORDER)
    depth = -twigs.nodes_m[:, 0, 2] / max(span_m, 1e-9)
    kept = rng.random(len(depth)) < _TWIGS_KEPT[0] + (_TWIGS_KEPT[1] - _TWIGS_KEPT[0]) * depth
    fine = Branches(twigs.nodes_m[kept], twigs.azimuth[kept], twigs.length_m[kept], twigs.radius_m[kept])
    return living, dead, fine
