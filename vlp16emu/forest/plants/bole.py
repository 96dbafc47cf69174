"""Branches on the bole, below the crown: dead ones with what is left of their twigs, and some that still live.

The crown base of inventories is the lowest whorl with three living branches (conifers) or the lowest branch that is no
epicormic shoot (broadleaves), so single living branches below it are no contradiction.
"""

import numpy as np

from vlp16emu.elementary import exp
from vlp16emu.forest.plants.branches import GOLDEN_ANGLE, THINNEST_M, Branches, curves, points_along, side_branches
from vlp16emu.forest.plants.species import Habit
from vlp16emu.types import Array

_FREE_M = 0.3
"""Foot of the stem without branches: 0.3 m on average in 4368 unpruned spruces of 45 stands (Forestry Studies 66, 2017,
10.1515/fsmu-2017-0005)."""

_LEAST_REACH_M = 4.0
"""Down to which dead branches have not all fallen, at least: those that died in the last ten years, where the crown base rises by 0.4 m
a year; estimate. In silver birch of 11 to 22 years high density makes branches die early and slows the shedding of dry ones
(Niemisto 1995, Scandinavian Journal of Forest Research 10(3))."""

_KEPT_AT_FOOT = 0.5
"""Share of branches that has not fallen yet where the dead ones end, over that at the crown base; assumption. Whorls lose from none
to twice the mean, so that of those with four branches one in five is bare there."""

_LENGTH_AT_FOOT = 0.55
"""Length of a branch near the ground over that at the crown base, as of the crown's width when each died: of spruces 2.1 m at a DBH of 8 cm
and 3.8 m at 24 cm (Doebbeler et al. 2002); 8 cm is an estimate of the DBH at which crowns close."""

_LENGTHS = (0.4, 1.0)
"""Unbroken lengths within a whorl over the longest; assumption. Branches of a whorl of spruces get thinner by rank (Hein et al. 2007, Forest
Ecology and Management 242), and length goes with thickness."""

_STUB_M = 0.16
"""Most frequent length outside the bark of what is left of a branch where dead ones end, so that 90 % have 0.05 to 0.39 m; estimate, no
published distribution was found. The chance to break grows with the distance from the stem, as a branch is thinner there, and with the
square of the time since its death, as it decays: lengths have a Rayleigh distribution, whose mode falls with that time to the power 1.5."""

_LIVING_DEPTH = 0.3
"""Over the height of the crown base, the most that `living_depth_m` can be: light falls faster below the short crowns of young trees;
assumption."""

_SLENDERNESS = 75.0
"""Length of an unbroken branch over its diameter, which follows from its length (Karkkainen 1972, Silva Fennica 6(2),
2118 spruce branches); the number is an assumption."""

_TWIGS_KEPT, _TWIG_AGE = 0.9, 0.4
"""Share of a dead branch's twigs still on it at the crown base; and the time in which that falls by e, over that in which branches fall;
assumptions."""

_NODES, _TWIG_ORDER = 9, 3
"""Nodes of the curves, as of other branches of the first order; and what order dead twigs are as fine as."""


def bole_branches(
    rng: np.random.Generator, habit: Habit, crown_base_m: float, longest_m: float, stem_m: Array
) -> tuple[Branches, Branches, Branches]:
    """Branches below the crown, in the crown's own frame.

    The chance that one still lives falls with the light: by e for each `living_depth_m` below the crown base. Dead ones are former
    living ones: the crown base has risen past them at an even pace, so the time since their death is as their depth below it.

    `longest_m` is the length of branches at the crown base, and `stem_m` (s,) are radii from there to the ground, evenly spaced.
    Returns living branches of the first order; dead ones; and the dead ones' twigs.
    """
    below_m = max(crown_base_m - _FREE_M, 0.0)
    reach_m = max(habit.dead_reach * below_m, _LEAST_REACH_M)
    depth_m = _depths_m(rng, habit, min(reach_m, below_m), reach_m)
    n = len(depth_m)
    age = depth_m / reach_m
    lives = rng.random(n) < exp(-depth_m / min(habit.living_depth_m, _LIVING_DEPTH * crown_base_m))
    grown = 1 - (1 - _LENGTH_AT_FOOT) * depth_m / max(below_m, 1e-9)
    whole_m = longest_m * grown * rng.uniform(*_LENGTHS, n)
    bark_m = np.interp(depth_m, np.linspace(0, crown_base_m, len(stem_m)), stem_m)
    since = np.maximum(age, 1e-9)
    broken_m = bark_m + rng.rayleigh(_STUB_M / (since * np.sqrt(since)))
    length_m = np.where(lives, whole_m, np.minimum(whole_m, broken_m))
    azimuth = GOLDEN_ANGLE * np.arange(n) + rng.normal(0.0, 0.4, n)
    at = (np.arange(_NODES - 1) + 0.5) / (_NODES - 1)
    rise = habit.rise_deg[0] + rng.normal(0.0, 10.0, (n, 1))
    upturn = np.where(lives, habit.upturn_deg[0], 0.0)[:, None]
    elevation = np.radians(rise - habit.droop_deg[0] * at + upturn * (at * at * at))
    base = np.column_stack([np.zeros((n, 2)), -depth_m])
    whole = curves(rng, base, azimuth, elevation, whole_m, habit.crook_deg)
    # What is left of a branch is its inner part.
    way = np.outer(length_m / whole_m, np.linspace(0, 1, _NODES))
    nodes = points_along(whole, np.repeat(np.arange(n), _NODES), way.ravel())[0].reshape(n, _NODES, 3)
    radius_m = np.maximum(whole_m / _SLENDERNESS / 2, THINNEST_M)
    all_branches = Branches(nodes, azimuth, length_m, radius_m)
    living, dead = (all_branches.of(np.flatnonzero(own)) for own in (lives, ~lives))
    twigs = side_branches(rng, habit.twigs, dead, _TWIG_ORDER)
    twig_age = -twigs.nodes_m[:, 0, 2] / reach_m
    kept = rng.random(len(twig_age)) < _TWIGS_KEPT * exp(-twig_age / _TWIG_AGE)
    return living, dead, twigs.of(np.flatnonzero(kept))


def _depths_m(rng: np.random.Generator, habit: Habit, span_m: float, reach_m: float) -> Array:
    """Depths below the crown base of the branches that have not fallen, those of whorls close together."""
    n = round(span_m * habit.dead_per_m)
    depth_m = span_m * (np.arange(n) + rng.random(n)) / max(n, 1)
    whorl = (depth_m / habit.whorl_spacing_m).astype(np.int64)
    fate = rng.random(n)
    loss = 2 * (1 - _KEPT_AT_FOOT) * rng.random(1 + whorl.max(initial=0))[whorl]
    kept = fate < 1 - loss * depth_m / reach_m
    if habit.branches_per_whorl == 1:
        return depth_m[kept]
    top_m = np.minimum((whorl[kept] + 1) * habit.whorl_spacing_m, span_m)
    return top_m - 0.25 * habit.whorl_spacing_m * rng.random(len(top_m))
