"""What must hold of a scene with a medium: it stands still, has no seam, and shows only what stands there."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vlp16emu.raycast import LINE, Scene
from vlp16emu.report.accuracy import FINE_M, Counts
from vlp16emu.types import Firings, Mesh, ShapeKey, Window

__all__ = ["Seam", "Strays", "repeats", "seam", "strays"]

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


def repeats(scene: Scene, firings: Firings, near_m: Array, far_m: float, later: int) -> bool:
    """Whether a static sensor meets the same a revolution later, `later` sequences on, by one ray per pulse."""
    again = replace(firings, index=firings.index + later)
    one, other = (scene.cast(these, near_m, far_m, LINE) for these in (firings, again))
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
    scene: Scene,
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
    window : of which the scene is made
    shape : grows the meshes of a shape
    limits_m : as `cast` takes them
    near_m : beyond which a hit is far
    within_m : of which the surface must come
    """
    hits = scene.cast(firings, *limits_m, LINE)
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
    """Corners of faces, and the middles of faces and of their edges."""
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
