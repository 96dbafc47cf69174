"""What must hold of a scene with a medium, and what float32 does to ranges."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vlp16emu.accuracy.compare import FINE_M, Counts
from vlp16emu.accuracy.curve import Rounding
from vlp16emu.raycast.beam import LINE
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import Firings, Mesh, ShapeKey, Window

Array = NDArray[np.float64]

_REACH_M = 3.0
_DRAWS, _OUTSIDE = 1000, (0.025, 0.975)


@dataclass(frozen=True, slots=True)
class Seam:
    """Returns over range about `near_m`, over those of the explicit world."""

    from_m: tuple[float, ...]
    """Where each bin of `FINE_M` begins."""
    ratio: tuple[float, ...]
    """Of each bin."""
    step: float
    """Ratio of all beyond over that of all before, less 1."""
    low: float
    """Where the step lies with 95 % confidence."""
    high: float


@dataclass(frozen=True, slots=True)
class Strays:
    """Far hits whose surface is not there."""

    far: int
    """Hits beyond `near_m`."""
    strays: int
    """Those whose own surface comes no nearer to the hit than allowed."""
    farthest_m: float
    """Greatest distance between a far hit and its surface."""


def repeats(geometry: Geometry, firings: Firings, near_m: Array, far_m: float, later: int) -> bool:
    """Whether a static sensor meets the same a revolution later, `later` sequences on, by one ray per pulse."""
    again = replace(firings, index=firings.index + later)
    one, other = (geometry.cast(these, near_m, far_m, LINE) for these in (firings, again))
    return bool((one.range_m == other.range_m).all() and (one.surface == other.surface).all())


def seam(counts: Counts, explicit: Counts, near_m: float, seed: int = 0) -> Seam:
    """Look for a step of the number of returns at `near_m`.

    Parameters
    ----------
    counts, explicit : of the same clusters, (clusters, bins), in a world and in the explicit one
    seed : of the clusters that the bootstrap draws
    """
    edge, wide = round(near_m / FINE_M), round(_REACH_M / FINE_M)
    first = max(edge - wide, 0)
    clusters = len(counts.fine)
    draws = np.random.default_rng(seed).multinomial(clusters, np.full(clusters, 1 / clusters), _DRAWS)
    weights = np.vstack([np.ones(clusters), draws])
    one, other = (weights @ of.fine[:, first : edge + wide].astype(np.float64) for of in (counts, explicit))
    split = edge - first
    with np.errstate(invalid="ignore", divide="ignore"):
        beyond = one[:, split:].sum(axis=1) / other[:, split:].sum(axis=1)
        step = beyond * other[:, :split].sum(axis=1) / one[:, :split].sum(axis=1) - 1
        ratio = one[0] / other[0]
    low, high = np.nanquantile(step[1:], _OUTSIDE)
    return Seam(
        from_m=tuple(FINE_M * number for number in range(first, edge + wide)),
        ratio=tuple(ratio.tolist()),
        step=float(step[0]),
        low=float(low),
        high=float(high),
    )


def strays(
    geometry: Geometry,
    window: Window,
    shape: Callable[[ShapeKey], tuple[Mesh, ...]],
    firings: Firings,
    limits_m: tuple[Array, float],
    *,
    near_m: float,
    within_m: float = 1.0,
) -> Strays:
    """Hold the surface of each far hit against the faces that show it in the explicit world.

    One surface is one part of one plant, so instance, species, class and part are held at once.

    Parameters
    ----------
    window : that the geometry is made of
    shape : grows the meshes of a shape
    limits_m : as `cast` takes them
    near_m : beyond which a hit is far
    within_m : how near the surface must come
    """
    hits = geometry.cast(firings, *limits_m, LINE)
    far = np.flatnonzero((hits.range_m > near_m) & np.isfinite(hits.range_m))
    place_m = firings.origin_m.reshape(-1, 3) + hits.range_m[:, None] * firings.direction.reshape(-1, 3)
    off_m = np.full(len(far), np.inf)
    meshes = {key: shape(key) for key in window.shapes}
    shown = np.array([len(meshes[window.shapes[which]]) for which in window.shape.tolist()])
    first = window.first_surface.astype(np.int64)
    trees = dict[tuple[ShapeKey, int], cKDTree]()
    for surface in np.unique(hits.surface[far]).tolist():
        own = np.flatnonzero(hits.surface[far] == surface)
        for placement in np.flatnonzero((first <= surface) & (surface < first + shown)).tolist():
            key, number = window.shapes[window.shape[placement]], int(surface - first[placement])
            if (key, number) not in trees:
                trees[key, number] = cKDTree(_points(meshes[key][number]))
            gap_m = _gap(trees[key, number], window.world_T_shape[placement], place_m[far[own]])
            off_m[own] = np.minimum(off_m[own], gap_m)
    return Strays(len(far), int((off_m > within_m).sum()), float(off_m.max(initial=0.0)))


def _points(mesh: Mesh) -> Array:
    corners = mesh.vertices_m[mesh.faces].astype(np.float64)
    edges = (corners + np.roll(corners, 1, axis=1)) / 2
    points: Array = np.concatenate([corners.reshape(-1, 3), edges.reshape(-1, 3), corners.mean(axis=1)])
    return points


def _gap(tree: cKDTree, world_T_shape: Array, place_m: Array) -> Array:
    """How far places (n, 3) in the world are from points of a placed shape, at most."""
    turned, moved = world_T_shape[:, :3], world_T_shape[:, 3]
    inside = np.linalg.solve(turned, (place_m - moved).T).T
    _, nearest = tree.query(inside)
    gap_m: Array = np.linalg.norm((np.asarray(tree.data)[nearest] - inside) @ turned.T, axis=1)
    return gap_m


_ELSEWHERE_M = 1e-3
_KEPT_SHAPES = 64

NOTHING_MET = Rounding(0, float("nan"), 0.0, float("nan"))
"""What is known of no rays at all."""


def rounding_of(
    geometry: Geometry,
    window: Window,
    shape: Callable[[ShapeKey], tuple[Mesh, ...]],
    firings: Firings,
    near_m: Array,
    far_m: float,
) -> Rounding:
    """Cast one ray along the middle of each pulse, and cut it in float64 with the mesh that it met.

    Things that sway are left out, and so are rays that meet nothing.

    Parameters
    ----------
    window : that the geometry was made of
    shape : grows the meshes of a shape
    """
    hits = geometry.cast(firings, near_m, far_m)
    grown = lru_cache(_KEPT_SHAPES)(shape)
    met = np.flatnonzero(np.isfinite(hits.range_m))
    origin_m, direction = firings.origin_m.reshape(-1, 3)[met], firings.direction.reshape(-1, 3)[met]
    at_m = hits.range_m[met].astype(np.float64)
    off_m = [
        _nearest(window, grown, ray, int(hits.surface[met[number]])) - ray[2]
        for number, ray in enumerate(zip(origin_m, direction, at_m, strict=True))
    ]
    known = np.abs(np.array([off for off in off_m if not np.isnan(off)]))
    same = known[known <= _ELSEWHERE_M]
    return Rounding(
        rays=len(known),
        range_rmse_m=float(np.sqrt(np.mean(same**2))) if len(same) else np.nan,
        range_max_m=float(same.max(initial=0.0)),
        elsewhere=1.0 - len(same) / len(known) if len(known) else np.nan,
    )


def _nearest(
    window: Window,
    grown: Callable[[ShapeKey], tuple[Mesh, ...]],
    ray: tuple[Array, Array, float],
    surface: int,
) -> float:
    """Range nearest to the ray's at which it cuts a surface; inf where it misses, NaN where the surface sways."""
    origin_m, direction, range_m = ray
    # Placements of one kind may share their surfaces: the last one at or before it, and its like.
    begins = window.first_surface.astype(np.int64)
    first = begins[begins <= surface].max()
    best_m = np.inf
    for number in np.flatnonzero(begins == first).tolist():
        if window.sway is not None and number in window.sway.placement:
            return np.nan
        world_T_shape = window.world_T_shape[number]
        mesh = grown(window.shapes[window.shape[number]])[surface - int(first)]
        to_shape = np.linalg.inv(world_T_shape[:, :3])
        cut_m = _cut(
            mesh.vertices_m,
            mesh.faces,
            to_shape @ (origin_m - world_T_shape[:, 3]),
            to_shape @ direction,
            range_m,
        )
        if abs(cut_m - range_m) < abs(best_m - range_m):
            best_m = cut_m
    return best_m


