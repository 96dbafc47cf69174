"""Branches of a crown and of the bole below it: their curves in space, and tubes around them.

The crown frame has its origin on the stem's axis at the crown base and z along the axis. The crown base of
inventories is the lowest whorl with three living branches (conifers) or the lowest branch that is not an
epicormic shoot (broadleaves), so single living branches can be below it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import asin, atan2, cos, exp, hypot, norm, power, sin
from vlp16emu.forest.plants.species import Habit, Shrub, Twigs
from vlp16emu.types import F8, I8, Mesh
from vlp16emu.world.vectors import unit


def quads(corners: F8) -> Mesh:
    """Mesh of quads with corners (..., 4, 3), without shared vertices."""
    vertices = corners.reshape(-1, 3).astype(np.float32)
    return Mesh(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 4))


NO_LEAVES = quads(np.zeros((0, 4, 3)))  # in place of fallen leaves


def merge(*parts: Mesh) -> Mesh:
    """Concatenate triangle meshes."""
    if len(parts) == 1:
        return parts[0]
    first = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    faces = [part.faces + np.uint32(start) for part, start in zip(parts, first[:-1], strict=True)]
    return Mesh(np.concatenate([part.vertices_m for part in parts]), np.concatenate(faces))


@cache
def pipe_faces(sides: int, rings: int, *, bottom: bool = True, top: bool = True) -> NDArray[np.uint32]:
    """Triangles (read-only) of a pipe.

    Its first vertex is the bottom's centre and its last the tip, if it has them.
    """
    corner = np.arange(sides)
    after = np.roll(corner, -1)
    low = int(bottom) + (np.arange(rings - 1) * sides)[:, None]
    high = low + sides
    last = int(bottom) + (rings - 1) * sides
    walls = [(low + corner, low + after, high + after), (low + corner, high + after, high + corner)]
    triangles = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in walls]
    if bottom:
        triangles.insert(0, np.column_stack([after + 1, corner + 1, np.zeros(sides, np.int64)]))
    if top:
        triangles.append(np.column_stack([last + corner, last + after, np.full(sides, last + sides)]))
    faces = np.concatenate(triangles).astype(np.uint32)
    faces.flags.writeable = False
    return faces


_NODES = {1: 9, 2: 5, 3: 3}
"""Nodes of a branch's curve, by order: odd, so that saplings can use every second node."""
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""Angle between successive branches or whorls, so that none is directly above another."""
_STEEPEST = np.radians(85.0)  # branches hang or rise no steeper; keeps the azimuth of a branch defined
THINNEST_M = 0.001  # smallest radius of a branch at its base; assumption
_TIP_SHARE = 0.2  # radius just before the tip over the radius at the base; assumption
_LEADER_RISE = np.radians(82.0)  # elevation of the highest limb of a decurrent crown; assumption
_TWIGS_ABOVE = 0.05  # part of a domed crown's length that twigs and leaves add above its limbs; assumption
_WAVES = 3
_REACHES = (0.45, 1.7)
"""Waves of a crown's outline around the stem, and its limits over the mean radius; assumptions."""
_BISECTIONS = 16  # enough to find the length of a branch to a millimetre


@dataclass(frozen=True, slots=True)
class Branches:
    """Branches of one order."""

    nodes_m: F8  # (n, m, 3) from the base, which lies on the bearer's axis, to the tip
    azimuth: F8  # (n,) rad, of the branch at its base
    length_m: F8  # (n,).
    radius_m: F8  # (n,) at the base

    @property
    def node_radius_m(self) -> F8:
        """Radius (n, m) at the nodes; 0 at the tip."""
        rings = self.nodes_m.shape[1] - 1
        return self.radius_m[:, None] * np.append(_taper(np.arange(rings) / rings), 0.0)

    def select(self, rows: I8) -> "Branches":
        """Return the selected branches."""
        return Branches(*(getattr(self, name)[rows] for name in self.__slots__))


