"""What stems are made of: circles one above the other, around an axis that may bend and fork."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, sin, tan
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M, taper_radius_m
from vlp16emu.forest.plants.flora import Table, Trees, tapers
from vlp16emu.forest.plants.stem_form import StemForms, stem_forms
from vlp16emu.types import Array, IntArray, PlantPart

FLARE_TOP_M = 0.5
"""Where the root flare ends and the stem begins, at a ring that both share; assumption."""

_BURIED_M = 0.1  # how far the foot reaches below level ground

_SIDES, _THICKER_M = np.array([16, 24, 32, 40]), np.array([0.16, 0.3, 0.45])
"""Of a stem's cross-section, and the DBH over which there are more; they are 30 to 40 mm long on most stems."""

_BUTT_M = (0.0, 0.12, 0.28, FLARE_TOP_M, 0.85, BREAST_HEIGHT_M)  # heights of rings from the ground to breast height

_UPPER = (0.035, 0.1, 0.2, 0.33, 0.48, 0.64, 0.8, 0.93)
"""Rings above, as shares of the way from breast height to the tip."""


_LEADER_CIRCLES = 9

STEM_CIRCLE = np.dtype(
    [
        ("tree", "<u4"),  # instance
        ("leader", "u1"),  # 1 of the stem, 2 of its second leader; branches leave the first
        ("part", "u1"),  # `PlantPart`: stem, branch of the first order, or dead branch
        ("branch", "<u2"),  # its number on the tree, from 1; 0 of a stem
        ("x_m", "<f8"),  # middle, in the world
        ("y_m", "<f8"),
        ("z_m", "<f8"),
        ("above_foot_m", "<f8"),
        ("radius_m", "<f8"),  # of the circle with the section's area, over bark
    ]
)
"""One circle of a stem, or of a branch that leaves it."""


@dataclass(frozen=True, slots=True)
class StemRings:
    """Rings of n stems."""

    above_ground_m: Array  # (n, r) height over the foot at which each meets the axis; the first is buried
    radius_m: Array  # (n, r) of the circle that has the ring's area
    sides: IntArray  # (n,) of the cross-section
    flare_rings: int  # how many of the rings belong to the root flare
    forms: StemForms
    forked: IntArray  # (m,) which stems have a second leader
    fork_m: Array  # (m,) where that begins, a ring's height over the foot


@dataclass(frozen=True, slots=True)
class Leaders:
    """Second leaders of m stems, circle by circle."""

    trees: Trees  # (m,).
    forms: StemForms
    fork_m: Array  # (m,) height over the foot at which they begin
    above_ground_m: Array  # (m, k) heights of the circles
    radius_m: Array  # (m, k).

    def axis_m(self, above_m: Array) -> Array:
        """Points (m, r, 3) of their axes relative to the feet, at heights (m, r)."""
        middle_m = axis_m(self.trees, self.forms, above_m)
        middle_m[..., :2] += self.forms.leader_aside_m(above_m, self.fork_m)
        return middle_m


def stem_rings(trees: Trees, *, table: Table | None = None) -> StemRings:
    """Rings of stems; the first is as wide as the second, however deep it lies."""
    butt = np.broadcast_to((-_BURIED_M, *_BUTT_M), (len(trees), 1 + len(_BUTT_M)))
    upper = BREAST_HEIGHT_M + (trees["height_m"][:, None] - BREAST_HEIGHT_M) * np.array(_UPPER)
    above_m = np.concatenate([butt, upper], axis=1)
    forms = stem_forms(trees, table=table)
    forked = np.flatnonzero(forms.forks[:, 0])
    # The ring that is nearest to a fork moves there: the first leader thins from it to the next.
    fork_m = np.maximum(forms.forks[forked, 1] * trees["height_m"][forked], upper[forked, 0])
    at = butt.shape[1] + np.abs(upper[forked, :-1] - fork_m[:, None]).argmin(axis=1)
    above_m[forked, at] = fork_m
    radius_m = _radius_m(trees, above_m, table)
    over = np.arange(above_m.shape[1]) > at[:, None]
    radius_m[forked] *= np.sqrt(np.where(over, 1 - forms.forks[forked, 2:3], 1.0))
    return StemRings(
        above_ground_m=above_m,
        radius_m=radius_m,
        sides=_SIDES[np.searchsorted(_THICKER_M, trees["dbh_m"])],
        flare_rings=2 + _BUTT_M.index(FLARE_TOP_M),
        forms=forms,
        forked=forked,
        fork_m=fork_m,
    )


def second_leaders(trees: Trees, rings: StemRings, shares: Array, *, table: Table | None = None) -> Leaders:
    """Second leaders of stems, with circles at shares (k,) of the way from fork to tip; with the first they are as thick as one stem."""
    own, forms = trees[rings.forked], rings.forms.of(rings.forked)
    length_m = forms.leader_top_m(rings.fork_m, own["height_m"]) - rings.fork_m
    above_m = rings.fork_m[:, None] + length_m[:, None] * shares
    radius_m = _radius_m(own, above_m, table) * np.sqrt(forms.forks[:, 2:3]) * (shares < 1)
    return Leaders(own, forms, rings.fork_m, above_m, radius_m)


def stem_circles(trees: Trees, *, table: Table | None = None) -> NDArray[np.void]:
    """Circles (n,) `STEM_CIRCLE` along stems and their second leaders, tree by tree, from the ground to the tip."""
    rings = stem_rings(trees, table=table)
    above_m = np.column_stack([rings.above_ground_m[:, 1:], trees["height_m"]])
    radius_m = np.column_stack([rings.radius_m[:, 1:], tip_radius_m(trees, table=table)])
    second = second_leaders(trees, rings, np.linspace(0.0, 1.0, _LEADER_CIRCLES), table=table)
    both = [
        (trees, 1, above_m, radius_m, axis_m(trees, rings.forms, above_m)),
        (second.trees, 2, second.above_ground_m, second.radius_m, second.axis_m(second.above_ground_m)),
    ]
    parts = []
    for own, leader, up_m, half_m, middle_m in both:
        circles = np.zeros(up_m.shape, STEM_CIRCLE)
        circles["tree"], circles["leader"], circles["part"] = own["id"][:, None], leader, PlantPart.STEM
        for axis, name in enumerate("xyz"):
            circles[f"{name}_m"] = own[f"{name}_m"][:, None] + middle_m[..., axis]
        circles["above_foot_m"], circles["radius_m"] = up_m, half_m
        parts.append(circles.ravel())
    circles = np.concatenate(parts)
    return circles[np.lexsort((circles["above_foot_m"], circles["leader"], circles["tree"]))]


def axis_m(trees: Trees, forms: StemForms, above_m: Array) -> Array:
    """Points (n, r, 3) of stems' axes relative to their feet, at heights (n, r)."""
    slope = tan(np.radians(trees["lean_deg"]))
    towards = np.radians(trees["lean_towards_deg"])
    lean = (slope * np.array([cos(towards), sin(towards)])).T
    return np.concatenate([above_m[..., None] * lean[:, None] + forms.aside_m(above_m), above_m[..., None]], axis=2)


def tip_radius_m(trees: Trees, *, table: Table | None = None) -> Array:
    """Radius (n,) at the tip: 0 of a whole tree, more of one that has broken off."""
    return _radius_m(trees, trees["height_m"][:, None], table)[:, 0]


def _radius_m(trees: Trees, above_m: Array, table: Table | None) -> Array:
    return taper_radius_m(tapers(trees["species"], table=table), trees["dbh_m"], trees["height_m"], above_m)
