"""Stems: two meshes per tree, root flare and stem, together closed and exact at breast height.

A ring of vertices lies where a stem's axis is 1.3 m above the ground at its foot. Perpendicular to the axis,
the mesh's cross-section there has exactly the area of a circle of the recorded diameter. A second leader is a
closed part of the stem's mesh that begins within the first leader; its tip is the mesh's last vertex.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import atan2, cos, exp, expm1, hypot, matvec, norm, sin, tan
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M, taper_radius_m
from vlp16emu.forest.plants.branches import merge, pipe_faces
from vlp16emu.forest.plants.species import Table, Trees, flare_height_m, flares_m, flora, swell_m, tapers
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.tiles import TileKey
from vlp16emu.random import normal, uniform
from vlp16emu.types import F8, I8, HeightField, Mesh, PlantPart
from vlp16emu.world.vectors import places_m, unit

_SIGMA_OVER_MEAN = np.sqrt(2 / np.pi)
"""Standard deviation of each component of a level vector over its mean length (Rayleigh's distribution)."""
_MOST_BOW = 0.5
"""Greatest bow over the DBH: branches start on the straight axis, which must stay within the stem."""
_LEAST_BOLE_M = 0.1
"""Least length over which a stem bends, for crowns that begin at the ground."""
_LOWEST_BEND = -0.25
"""Lowest height of a bend over the length of the bole: below the ground bends go on as polynomials, which
would carry the buried foot of a bole of decimetres away."""
_S_SHARE = 0.4  # amplitude of the S-shaped bend over the bow; assumption
_SWEEP_M = 0.6  # height over which the sweep of the butt falls to 1/e; assumption
_LOBES = (3, 6)
_LOBES_HEIGHT = 0.9
"""Range of the number of lobes of a butt, and the height over which they fall to 1/e over that of the root
flare: flutes are deeper at the butt than higher up (Singleton et al. 2003, Western Journal of Applied
Forestry 18); the numbers are assumptions."""
_EGG_SHARE = 0.2  # egg-shaped component of a section over the ovality; assumption
_RIDGE_VERTICES = 3  # fewest mesh vertices per bark ridge
_LEADER_SHARE = (0.3, 0.5)
_LEADER_DEG = (15.0, 35.0)
_LEADER_GAP = (0.1, 0.22)
"""Ranges for a second leader: share of the section at the fork, angle to the first leader, and distance from
it over the crown width; assumptions."""
_LEADER_TOP = 0.93  # height of its tip, as a share of the way from fork to tip; assumption
_BENT = [0, 1, 2, 3, 4, 5, 6, 8, 9]  # keys of `StemForm` that straight and round stems lack
_GAUSS = 1 / np.sqrt(12)  # a point of the Gauss-Legendre rule of two points, on an interval of -0.5 to 0.5
_DIRECTIONS = 720  # directions for a tape measurement of a section: accurate to 1e-5


@dataclass(frozen=True, slots=True)
class StemForms:
    """Forms of n stems.

    A form bends the axis only below the crown, so that crowns are straight on the line from foot to tip. It
    changes the outline of a section but not its area.
    """

    bole_m: F8  # (n,) height of the crown base
    bends: F8  # (n, 3, 2) bow and S-shaped bend in m, and slope of the butt; east and north
    oval: F8  # (n, 4) ovality, its direction and its twist per metre upwards, phase of the egg shape; rad
    # (n, 4) number, amplitude at the ground over the radius, phase of lobes, height of 1/e of the amplitude
    # in m
    lobes: F8
    surface_roots: F8  # (n,) share of the lobes that have a surface root
    # (n, 6) depth in m at breast height, ridges around the stem if the mesh can have them, four phases
    bark: F8
    forks: F8
    """(n, 6) fork: 1 if there is one, its height over the tree's height, share of the section of the second
    leader, slope and distance in m of that leader from the first, its direction in rad."""

    def aside_m(self, above_m: F8) -> F8:
        """Offset (n, r, 2), east and north, of axes from straight lines at heights (n, r) over their feet."""
        u = np.clip(above_m / np.maximum(self.bole_m, _LEAST_BOLE_M)[:, None], _LOWEST_BEND, 1.0)
        bow = 27 / 4 * u * np.square(1 - u)  # 1 at a third of the bole, with slope 0 at its end
        to_and_fro = 13.2 * u * np.square(1 - u) * (1 - 3 * u)
        # Straight below the ground, where the curve would leave the foot of a thick stem by metres.
        swept_m = _SWEEP_M * -expm1(-np.maximum(above_m, 0.0) / _SWEEP_M) + np.minimum(above_m, 0.0)
        butt = swept_m * np.square(1 - u)
        bends = self.bends[:, None]
        aside: F8 = bow[..., None] * bends[:, :, 0] + to_and_fro[..., None] * bends[:, :, 1]
        return aside + butt[..., None] * bends[:, :, 2]

    def outline(self, angle: F8, above_m: F8, radius_m: F8, breast_m: F8) -> F8:
        """Distance (n, r, sides) of vertices from the axis, so that each polygon has the area of its circle.

        Vertices are at evenly spaced angles (n, sides), circles have radii (n, r) at heights (n, r) over the
        foot; `breast_m` (n,) is the radius at breast height.
        """
        theta = angle[:, None]
        z = above_m[..., None]
        up = np.maximum(z, 0.0)
        ovality, towards, turn, egg = (self.oval[:, i, None, None] for i in range(4))
        shape = 1 + ovality / 2 * cos(2 * (theta - towards - turn * z))
        shape += _EGG_SHARE * ovality / 2 * cos(3 * theta - egg)
        number, size, at, high_m = (self.lobes[:, i, None, None] for i in range(4))
        shape += size * exp(-up / high_m) * cos(number * theta - at)
        # Bark: ridges of two widths that wander upwards, and are shallower on thinner stems.
        depth_m, ridges, a, b, c, d = (self.bark[:, i, None, None] for i in range(6))
        many = np.minimum(np.round(ridges), theta.shape[-1] // _RIDGE_VERTICES)
        few = np.round(0.7 * many)
        wander = 1.5 * sin(2 * np.pi * z / 1.1 + c) + 2.5 * sin(2 * np.pi * z / 4.3 + d)
        wave = 0.6 * cos(many * theta + wander - a) + 0.4 * cos(few * theta - wander - b)
        thinner = np.minimum(radius_m / breast_m[:, None], 1.0)
        shape += depth_m / 2 * wave * (np.square(thinner) / np.maximum(radius_m, 1e-6))[..., None]
        step = 2 * np.pi / angle.shape[1]
        size_m = radius_m * np.sqrt(np.pi / polygon_m2(shape, step))
        return shape * size_m[..., None]

    def select(self, rows: I8 | slice) -> "StemForms":
        """Return the forms of the selected stems."""
        return StemForms(*(getattr(self, name)[rows] for name in self.__slots__))


def stem_forms(trees: NDArray[np.void], *, table: Table | None = None) -> StemForms:
    """Draw the forms of trees (n,) `TREE`, each from its own seed and the keys of its species."""
    rows = {species.number: species.stem.row for species in (table or flora().trees).values()}
    keys = np.array([rows[number] for number in trees["species"].tolist()]).reshape(-1, 11)
    keys[:, _BENT] *= (trees["form"] > 0)[:, None]
    bow, butt_deg, fork_share, low, high, ovality, lobes, flare, roots, bark_mm_per_cm, period_mm = keys.T
    seeds = [int(seed) for seed in trees["form"]]
    g = np.array([normal(seed, Growth.STEM_FORM, 0, 8, 0) for seed in seeds]).reshape(-1, 8)
    u = np.array([uniform(seed, Growth.STEM_FORM, 0, 16, 1) for seed in seeds]).reshape(-1, 16)
    bow_m = (bow * trees["crown_base_m"] * _SIGMA_OVER_MEAN)[:, None] * g[:, :4]
    most_m = _MOST_BOW * trees["dbh_m"]
    bow_m *= np.minimum(1.0, most_m / np.maximum(hypot(bow_m[:, 0], bow_m[:, 1]), 1e-9))[:, None]
    butt = (tan(np.radians(butt_deg)) * _SIGMA_OVER_MEAN)[:, None] * g[:, 4:6]
    oval = ovality * _SIGMA_OVER_MEAN * hypot(g[:, 6], g[:, 7])
    turns = 2 * np.pi * u
    least_lobes, most_lobes = _LOBES
    depth_m = bark_mm_per_cm * trees["dbh_m"] / 10
    ridges = np.pi * trees["dbh_m"] / (period_mm / 1000)
    gap_m = np.interp(u[:, 1], (0, 1), _LEADER_GAP) * trees["crown_width_m"] + trees["dbh_m"] / 2
    return StemForms(
        bole_m=trees["crown_base_m"],
        bends=np.stack([bow_m[:, :2], _S_SHARE * bow_m[:, 2:], butt], axis=1),
        oval=np.column_stack([oval, turns[:, 2] / 2, 0.2 * (u[:, 3] - 0.5), turns[:, 4]]),
        lobes=np.column_stack(
            [
                np.floor(least_lobes + (most_lobes + 1 - least_lobes) * u[:, 5]),
                lobes * (0.5 + u[:, 6]),
                turns[:, 7],
                _LOBES_HEIGHT * swell_m(flare_height_m(flare, trees["dbh_m"])),
            ]
        ),
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


def polygon_m2(away_m: F8, step: float) -> F8:
    """Area (...) of polygons with corners at distances (..., sides), at even steps around a point."""
    return sin(step) / 2 * (away_m * np.roll(away_m, -1, axis=-1)).sum(axis=-1)


def tape_m(away_m: F8) -> F8:
    """Diameter (n,) by tape of polygons (n, sides) as in `polygon_m2`.

    It is the mean width of the hull (Cauchy).
    """
    sides = away_m.shape[1]
    turn = 2 * np.pi * (np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS - np.arange(sides) / sides)
    return 2 * np.array([(cos(turn) * corners).max(axis=1).mean() for corners in away_m])


def half_width_m(away_m: F8) -> F8:
    """Half of the mean width (...) of polygons (..., sides) as in `polygon_m2`, as far light meets them.

    One direction per side is enough, at a point of Gauss and Legendre: within 0.1 % of `tape_m` on average.
    """
    sides = away_m.shape[-1]
    corners = np.arange(sides)
    towards = cos(2 * np.pi / sides * (corners[:, None] + _GAUSS - corners))
    half_m: F8 = (towards * away_m[..., None, :]).max(axis=-1).mean(axis=-1)
    return half_m


_BURIED_M = 0.1  # depth of the foot below level ground, or below the lowest ground around it
_SIDES = np.array([16, 24, 32, 40])
_THICKER_M = np.array([0.16, 0.3, 0.45])
"""Sides of a stem's cross-section, and the DBH above which there are more; sides are 30 to 40 mm long on most
stems."""
_FLARE = (0.0, 0.24, 0.56, 1.0)
"""Heights of rings of the root flare over its height: the highest is shared with the stem."""
_BETWEEN = 0.45
"""Height of one more ring below that at breast height, as a share of the way from the flare's top."""
_UPPER = (0.035, 0.1, 0.2, 0.33, 0.48, 0.64, 0.8, 0.93)
"""Further rings, as shares of the way from breast height to the tip."""
_LEADER_CIRCLES = 9
STEM_CIRCLE = np.dtype(  # one circle of a stem or of a first-order branch
    [
        ("tree", "<u4"),  # instance
        ("leader", "u1"),  # 1 for the stem, 2 for its second leader; branches belong to 1
        ("part", "u1"),  # `PlantPart`: stem, branch of the first order, or dead branch
        ("branch", "<u2"),  # number on the tree, from 1; 0 for a stem
        ("x_m", "<f8"),  # centre, in the world
        ("y_m", "<f8"),
        ("z_m", "<f8"),
        ("above_foot_m", "<f8"),
        ("radius_m", "<f8"),  # radius of the circle with the section's area, over bark
    ]
)


def circles_of(
    trees: Trees, leader: int, part: PlantPart, at_m: F8, radius_m: F8, branch: I8 | int = 0
) -> NDArray[np.void]:
    """Return circles (n, r) `STEM_CIRCLE` of trees (n,).

    Centres (n, r, 3) in the world, radii and branch numbers (n, r).
    """
    circles = np.zeros(radius_m.shape, STEM_CIRCLE)
    circles["tree"] = trees["id"][:, None]
    circles["leader"] = leader
    circles["part"] = part
    circles["x_m"], circles["y_m"], circles["z_m"] = np.moveaxis(at_m, -1, 0)
    circles["radius_m"] = radius_m
    circles["branch"] = branch
    return circles


class Stems:
    """Stems of trees (n,) `TREE`: vertex rings of their meshes, and second leaders (m,) of forked stems.

    Attributes
    ----------
    above_ground_m : (n, r) height over the foot at which rings meet the axis; the first ring is buried
    radius_m : (n, r) radius of the circle with the ring's area; the first ring is as wide as the second
    flare_m : (n,) height of the root flare over the foot
    sides : (n,) number of sides of the cross-section
    forked, fork_m : (m,) indices of stems with a second leader, and the height of its first ring over the
        foot
    """

    flare_rings = 1 + len(_FLARE)  # number of rings of the root flare

    def __init__(self, trees: Trees, *, table: Table | None = None) -> None:
        self.trees = trees
        self.forms = stem_forms(trees, table=table)
        self._taper = tapers(trees, table=table)
        self.flare_m = flares_m(trees, table=table)
        between_m = self.flare_m + _BETWEEN * (BREAST_HEIGHT_M - self.flare_m)
        breast_m = np.full(len(trees), BREAST_HEIGHT_M)
        butt = np.column_stack(
            [np.full(len(trees), -_BURIED_M), np.outer(self.flare_m, _FLARE), between_m, breast_m]
        )
        upper = BREAST_HEIGHT_M + (trees["height_m"][:, None] - BREAST_HEIGHT_M) * np.array(_UPPER)
        self.above_ground_m = np.concatenate([butt, upper], axis=1)
        self.forked = np.flatnonzero(self.forms.forks[:, 0])
        share, second_share = self.forms.forks[self.forked, 1:3].T
        # The ring nearest to a fork moves there: the first leader thins from it to the next ring.
        self.fork_m = np.maximum(share * trees["height_m"][self.forked], upper[self.forked, 0])
        at = butt.shape[1] + np.abs(upper[self.forked, :-1] - self.fork_m[:, None]).argmin(axis=1)
        self.above_ground_m[self.forked, at] = self.fork_m
        self.radius_m = self._radius_m(slice(None), self.above_ground_m)
        over = np.arange(self.above_ground_m.shape[1]) > at[:, None]
        self.radius_m[self.forked] *= np.sqrt(np.where(over, 1 - second_share[:, None], 1.0))
        self.sides = _SIDES[np.searchsorted(_THICKER_M, trees["dbh_m"])]

    def _radius_m(self, rows: I8 | slice, above_m: F8) -> F8:
        trees = self.trees[rows]
        return taper_radius_m(self._taper[rows], trees["dbh_m"], trees["height_m"], above_m)

    @property
    def tip_radius_m(self) -> F8:
        """Radius (n,) at the tip: 0 for a whole tree, greater for a broken one."""
        return self._radius_m(slice(None), self.trees["height_m"][:, None])[:, 0]

    def axis_m(self, above_m: F8, rows: I8 | slice = slice(None)) -> F8:
        """Points (k, r, 3) of the axes of selected stems (k,) at heights (k, r), relative to their feet.

        By default all stems are selected.
        """
        trees = self.trees[rows]
        slope = tan(np.radians(trees["lean_deg"]))
        towards = np.radians(trees["lean_towards_deg"])
        lean = (slope * np.array([cos(towards), sin(towards)])).T
        aside_m = self.forms.select(rows).aside_m(above_m)
        return np.concatenate([above_m[..., None] * lean[:, None] + aside_m, above_m[..., None]], axis=2)

    def leader_axis_m(self, above_m: F8) -> F8:
        """Points (m, r, 3) of the axes of second leaders relative to their feet, at heights (m, r)."""
        middle_m = self.axis_m(above_m, self.forked)
        slope, gap_m, towards = (column[:, None] for column in self.forms.forks[self.forked].T[3:])
        away_m = gap_m * -expm1(-slope / gap_m * (above_m - self.fork_m[:, None]))
        middle_m[..., :2] += away_m[..., None] * np.stack([cos(towards), sin(towards)], axis=-1)
        return middle_m

    def leaders(self, shares: F8) -> tuple[F8, F8]:
        """Heights over the foot and radii (m, k) of second leaders at shares (k,) from fork to tip.

        Together with the first leader they have the section of an unforked stem.
        """
        height_m = self.trees["height_m"][self.forked]
        length_m = (self.fork_m + _LEADER_TOP * (height_m - self.fork_m)) - self.fork_m
        above_m = self.fork_m[:, None] + length_m[:, None] * shares
        radius_m = (
            self._radius_m(self.forked, above_m) * np.sqrt(self.forms.forks[self.forked, 2:3]) * (shares < 1)
        )
        return above_m, radius_m

    def circles(self) -> NDArray[np.void]:
        """Circles (k,) `STEM_CIRCLE` along stems and their second leaders.

        They go tree by tree, from the ground to the tip.
        """
        above_m = np.column_stack([self.above_ground_m[:, 1:], self.trees["height_m"]])
        radius_m = np.column_stack([self.radius_m[:, 1:], self.tip_radius_m])
        second_m, thin_m = self.leaders(np.linspace(0.0, 1.0, _LEADER_CIRCLES))
        parts = []
        for bearers, leader, up_m, half_m, axis_m in (
            (self.trees, 1, above_m, radius_m, self.axis_m(above_m)),
            (self.trees[self.forked], 2, second_m, thin_m, self.leader_axis_m(second_m)),
        ):
            circles = circles_of(bearers, leader, PlantPart.STEM, places_m(bearers)[:, None] + axis_m, half_m)
            circles["above_foot_m"] = up_m
            parts.append(circles.ravel())
        circles = np.concatenate(parts)
        return circles[np.lexsort((circles["above_foot_m"], circles["leader"], circles["tree"]))]

    def angles(self, rows: I8 | slice, sides: int) -> F8:
        """Angles (k, sides) of a ring's vertices around the axes of selected stems (k,).

        They count from east, counter-clockwise.
        """
        return (
            np.radians(self.trees["crown_azimuth_deg"][rows])[:, None] + np.arange(sides) * 2 * np.pi / sides
        )

    def outlines(self, rows: I8 | slice, sides: int) -> F8:
        """Distances (k, r, sides) of the ring vertices of selected stems (k,) from their axes."""
        above_m = self.above_ground_m[rows]
        radius_m = self.radius_m[rows]
        breast_m = self.trees["dbh_m"][rows] / 2
        return self.forms.select(rows).outline(self.angles(rows, sides), above_m, radius_m, breast_m)

    def half_widths_m(self) -> F8:
        """Halves (n, r) of the mean widths of the rings: they count butts and bark as wide as they look."""
        half_m = np.empty_like(self.radius_m)
        for sides in np.unique(self.sides):
            rows = np.flatnonzero(self.sides == sides)
            half_m[rows] = half_width_m(self.outlines(rows, int(sides)))
        return half_m


_STATIONS = np.array([0.0, 0.08, 0.2, 0.4, 0.65, 1.0])
ROOT_SIDES = 6  # sides and rings of a root's mesh
ROOT_RINGS = len(_STATIONS)
_OLD_M = 0.3  # least DBH of trees with surface roots; assumption
_MOST = 6  # most roots of a tree, at most one per lobe of its butt
# ranges of length over the DBH, and of length in m; assumptions
_LENGTH = (2.0, 4.5)
_LENGTH_M = (0.5, 2.0)
_RADIUS = (0.09, 0.15)  # range of the radius at the butt over the DBH; assumption
_THINNER = 0.7
_RISE = 1.5
_RISE_M = 0.2
"""Share of its radius that a root loses along its length; its excess of height over width at the butt, and
the length over which that falls to 1/e; assumptions."""
_BURIED = 0.15
_BEND = 0.12
_ASIDE_RAD = 0.3
"""Depth of a root's centre in the ground over its height before it dives; bends over its length; range of its
direction about the lobe's direction; assumptions."""
_TOP_M = 0.3
"""Greatest height of a root over the foot, so that it is no part of a section at breast height: uphill it
dives."""


def root_points(stems: Stems, height_m: HeightField) -> tuple[I8, F8]:
    """Roots of stems (n,), each from the seed of its stem's form.

    Returns for each root (k,) the stem's index, and vertices (k, 1 + rings * sides + 1, 3) relative to the
    stem's foot: the centre of the end in the butt, rings from there, and the tip.
    """
    trees = stems.trees
    number, _, lobe_phase, _ = stems.forms.lobes.T
    seeds = [int(seed) for seed in trees["form"]]
    draws = np.array([uniform(seed, Growth.ROOT, 0, 5 * _MOST) for seed in seeds]).reshape(-1, _MOST, 5)
    is_there = (draws[..., 0] < stems.forms.surface_roots[:, None]) & (np.arange(_MOST) < number[:, None])
    stem, lobe = np.nonzero(is_there & (trees["dbh_m"] > _OLD_M)[:, None])
    turn, long, thick, bend = draws[stem, lobe, 1:].T
    dbh_m = trees["dbh_m"][stem]
    azimuth = (lobe_phase[stem] + 2 * np.pi * lobe) / number[stem] + _ASIDE_RAD * (turn - 0.5)
    length_m = np.clip(dbh_m * np.interp(long, (0, 1), _LENGTH), *_LENGTH_M)
    phase = 2 * np.pi * bend[:, None]
    aside_m = _BEND * length_m[:, None] * _STATIONS * (sin(5 * _STATIONS + phase) - sin(phase))
    along_m = length_m[:, None] * _STATIONS
    ahead = _unit(azimuth)
    line_m = along_m[..., None] * ahead + aside_m[..., None] * _unit(azimuth + np.pi / 2)
    line_m += 0.8 * stems.radius_m[stem, 1, None, None] * ahead
    wide_m = (dbh_m * np.interp(thick, (0, 1), _RADIUS))[:, None] * (1 - _THINNER * _STATIONS)
    high_m = wide_m * (1 + _RISE * exp(-_STATIONS * length_m[:, None] / _RISE_M))
    place = trees[stem]
    ground_m = height_m(place["x_m"][:, None] + line_m[..., 0], place["y_m"][:, None] + line_m[..., 1])
    sunk_m = high_m * (_BURIED + _STATIONS * _STATIONS * _STATIONS)
    z_m = np.minimum(ground_m - place["z_m"][:, None] - sunk_m, _TOP_M - high_m)
    return stem, _root_pipes(np.concatenate([line_m, z_m[..., None]], axis=2), wide_m, high_m)


def _unit(azimuth: F8) -> F8:
    """Level vectors (k, 1, 2) in directions (k,)."""
    return np.stack([cos(azimuth), sin(azimuth)], axis=-1)[:, None]


def _root_pipes(middle_m: F8, wide_m: F8, high_m: F8) -> F8:
    """Vertices of roots: upright ellipses with half axes (k, rings) around centres (k, rings, 3)."""
    ahead = unit(np.gradient(middle_m[..., :2], axis=1))
    angle = (np.arange(ROOT_SIDES) + 0.5) * 2 * np.pi / ROOT_SIDES
    left_m = wide_m[..., None] * cos(angle)
    ring_m = np.repeat(middle_m[:, :, None], ROOT_SIDES, axis=2)
    ring_m[..., 0] -= ahead[..., None, 1] * left_m
    ring_m[..., 1] += ahead[..., None, 0] * left_m
    ring_m[..., 2] += high_m[..., None] * sin(angle)
    ring_m = ring_m.reshape(len(middle_m), ROOT_RINGS * ROOT_SIDES, 3)
    tip_m = middle_m[:, -1:].copy()
    tip_m[..., :2] += ahead[:, -1:] * wide_m[:, -1:, None]
    return np.concatenate([middle_m[:, :1], ring_m, tip_m], axis=1)


STEM_PARTS = (PlantPart.ROOT_FLARE, PlantPart.STEM)  # parts of the meshes of a stem, in order
_SPLINTER_SHARE = 0.8
"""Offset of a broken stem's tip from the axis over the radius of the highest ring: a slanting break."""
_WIDEST = 1.3  # reach of a butt's lobes over the radius of its circle
_LEADER_SIDES = 16
_LEADER_RINGS = (0.0, 0.06, 0.15, 0.3, 0.5, 0.75, 0.92)
"""Sides of a second leader, and its rings as shares of the way from fork to tip."""
_STEP_M = 1e-3  # height difference for the slope of an axis


@dataclass(frozen=True, slots=True)
class StemKey:
    """Key of the shape of a layer of a single stem, relative to its foot."""

    tile: TileKey
    number: int  # among the trees of the tile
    layer: int  # from 0, which ends at the top of the flare


def lean_rotation(lean_deg: F8, towards_deg: F8) -> F8:
    """Rotations (n, 3, 3) that tilt the vertical by `lean_deg` towards an angle from east, without twist."""
    tilt = np.radians(lean_deg)
    towards = np.radians(towards_deg)
    c = cos(towards)
    s = sin(towards)
    v, w = 1 - cos(tilt), sin(tilt)
    rows = [[1 - v * c * c, -v * c * s, w * c], [-v * c * s, 1 - v * s * s, w * s], [-w * c, -w * s, 1 - v]]
    return np.moveaxis(np.array(rows), -1, 0)


def stem_meshes(
    trees: Trees, origin_m: F8, height_m: HeightField, *, table: Table | None = None
) -> list[Mesh]:
    """Meshes of `STEM_PARTS` of a tile's trees, tree by tree, with surface roots.

    They are relative to the tile's origin (3,).
    """
    stems = Stems(trees, table=table)
    # Each foot is in the ground all around the flare, including lobes.
    flare_m = _WIDEST * stems.radius_m[:, :1]
    around = np.arange(8) * (np.pi / 4)
    ground_m = height_m(
        trees["x_m"][:, None] + flare_m * cos(around), trees["y_m"][:, None] + flare_m * sin(around)
    )
    slope = stem_slopes(stems.axis_m, np.zeros((len(trees), 1)))
    buried_m = _BURIED_M + (flare_m * norm(slope))[:, 0]
    stems.above_ground_m[:, 0] = -(buried_m - np.minimum(ground_m.min(axis=1) - trees["z_m"], 0.0))
    foot_m = places_m(trees) - origin_m
    meshes = _meshes(stems, foot_m)
    for stem, root_m in zip(*root_points(stems, height_m), strict=True):
        root = Mesh((root_m + foot_m[stem]).astype(np.float32), pipe_faces(ROOT_SIDES, ROOT_RINGS))
        meshes[len(STEM_PARTS) * stem] = merge(meshes[len(STEM_PARTS) * stem], root)
    return meshes


_RINGS_TO_BREAST = 3  # at the top of the root flare, below breast height, and at breast height
STEM_LAYERS = 1 + _RINGS_TO_BREAST + len(_UPPER)
"""Layers of a stem, between rings, with the root flare as the lowest: each is straight, so that a stem bends
where its mesh does."""


def stem_layers(
    tree: Trees, meshes: Sequence[Mesh], foot_m: F8, *, table: Table | None = None
) -> list[tuple[Mesh, ...]]:
    """Cut the meshes of `STEM_PARTS` of a tree (1,) into layers, relative to its foot (3,).

    A face belongs to the layer of its middle: faces between two rings stay together, also in a leaning stem.
    """
    rings_m = Stems(tree, table=table).above_ground_m[0, Stems.flare_rings - 1 :]
    layers: list[list[Mesh]] = [[] for _ in range(STEM_LAYERS)]
    for mesh in meshes:
        corners_m = mesh.vertices_m.astype(np.float64) - foot_m
        middle_m = corners_m[mesh.faces, 2].sum(axis=1) / mesh.faces.shape[1]
        layer_of = np.searchsorted(rings_m, middle_m)
        for layer, parts in enumerate(layers):
            used, faces = np.unique(mesh.faces[layer_of == layer], return_inverse=True)
            parts.append(Mesh(corners_m[used].astype(np.float32), faces.reshape(-1, 3).astype(np.uint32)))
    return [tuple(parts) for parts in layers]


def stems_above_ground(trees: Trees, *, table: Table | None = None) -> list[Mesh]:
    """Meshes as from `stem_meshes`, but with all feet at the origin, without roots and buried parts."""
    stems = Stems(trees, table=table)
    stems.above_ground_m[:, 0] = 0.0
    return _meshes(stems, np.zeros((len(trees), 3)))


def stem_slopes(axis: Callable[[F8], F8], above_m: F8) -> F8:
    """Return the slopes of axes, east and north (n, r, 2) in m per m, at heights (n, r)."""
    return (axis(above_m + _STEP_M) - axis(above_m - _STEP_M))[..., :2] / (2 * _STEP_M)


def _meshes(stems: Stems, foot_m: F8) -> list[Mesh]:
    """Meshes of `STEM_PARTS`, tree by tree, of stems whose feet are at (n, 3)."""
    trees = stems.trees
    tip_m = stems.axis_m(trees["height_m"][:, None])[:, 0]
    # The tip of a broken stem is off the axis.
    aside_m = np.where(stems.tip_radius_m > 0, _SPLINTER_SHARE * stems.radius_m[:, -1], 0.0)
    splinter_m = aside_m[:, None] * _unit(np.radians(trees["crown_azimuth_deg"]))[:, 0]
    tip_m += matvec(lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])[:, :, :2], splinter_m)
    second = dict(zip(stems.forked.tolist(), _leaders(stems), strict=True))
    leader = pipe_faces(_LEADER_SIDES, len(_LEADER_RINGS))
    meshes: dict[int, tuple[Mesh, Mesh]] = {}
    for count in np.unique(stems.sides):
        with_sides = np.flatnonzero(stems.sides == count)
        sides = int(count)
        above_m = stems.above_ground_m[with_sides]
        away_m = stems.outlines(with_sides, sides)
        pipes_m = _pipes(
            partial(stems.axis_m, rows=with_sides), above_m, away_m, stems.angles(with_sides, sides)
        )
        flare = pipe_faces(sides, stems.flare_rings, top=False)
        upper = pipe_faces(sides, above_m.shape[1] - stems.flare_rings + 1, bottom=False)
        shared = 1 + sides * (stems.flare_rings - 1)
        for tree, points_m in zip(with_sides.tolist(), pipes_m, strict=True):
            top_m = np.concatenate([points_m[shared:], tip_m[tree : tree + 1]])
            stem = [*([(second[tree], leader)] if tree in second else []), (top_m, upper)]
            pieces = (Mesh((at_m + foot_m[tree]).astype(np.float32), faces) for at_m, faces in stem)
            below = (points_m[: shared + sides] + foot_m[tree]).astype(np.float32)
            meshes[tree] = Mesh(below, flare), merge(*pieces)
    return [mesh for tree in range(len(trees)) for mesh in meshes[tree]]


def _leaders(stems: Stems) -> F8:
    """Vertices (m, v, 3) of the second leaders, relative to the foot, of stems that fork."""
    above_m, radius_m = stems.leaders(np.array([*_LEADER_RINGS, 1.0]))
    angle = stems.angles(stems.forked, _LEADER_SIDES)
    breast_m = stems.trees["dbh_m"][stems.forked] / 2
    away_m = stems.forms.select(stems.forked).outline(angle, above_m[:, :-1], radius_m[:, :-1], breast_m)
    pipes_m = _pipes(stems.leader_axis_m, above_m[:, :-1], away_m, angle)
    return np.concatenate([pipes_m, stems.leader_axis_m(above_m[:, -1:])], axis=1)


def _pipes(axis: Callable[[F8], F8], above_m: F8, away_m: F8, angle: F8) -> F8:
    """Vertices (n, 1 + rings * sides, 3).

    They are the centre of the bottom, and rings across the axis at `away_m` (n, rings, sides).
    """
    n, rings, sides = away_m.shape
    east, north = np.moveaxis(stem_slopes(axis, above_m), -1, 0)
    tilt = np.degrees(atan2(hypot(east, north), 1.0))
    towards = np.degrees(atan2(north, east))
    across = lean_rotation(tilt.ravel(), towards.ravel())[:, :, :2].reshape(n, rings, 3, 2)
    flat_m = away_m[..., None] * np.stack([cos(angle), sin(angle)], axis=-1)[:, None]
    middle_m = axis(above_m)
    ring_m = middle_m[:, :, None] + matvec(across[:, :, None], flat_m)
    return np.concatenate([middle_m[:, :1], ring_m.reshape(n, rings * sides, 3)], axis=1)