def first_order(rng: np.random.Generator, habit: Habit, size_m: tuple[float, float], stem_m: F8) -> Branches:
    """Grow the first-order branches of a crown of the given length and width.

    Stem radii (s,) are evenly spaced from base to top.
    """
    length_m, _ = size_m
    whorls = max(1, round(length_m / habit.whorl_spacing_m))
    whorl = np.repeat(np.arange(whorls), habit.branches_per_whorl)
    n = len(whorl)
    relative = (whorl + rng.uniform(0.0, 0.5, n)) / whorls
    turn = 2 * np.pi / habit.branches_per_whorl
    azimuth = whorl * GOLDEN_ANGLE + turn * (np.arange(n) % habit.branches_per_whorl)
    azimuth += rng.normal(0.0, 0.2, n)

    def angles_rad(pair_deg: Sequence[float]) -> F8:
        """Angles in radians, interpolated from the lowest to the highest branches."""
        return np.radians(pair_deg[0] + (pair_deg[1] - pair_deg[0]) * relative)[:, None]

    share = (np.arange(_NODES[1] - 1) + 0.5) / (_NODES[1] - 1)
    rise = angles_rad(habit.rise_deg) + rng.normal(0.0, np.radians(habit.rise_spread_deg), (n, 1))
    leader = slice(n - int(habit.decurrent > 0), n)  # the highest limb, which hides the tip of the stem
    rise[leader] = _LEADER_RISE
    elevation = (
        rise - angles_rad(habit.droop_deg) * share + angles_rad(habit.upturn_deg) * (share * share * share)
    )
    base = np.zeros((n, 3))
    base_share = relative * (1 - habit.decurrent)
    base[:, 2] = base_share * length_m
    unit = curves(rng, base * 0, azimuth, elevation, np.ones(n), habit.crook_deg)
    reach = _reaches(rng, habit, azimuth)
    unbroken = rng.uniform(0.75, 1.05, n)
    unbroken[leader] = 1.0
    branch_m = _lengths_m(habit, size_m, base[:, 2], unit, reach) * unbroken
    nodes = base[:, None] + unit * branch_m[:, None, None]
    # Pipe model: the total section of all branches is a multiple of the section of the stem that feeds them
    # (Shinozaki et al. 1964). Thickness is proportional to length, and limited by the stem at the branch's
    # base.
    radius = stem_m[0] * np.sqrt(habit.branch_area) * branch_m / np.sqrt(np.square(branch_m).sum())
    stem_here_m = np.interp(base_share, np.linspace(0, 1, len(stem_m)), stem_m)
    return Branches(nodes, azimuth, branch_m, np.clip(radius, THINNEST_M, 0.6 * stem_here_m))


def side_branches(rng: np.random.Generator, twigs: Twigs, bearers: Branches, order: int) -> Branches:
    """Grow branches on both sides of the bearers, of the previous order; the last continues its bearer."""
    leafy = bearers.length_m * (1 - twigs.start)
    count = np.maximum(2, np.round(leafy * twigs.per_m).astype(np.int64))
    bearer = np.repeat(np.arange(len(count)), count)
    n = len(bearer)
    rank = np.arange(n) - np.repeat(np.cumsum(count) - count, count)
    terminal = rank == count[bearer] - 1
    at_share = twigs.start + (1 - twigs.start) * (rank + rng.random(n)) / count[bearer]
    at_share[terminal] = 1.0
    base, tangent = points_along(bearers.nodes_m, bearer, at_share)
    side = np.where(rank % 2 == 0, 1.0, -1.0)
    roll = np.radians(twigs.roll_spread_deg) * rng.uniform(-1, 1, n)
    open_angle = np.where(terminal, 0.0, np.radians(twigs.angle_deg + rng.normal(0.0, 8.0, n)))
    level = unit(np.cross(tangent, [0.0, 0.0, 1.0])) * side[:, None]
    upward = np.cross(tangent, level) * side[:, None] * -1.0
    sideways = cos(roll)[:, None] * level + sin(roll)[:, None] * upward
    heading = cos(open_angle)[:, None] * tangent + sin(open_angle)[:, None] * sideways
    azimuth = atan2(heading[:, 1], heading[:, 0])
    steps = (np.arange(_NODES[order] - 1) + 0.5) / (_NODES[order] - 1)
    elevation = asin(np.clip(heading[:, 2], -1, 1))[:, None] - np.radians(twigs.droop_deg) * steps
    share = twigs.length_share * (1 - 0.7 * at_share) * rng.uniform(0.7, 1.2, n)
    length = np.clip(bearers.length_m[bearer] * share, *twigs.length_m)
    nodes = curves(rng, base, azimuth, elevation, length, 0.0)
    all_twigs = np.sqrt(np.bincount(bearer, np.square(length)))[bearer]
    thickest = bearers.radius_m[bearer]
    radius = np.minimum(thickest * length / all_twigs, thickest * _taper(at_share))
    return Branches(nodes, azimuth, length, np.maximum(radius, THINNEST_M))


