"""Meshes with few faces that look like the plants and objects that they stand for."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vlp16emu.types import F8, I8, U4, Mesh

_GOLDEN = (1.0 + 5.0**0.5) / 2.0
_TIPS = np.array(
    [
        np.roll([0.0, one, golden], axis)
        for axis in range(3)
        for one in (-1, 1)
        for golden in (-_GOLDEN, _GOLDEN)
    ]
) / np.hypot(1.0, _GOLDEN)  # corners (12, 3) of an icosahedron
_SIDES_OF_TIPS = np.array(
    [
        [a, b, c] if np.linalg.det(_TIPS[[a, b, c]]) > 0 else [a, c, b]
        for a, b, c in combinations(range(len(_TIPS)), 3)
        if min(_TIPS[a] @ _TIPS[b], _TIPS[b] @ _TIPS[c], _TIPS[c] @ _TIPS[a]) > 0.0
    ],
    np.uint32,
)
"""Its faces (20, 3), counter-clockwise as seen from outside: three corners that are neighbours of each
other."""
_REACH = 0.85  # share of a clump's leaves within the clump, in the direction of each corner
_SWELL = 1.4  # of a clump, whose faces are nearer to its middle than its corners
_LEAST_REACH_M = 0.02  # of a clump of few leaves
_SAMPLE = 4_000  # leaves of a plant that decide where its clumps are
_GREATEST_SCALE = 2.5
"""Greatest enlargement of a leaf in length: larger leaves look wrong, so a plant that needs them is drawn
less dense."""
_SIDES = 6  # of a stem
_RINGS = 7  # of a stem
_RINGS_OF_FLARE = 3
# Quadric decimation (fast-simplification 0.2) is no substitute: of the 219 016 faces of the stems of
# `birch_walk` it leaves 182 268 where `slim_stem` leaves 33 123, in ten times the time; of crowns, which are
# separate leaves, 8 % of the area.


def clumps(mesh: Mesh, count: int) -> Mesh:
    """Return the leaves of a plant as at most `count` rounded clumps of foliage.

    Each has as many leaves as another, and is an icosahedron that reaches about as far from its middle
    as they do, but where leaves are sparse no farther than the median of all.
    """
    leaves_m = mesh.vertices_m[mesh.faces].mean(axis=1, dtype=np.float64)
    leaves_m = leaves_m[np.linspace(0, len(leaves_m) - 1, min(len(leaves_m), _SAMPLE)).astype(np.int64)]
    groups_m = _groups(leaves_m, count)
    turns = Rotation.random(len(groups_m), rng=len(groups_m)).as_matrix()
    middles_m = np.array([group_m.mean(axis=0) for group_m in groups_m])
    tips = _TIPS @ turns  # (k, 6, 3)
    reach_m = np.array(
        [
            np.quantile((group_m - middle_m) @ axes.T, _REACH, axis=0)
            for group_m, middle_m, axes in zip(groups_m, middles_m, tips, strict=True)
        ]
    )
    reach_m = np.clip(
        _SWELL * reach_m, _LEAST_REACH_M, _SWELL * max(float(np.median(reach_m)), _LEAST_REACH_M)
    )
    corners_m = middles_m[:, None] + reach_m[..., None] * tips
    first = len(_TIPS) * np.arange(len(corners_m), dtype=np.uint32)[:, None, None]
    faces = (first + _SIDES_OF_TIPS).reshape(-1, 3)
    return Mesh(corners_m.reshape(-1, 3).astype(np.float32), faces)


def _groups(places_m: F8, count: int) -> list[F8]:
    """Cut places (n, 3) across their longest side until there are `count` groups of equal number."""
    if min(count, len(places_m)) < 2:
        return [places_m]
    low = count // 2
    order = np.argsort(places_m[:, np.ptp(places_m, axis=0).argmax()], kind="stable")
    cut = max(len(places_m) * low // count, 1)
    return _groups(places_m[order[:cut]], low) + _groups(places_m[order[cut:]], count - low)


def slim_stem(mesh: Mesh, *, is_flare: bool = False) -> Mesh:
    """Simplify an upright stem, or its root flare, to few sides and rings.

    A vertex moves to the vertex of its sector that is nearest to a ring's height.
    """
    vertices_m = mesh.vertices_m.astype(np.float64)
    along = (vertices_m[:, 2] - vertices_m[:, 2].min()) / max(float(np.ptp(vertices_m[:, 2])), 1e-6)
    axis_m = np.stack(
        [np.polyval(np.polyfit(along, vertices_m[:, axis], 3), along) for axis in (0, 1)], axis=1
    )
    aside_m = vertices_m[:, :2] - axis_m
    last = (_RINGS_OF_FLARE if is_flare else _RINGS) - 1
    ring = np.rint(along * last).astype(np.int64)
    sector = (
        np.rint(np.arctan2(aside_m[:, 1], aside_m[:, 0]) * _SIDES / (2 * np.pi)).astype(np.int64) % _SIDES
    )
    return _merge_clusters(mesh, ring * _SIDES + sector, np.abs(along * last - ring))


def lump(mesh: Mesh) -> Mesh:
    """Simplify a small solid object to the outermost vertex of each of the 27 parts of its box.

    Source: J. Rossignac and P. Borrel, 1993.
    """
    low_m = mesh.vertices_m.min(axis=0)
    size_m = np.maximum(np.ptp(mesh.vertices_m, axis=0), 1e-6)
    box_position = (mesh.vertices_m - low_m) / size_m
    i, j, k = np.minimum(box_position * 3, 2).astype(np.int64).T
    return _merge_clusters(mesh, (i * 3 + j) * 3 + k, -np.linalg.norm(box_position - 0.5, axis=1))


def _merge_clusters(mesh: Mesh, cluster: I8, cost: NDArray[np.floating]) -> Mesh:
    """Move all vertices (n,) of a cluster to its vertex of least cost.

    Faces that then have no area are removed.
    """
    order = np.lexsort([cost, cluster])
    _, first, cluster_of = np.unique(cluster[order], return_index=True, return_inverse=True)
    cluster_of_vertex = np.empty(len(order), np.uint32)
    cluster_of_vertex[order] = cluster_of
    faces = cluster_of_vertex[triangles(mesh)]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, distinct = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return Mesh(mesh.vertices_m[order[first]], faces[distinct])


def fewer_faces(mesh: Mesh, limit: int, *, keeps_area: bool) -> Mesh:
    """Return a mesh with at most `limit` of its faces.

    They are the largest, or with `keeps_area` a sample that is enlarged to the same total area (R. L. Cook et
    al., "Stochastic simplification of aggregate detail", SIGGRAPH 2007).
    """
    corners_m = mesh.vertices_m[mesh.faces]
    count = len(corners_m)
    if count <= limit:
        return mesh
    if keeps_area:
        corners_kept_m = corners_m[np.linspace(0, count - 1, limit).astype(np.int64)]
        middle_m = corners_kept_m.mean(axis=1, keepdims=True)
        corners_kept_m = middle_m + min(np.sqrt(count / limit), _GREATEST_SCALE) * (corners_kept_m - middle_m)
    else:
        sides_m = corners_m[:, 1:3] - corners_m[:, :1]
        area_m2 = np.linalg.norm(np.cross(sides_m[:, 0], sides_m[:, 1]), axis=1)
        corners_kept_m = corners_m[np.argpartition(area_m2, count - limit)[count - limit :]]
    faces = np.arange(corners_kept_m.shape[0] * corners_kept_m.shape[1], dtype=np.uint32).reshape(
        corners_kept_m.shape[:2]
    )
    return Mesh(corners_kept_m.reshape(-1, 3).astype(np.float32), faces)


def triangles(mesh: Mesh) -> U4:
    """Return triangles (n, 3) of a mesh; quads (a, b, c, d) become (a, b, d), (c, d, b), as in casters."""
    faces = mesh.faces
    return faces if faces.shape[1] == 3 else np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return triangles of all meshes as one mesh."""
    first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    faces = [triangles(mesh) + np.uint32(begin) for mesh, begin in zip(meshes, first, strict=False)]
    return Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces))
