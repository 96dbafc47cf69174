"""What stems are made of: circles one above the other, around an axis that may bend and fork; sections with ovality, lobes and bark."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, exp, expm1, hypot, sin, tan
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M, taper_radius_m
from vlp16emu.forest.plants.flora import Table, Trees, stem_keys, tapers
from vlp16emu.forest.purpose import Growth
from vlp16emu.random import normal, uniform
from vlp16emu.types import Array, IntArray, PlantPart

_SIGMA_OVER_MEAN = np.sqrt(2 / np.pi)
"""Of either component of a level vector, over its mean length (Rayleigh's distribution)."""
_MOST_BOW = 0.5  # bow over the DBH at most: branches start on the straight axis, which must not leave the stem
_S_SHARE = 0.4  # of the bow, how much the bole bends to and fro besides; assumption
_SWEEP_M = 0.6  # height over which the sweep of the butt dies away by e; assumption
_LOBES, _LOBES_M = (3, 6), 0.45
"""Least and most lobes of a butt, and the height over which they die away by e: deeper flutes at the butt than higher up
(Singleton et al. 2003, Western Journal of Applied Forestry 18); the numbers are assumptions."""
_EGG_SHARE = 0.2  # of the ovality, how much a section is egg-shaped besides; assumption
_RIDGE_VERTICES = 3  # of the mesh to each ridge of the bark at least
_LEADER_SHARE, _LEADER_DEG, _LEADER_GAP = (0.3, 0.5), (15.0, 35.0), (0.1, 0.22)
"""Of a second leader: share of the section at the fork, angle to the first, and how far from it over the width of the
crown, least and most; assumptions."""
_LEADER_TOP = 0.93  # share of the way from fork to tip that it reaches; assumption
_DIRECTIONS = 720  # in which a section is looked at by a tape: what it shows is then right to 1e-5


@dataclass(frozen=True, slots=True)
class StemForms:
    """Forms of n stems.

    A form bends the axis below the crown alone, so that crowns sit straight on the line from foot to tip. It changes the
    outline of a section and never its area.
    """

    bole_m: Array  # (n,) height of the crown base
    bends: Array  # (n, 3, 2) bow and bend to and fro in m, and slope of the butt; east and north
    oval: Array  # (n, 4) ovality, its direction and by how much that turns on each metre upwards, phase of the egg; rad
    lobes: Array  # (n, 3) number, amplitude at the ground over the radius, phase
    surface_roots: Array  # (n,) share of the lobes that have one
    bark: Array  # (n, 6) depth in m at breast height, ridges around the stem if the mesh can have them, four phases
    forks: Array
    """(n, 6) whether there is one, its height over that of the tree, share of the section that the second leader takes,
    slope and distance in m of that leader from the first, its direction in rad."""

    def aside_m(self, above_m: Array) -> Array:
        """Distance (n, r, 2), east and north, of axes from straight ones at heights (n, r) over their feet."""
        u = np.minimum(above_m / np.maximum(self.bole_m, 1e-6)[:, None], 1.0)
        bow = 27 / 4 * u * np.square(1 - u)  # 1 at a third of the bole, level with the line at its end
        to_and_fro = 13.2 * u * np.square(1 - u) * (1 - 3 * u)
        butt = _SWEEP_M * -expm1(-above_m / _SWEEP_M) * np.square(1 - u)
        bends = self.bends[:, None]
        aside: Array = bow[..., None] * bends[:, :, 0] + to_and_fro[..., None] * bends[:, :, 1]
        return aside + butt[..., None] * bends[:, :, 2]

    def outline(self, angle: Array, above_m: Array, radius_m: Array, breast_m: Array) -> Array:
        """Distance of vertices from the axis, (n, r, sides), so that each polygon has the area of its circle.

        Vertices are at angles (n, sides) evenly all around, circles of radii (n, r) at heights (n, r) over the foot; `breast_m`
        (n,) is the radius at breast height.
        """
        theta, z = angle[:, None], above_m[..., None]
        up = np.maximum(z, 0.0)
        ovality, towards, turn, egg = (self.oval[:, i, None, None] for i in range(4))
        shape = 1 + ovality / 2 * cos(2 * (theta - towards - turn * z))
        shape += _EGG_SHARE * ovality / 2 * cos(3 * theta - egg)
        number, size, at = (self.lobes[:, i, None, None] for i in range(3))
        shape += size * exp(-up / _LOBES_M) * cos(number * theta - at)
        shape += self._ridges(theta, z) * _depth(radius_m, breast_m)[..., None]
        step = 2 * np.pi / angle.shape[1]
        size_m = radius_m * np.sqrt(np.pi / polygon_m2(shape, step))
        return shape * size_m[..., None]

    def _ridges(self, theta: Array, z: Array) -> Array:
        """Bark (n, r, sides) over the axis' distance at breast height: ridges that wander upwards, of two widths."""
        depth_m, ridges, a, b, c, d = (self.bark[:, i, None, None] for i in range(6))
        many = np.minimum(np.round(ridges), theta.shape[-1] // _RIDGE_VERTICES)
        few = np.round(0.7 * many)
        wander = 1.5 * sin(2 * np.pi * z / 1.1 + c) + 2.5 * sin(2 * np.pi * z / 4.3 + d)
        wave = 0.6 * cos(many * theta + wander - a) + 0.4 * cos(few * theta - wander - b)
        return depth_m / 2 * wave

    def leader_aside_m(self, above_m: Array, fork_m: Array) -> Array:
        """Distance (n, r, 2) of second leaders from the first, at heights (n, r), of forks at heights (n,)."""
        _, _, _, slope, gap_m, towards = (column[:, None] for column in self.forks.T)
        away_m = gap_m * -expm1(-slope / gap_m * (above_m - fork_m[:, None]))
        return away_m[..., None] * np.stack([cos(towards), sin(towards)], axis=-1)

    def of(self, which: IntArray) -> "StemForms":
        """Return the forms of some of the stems."""
        return StemForms(*(getattr(self, name)[which] for name in self.__slots__))


def stem_forms(trees: NDArray[np.void], *, table: Table | None = None) -> StemForms:
    """Draw the forms of trees (n,) `TREE`, each from its own seed and the keys of its species."""
    keys = stem_keys(trees["species"], table=table)
    keys[:, :9] *= (trees["form"] > 0)[:, None]
    bow, butt_deg, fork_share, low, high, ovality, lobes, roots, bark_mm_per_cm, period_mm = keys.T
    seeds = [int(seed) for seed in trees["form"]]
    g = np.array([normal(seed, Growth.STEM_FORM, 0, 8, 0) for seed in seeds]).reshape(-1, 8)
    u = np.array([uniform(seed, Growth.STEM_FORM, 0, 16, 1) for seed in seeds]).reshape(-1, 16)
    bow_m = (bow * trees["crown_base_m"] * _SIGMA_OVER_MEAN)[:, None] * g[:, :4]
    most_m = _MOST_BOW * trees["dbh_m"]
    bow_m *= np.minimum(1.0, most_m / np.maximum(hypot(bow_m[:, 0], bow_m[:, 1]), 1e-9))[:, None]
    butt = (tan(np.radians(butt_deg)) * _SIGMA_OVER_MEAN)[:, None] * g[:, 4:6]
    oval = ovality * _SIGMA_OVER_MEAN * hypot(g[:, 6], g[:, 7])
    turns = 2 * np.pi * u
    least, most = _LOBES
    depth_m = bark_mm_per_cm * trees["dbh_m"] / 10
    ridges = np.pi * trees["dbh_m"] / (period_mm / 1000)
    gap_m = np.interp(u[:, 1], (0, 1), _LEADER_GAP) * trees["crown_width_m"] + trees["dbh_m"] / 2
    return StemForms(
        bole_m=trees["crown_base_m"],
        bends=np.stack([bow_m[:, :2], _S_SHARE * bow_m[:, 2:], butt], axis=1),
        oval=np.column_stack([oval, turns[:, 2] / 2, 0.2 * (u[:, 3] - 0.5), turns[:, 4]]),
        lobes=np.column_stack([np.floor(least + (most + 1 - least) * u[:, 5]), lobes * (0.5 + u[:, 6]), turns[:, 7]]),
        surface_roots=roots,
        bark=np.column_stack([depth_m, ridges, turns[:, 8:12]]),
        forks=np.column_stack(
            [
                u[:, 12] < fork_share,
                low + (high - low) * u[:, 13],
                np.interp(u[:, 14], (0, 1), _LEADER_SHARE),
                tan(np.radians(np.interp(u[:, 15], (0, 1), _LEADER_DEG))),
                gap_m,
                turns[:, 0],
            ]
        ),
    )


def polygon_m2(away_m: Array, step: float) -> Array:
    """Area (...) of polygons whose corners (..., sides) are so far from a point, by even steps in rad around it."""
    return sin(step) / 2 * (away_m * np.roll(away_m, -1, axis=-1)).sum(axis=-1)


def tape_m(away_m: Array) -> Array:
    """Diameter (n,) that a taut tape shows around polygons (n, sides) as of `polygon_m2`: the mean width of the hull (Cauchy)."""
    sides = away_m.shape[1]
    turn = 2 * np.pi * (np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS - np.arange(sides) / sides)
    return 2 * np.array([(cos(turn) * corners).max(axis=1).mean() for corners in away_m])


def _depth(radius_m: Array, breast_m: Array) -> Array:
    """Depth of bark relief over the radius (n, r), for each m of depth at breast height: less the thinner the stem is."""
    thinner = np.minimum(radius_m / breast_m[:, None], 1.0)
    return np.square(thinner) / np.maximum(radius_m, 1e-6)


FLARE_TOP_M = 0.5  # where the root flare ends and the stem begins, at a ring that both share; assumption
_BURIED_M = 0.1  # how far the foot reaches below level ground
_SIDES, _THICKER_M = np.array([16, 24, 32, 40]), np.array([0.16, 0.3, 0.45])
"""Of a stem's cross-section, and the DBH over which there are more; they are 30 to 40 mm long on most stems."""
_BUTT_M = (0.0, 0.12, 0.28, FLARE_TOP_M, 0.85, BREAST_HEIGHT_M)  # heights of rings from the ground to breast height
_UPPER = (0.035, 0.1, 0.2, 0.33, 0.48, 0.64, 0.8, 0.93)
"""Rings above, as shares of the way from breast height to the tip."""
_LEADER_CIRCLES = 9
STEM_CIRCLE = np.dtype(  # one circle of a stem, or of a branch that leaves it
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
    sides, flare_rings = _SIDES[np.searchsorted(_THICKER_M, trees["dbh_m"])], 2 + _BUTT_M.index(FLARE_TOP_M)
    return StemRings(above_m, radius_m, sides, flare_rings, forms, forked, fork_m)


def second_leaders(trees: Trees, rings: StemRings, shares: Array, *, table: Table | None = None) -> Leaders:
    """Second leaders of stems, with circles at shares (k,) of the way from fork to tip; with the first they are as thick as one stem."""
    own, forms = trees[rings.forked], rings.forms.of(rings.forked)
    length_m = (rings.fork_m + _LEADER_TOP * (own["height_m"] - rings.fork_m)) - rings.fork_m
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
    return taper_radius_m(tapers(trees, table=table), trees["dbh_m"], trees["height_m"], above_m)