# Basal stems of shrubs; assumptions.
_BASE_SHARE = 0.08  # radius of the circle in which they start, over the width
_REACH_SHARE = 0.45  # greatest distance of a stem from the middle, over the width
_SHORTEST_STEM = 0.75  # least length over the greatest that height and width allow
_RISE_SIGMA_DEG = 4.0


def ground_stems(rng: np.random.Generator, shrub: Shrub, height_m: float, width_m: float) -> Branches:
    """Grow the basal stems of a shrub of the given height and width."""
    stems = shrub.stems
    rise_deg = shrub.rise_deg
    inward = (np.arange(stems) + rng.random(stems)) / stems
    azimuth = GOLDEN_ANGLE * np.arange(stems) + rng.normal(0.0, 0.3, stems)
    base = np.zeros((stems, 3))
    base[:, 0] = cos(azimuth)
    base[:, 1] = sin(azimuth)
    base *= (_BASE_SHARE * width_m * np.sqrt(1 - inward))[:, None]
    share = (np.arange(_NODES[1] - 1) + 0.5) / (_NODES[1] - 1)
    rise = rise_deg[0] + (rise_deg[1] - rise_deg[0]) * inward + rng.normal(0.0, _RISE_SIGMA_DEG, stems)
    elevation = np.radians(rise[:, None] - shrub.droop_deg * share)
    unit = curves(rng, base * 0, azimuth, elevation, np.ones(stems), shrub.crook_deg)
    # As long as height and width allow.
    up = unit[:, :, 2].max(axis=1) / height_m
    out = hypot(unit[..., 0], unit[..., 1]).max(axis=1) / (_REACH_SHARE * width_m)
    length_m = rng.uniform(_SHORTEST_STEM, 1.0, stems) / np.maximum(up, out)
    # Starts below the ground, as a slope may fall away under the foot.
    base[:, 2] = -0.03 * width_m
    nodes = base[:, None] + unit * length_m[:, None, None]
    return Branches(nodes, azimuth, length_m, length_m / shrub.slenderness / 2 + THINNEST_M)


def volume_m3(branches: Branches) -> float:
    """Volume of round branches with these curves and radii, as frusta between nodes."""
    step_m = norm(np.diff(branches.nodes_m, axis=1))
    low, high = branches.node_radius_m[:, :-1], branches.node_radius_m[:, 1:]
    return float((np.pi / 3 * step_m * (np.square(low) + low * high + np.square(high))).sum())


def join(*parts: Branches) -> Branches:
    """Concatenate branches of one order."""
    return Branches(*(np.concatenate([getattr(part, name) for part in parts]) for name in Branches.__slots__))


def points_along(nodes_m: F8, branch: I8, share: F8) -> tuple[F8, F8]:
    """Points (p, 3) and unit tangents (p, 3) on curves (n, m, 3) at shares (p,) of their length."""
    last = nodes_m.shape[1] - 2
    segment = np.minimum((share * (last + 1)).astype(np.int64), last)
    start = nodes_m[branch, segment]
    step = nodes_m[branch, segment + 1] - start
    return start + step * (share * (last + 1) - segment)[:, None], unit(step)


def tubes(branches: Branches, sides: int, *, every: int = 1) -> Mesh:
    """Make tapering tubes through every `every`-th node of the curves.

    They are open at the base, inside the bearer, and pointed at the tip. A section has the perimeter of the
    round branch, so that the width of its silhouette, averaged over all directions, equals the branch's
    diameter for any number of sides (Cauchy).
    """
    nodes = branches.nodes_m[:, ::every]
    n = nodes.shape[0]
    rings = nodes.shape[1] - 1
    tangent = unit(np.gradient(nodes, axis=1)[:, :rings])
    across = np.stack([-sin(branches.azimuth), cos(branches.azimuth), np.zeros(n)], axis=-1)[:, None]
    across = unit(across - (across * tangent).sum(axis=-1, keepdims=True) * tangent)
    outward = np.cross(tangent, across)
    half = np.pi / sides
    corner = branches.radius_m[:, None] * _taper(np.arange(rings) / rings) * half / sin(half)
    angle = 2 * half * np.arange(sides)[:, None]
    round_about = cos(angle) * across[:, :, None] + sin(angle) * outward[:, :, None]
    ring = nodes[:, :rings, None] + corner[..., None, None] * round_about
    vertices = np.concatenate([ring.reshape(n, rings * sides, 3), nodes[:, -1:]], axis=1)
    faces_of_tube = pipe_faces(sides, rings, bottom=False).astype(np.int64)
    faces = faces_of_tube + (np.arange(n) * vertices.shape[1])[:, None, None]
    return Mesh(vertices.reshape(-1, 3).astype(np.float32), faces.reshape(-1, 3).astype(np.uint32))