@numba.njit(cache=True, nogil=True)
def _cut(
    vertices_m: NDArray[np.float32],
    faces: NDArray[np.uint32],
    origin_m: Array,
    direction: Array,
    range_m: float,
) -> float:
    """Range nearest to `range_m` at which a ray cuts a mesh, inf where it misses (Moeller and Trumbore, 1997)."""
    best_m = np.inf
    for face in range(faces.shape[0]):
        a = vertices_m[faces[face, 0]].astype(np.float64)
        for corner in range(1, faces.shape[1] - 1):
            ab = vertices_m[faces[face, corner]] - a
            ac = vertices_m[faces[face, corner + 1]] - a
            p = np.cross(direction, ac)
            determinant = ab[0] * p[0] + ab[1] * p[1] + ab[2] * p[2]
            if determinant == 0.0:
                continue
            to = origin_m - a
            u = (to[0] * p[0] + to[1] * p[1] + to[2] * p[2]) / determinant
            if not 0.0 <= u <= 1.0:
                continue
            q = np.cross(to, ab)
            v = (direction[0] * q[0] + direction[1] * q[1] + direction[2] * q[2]) / determinant
            if v < 0.0 or u + v > 1.0:
                continue
            at_m = (ac[0] * q[0] + ac[1] * q[1] + ac[2] * q[2]) / determinant
            if abs(at_m - range_m) < abs(best_m - range_m):
                best_m = at_m
    return best_m