def _reaches(rng: np.random.Generator, habit: Habit, azimuth: F8) -> F8:
    """Radius (n,) of a crown towards azimuths (n,) over its mean radius, a sum of three waves."""
    if habit.lopsided == 0:
        return np.ones(len(azimuth))
    size = habit.lopsided / np.sqrt(_WAVES) * rng.standard_normal((2, _WAVES))
    turns = np.outer(azimuth, np.arange(1, 1 + _WAVES))
    waves = (size[0] * cos(turns) + size[1] * sin(turns)).sum(axis=1)
    return np.clip(1 + waves, *_REACHES)


def _lengths_m(habit: Habit, size_m: tuple[float, float], base_m: F8, unit: F8, reach: F8) -> F8:
    """Lengths (n,) at which branches from heights (n,) reach the envelope, along unit curves (n, m, 3).

    The envelope is scaled by `reach` (n,).
    """
    length_m, width_m = size_m
    away = hypot(unit[..., 0], unit[..., 1])
    rows = np.arange(len(unit))
    outermost = away.argmax(axis=1)
    away = away[rows, outermost]
    up = unit[rows, outermost, 2]
    low, high = np.zeros(len(unit)), np.full(len(unit), length_m + width_m)
    least = habit.base_fraction
    top_m = length_m if habit.dome is None else (1 - _TWIGS_ABOVE) * length_m
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        relative = np.clip((base_m + up * middle) / top_m, 0.0, 1.0)
        below = sin(np.pi / 2 * np.minimum(relative / habit.widest_at, 1.0))
        above = np.clip((relative - habit.widest_at) / (1 - habit.widest_at), 0.0, 1.0)
        top = 1 - power(above, habit.top_power) if habit.dome is None else power(1 - above, habit.dome)
        radius = (least + (1 - least) * below) * top
        inside = away * middle < width_m / 2 * np.maximum(radius, 0.05) * reach
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return low


def curves(
    rng: np.random.Generator, base: F8, azimuth: F8, elevation: F8, length_m: F8, crook_deg: float
) -> F8:
    """Curves (n, m, 3) from bases (n, 3) whose segments have the given elevations (n, m - 1), rad."""
    n, steps = elevation.shape
    drift = rng.normal(0.0, 0.15, (n, 1)) * (np.arange(steps) + 0.5) / steps
    bearing = azimuth[:, None] + drift
    if crook_deg > 0:
        crook = np.radians(crook_deg) * rng.standard_normal((2, n, steps))
        bearing = bearing + crook[0]
        elevation = elevation + crook[1]
    elevation = np.clip(elevation, -_STEEPEST, _STEEPEST)
    flat = cos(elevation)
    step = np.stack([flat * cos(bearing), flat * sin(bearing), sin(elevation)], axis=-1)
    step *= (length_m / steps)[:, None, None]
    return np.concatenate([base[:, None], base[:, None] + np.cumsum(step, axis=1)], axis=1)


def _taper(share: F8) -> F8:
    return 1 - (1 - _TIP_SHARE) * share


_FREE_M = 0.3
"""Height of the branchless foot of the stem: 0.3 m on average in 4368 unpruned spruces of 45 stands (Forestry
Studies 66, 2017, 10.1515/fsmu-2017-0005)."""
_LEAST_REACH_M = 4.0
"""Least depth below the crown base down to which dead branches remain: branches of the last ten years, if the
crown base rises by 0.4 m a year; estimate. In silver birch of 11 to 22 years high density makes branches die
early and slows the shedding of dry ones (Niemisto 1995, Scandinavian Journal of Forest Research 10(3))."""
_KEPT_AT_FOOT = 0.5
"""Share of remaining branches at the lower end of the dead ones, over the share at the crown base;
assumption. Whorls lose from none to twice the mean, so that one in five whorls of four branches is bare
there."""
_LENGTH_AT_FOOT = 0.55
"""Branch length near the ground over the length at the crown base, from the crown's width when the branch
died: for spruce 2.1 m at a DBH of 8 cm and 3.8 m at 24 cm (Doebbeler et al. 2002); 8 cm is an estimate of the
DBH at canopy
closure."""
_LENGTHS = (0.4, 1.0)
"""Unbroken lengths within a whorl over the longest; assumption. Branches in a whorl of spruces get thinner by
rank (Hein et al. 2007, Forest Ecology and Management 242), and length follows thickness."""
_STUB_M = 0.16
"""Mode of the length of branch stubs outside the bark at the lower end of the dead branches, so that 90 %
have 0.05 to 0.39 m; estimate, no published distribution was found. The probability of breaking grows with the
distance from the stem, where a branch is thinner, and with the square of the time since its death: lengths
have a Rayleigh distribution, whose
mode falls with that time to the power 1.5."""
_LIVING_DEPTH = 0.3
"""Upper limit of `living_depth_m` over the height of the crown base: light falls faster below the short
crowns of young trees; assumption."""
_SLENDERNESS = 75.0
"""Length of an unbroken branch over its diameter, which follows from its length (Karkkainen 1972, Silva
Fennica 6(2), 2118 spruce branches); the number is an assumption."""
_TWIGS_KEPT = 0.9
_TWIG_AGE = 0.4
"""Share of a dead branch's twigs that remain at the crown base; and the decay time of twigs over the decay
time of branches (to 1/e each); assumptions."""
_BOLE_NODES = 9
_DEAD_TWIG_ORDER = 3
"""Nodes of the curves, as for other first-order branches; and the order whose fineness dead twigs have."""


def bole_branches(
    rng: np.random.Generator, habit: Habit, crown_base_m: float, longest_m: float, stem_m: F8
) -> tuple[Branches, Branches, Branches]:
    """Grow the branches below the crown, in the crown frame.

    The probability that a branch lives falls with the light, by a factor of e for each `living_depth_m` below
    the crown base. The crown base has risen at a constant rate past the dead branches, so the time since
    their death is proportional to their depth below it.

    `longest_m` is the length of branches at the crown base, and `stem_m` (s,) are radii from there to the
    ground, evenly spaced. Returns living first-order branches, dead ones, and the twigs of the dead ones.
    """
    below_m = max(crown_base_m - _FREE_M, 0.0)
    reach_m = max(habit.dead_reach * below_m, _LEAST_REACH_M)
    depth_m = _depths_m(rng, habit, min(reach_m, below_m), reach_m)
    n = len(depth_m)
    age = depth_m / reach_m
    lives = rng.random(n) < exp(-depth_m / min(habit.living_depth_m, _LIVING_DEPTH * crown_base_m))
    grown = 1 - (1 - _LENGTH_AT_FOOT) * depth_m / max(below_m, 1e-9)
    unbroken_m = longest_m * grown * rng.uniform(*_LENGTHS, n)
    bark_m = np.interp(depth_m, np.linspace(0, crown_base_m, len(stem_m)), stem_m)
    since = np.maximum(age, 1e-9)
    broken_m = bark_m + rng.rayleigh(_STUB_M / (since * np.sqrt(since)))
    length_m = np.where(lives, unbroken_m, np.minimum(unbroken_m, broken_m))
    azimuth = GOLDEN_ANGLE * np.arange(n) + rng.normal(0.0, 0.4, n)
    at = (np.arange(_BOLE_NODES - 1) + 0.5) / (_BOLE_NODES - 1)
    rise = habit.rise_deg[0] + rng.normal(0.0, 10.0, (n, 1))
    upturn = np.where(lives, habit.upturn_deg[0], 0.0)[:, None]
    elevation = np.radians(rise - habit.droop_deg[0] * at + upturn * (at * at * at))
    base = np.column_stack([np.zeros((n, 2)), -depth_m])
    curve_m = curves(rng, base, azimuth, elevation, unbroken_m, habit.crook_deg)
    # The inner part of a broken branch remains.
    share = np.outer(length_m / unbroken_m, np.linspace(0, 1, _BOLE_NODES))
    nodes = points_along(curve_m, np.repeat(np.arange(n), _BOLE_NODES), share.ravel())[0].reshape(
        n, _BOLE_NODES, 3
    )
    radius_m = np.maximum(unbroken_m / _SLENDERNESS / 2, THINNEST_M)
    all_branches = Branches(nodes, azimuth, length_m, radius_m)
    living, dead = (all_branches.select(np.flatnonzero(is_of_kind)) for is_of_kind in (lives, ~lives))
    twigs = side_branches(rng, habit.twigs, dead, _DEAD_TWIG_ORDER)
    twig_age = -twigs.nodes_m[:, 0, 2] / reach_m
    kept = rng.random(len(twig_age)) < _TWIGS_KEPT * exp(-twig_age / _TWIG_AGE)
    return living, dead, twigs.select(np.flatnonzero(kept))


def _depths_m(rng: np.random.Generator, habit: Habit, span_m: float, reach_m: float) -> F8:
    """Depths below the crown base of the remaining branches; the branches of a whorl are close together."""
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
