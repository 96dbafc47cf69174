"""Clouds: the projected area of shapes in cells of 0.25 m, or face by face for shapes with few faces.

A shape is measured once, with the mutual occlusion of its leaves and wood subtracted, and its cloud is placed
at each instance (`vlp16emu.foliage.medium`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, hypot, log, norm
from vlp16emu.foliage.tiles import EXACT
from vlp16emu.foliage.voxel import KNOTS, QUANTILES, VOXEL_M
from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.types import F4, F8, I4, I8, U1, Mesh, PlantPart

TILTS = 64
"""Number of classes of faces by their tilt, and of light by its cosine of incidence. Classes of tilt are
narrow for faces that lie nearly level: level light meets these in proportion to their tilt."""
_PIXELS = 32  # pixels along a voxel's edge in which faces are rasterized, 16 mm each
_CELL_M = 0.25
_FEW_FACES = 2000
"""Shapes with at most this many faces are kept face by face: saplings, whose leaves hide each other as those
of crowns do, and stones, logs, ferns and tufts, which are stretched when placed."""
_TUFTS = 0.43
"""Least share of the variance of what is hidden between squares of 62 mm that makes the leaves of a shape
tufts. Crowns of Scots pine have 0.49 to 0.57, shrubs and saplings with large leaves about 0.45, crowns of
spruce, birch, oak, sycamore and beech 0.27 to 0.39."""
_SQUARE = 4  # pixels along the edge of such a square
_CUTS = 4  # of the triangles of a branch where it leaves the stem: to pieces of some centimetres


_COSINE = (np.arange(TILTS) + 0.5) / TILTS
_SINE = 1.0 - np.square(_COSINE)  # of the elevation of a normal, by class of tilt
_LEVEL = np.sqrt(1.0 - np.square(KNOTS))[:, None] * np.sqrt(1.0 - np.square(_SINE))
_AZIMUTH = (np.arange(256) + 0.5) * (np.pi / 256)
PROJECTION: F8 = np.abs(_LEVEL[..., None] * cos(_AZIMUTH) + (KNOTS[:, None] * _SINE)[..., None]).mean(axis=-1)
"""Mean projected share of a face over all azimuths, (knots, tilts)."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Projected area of a shape, for a medium."""

    place_m: F4  # (n, 3) positions of its area in the shape's frame; empty for shapes with few faces
    area_m2: F4  # (n,) area that a ray can meet: one side of leaves, half the surface of closed bodies
    mesh: U1  # (n,) index of the shape's mesh
    corners_m: F4
    """Faces (f, 4, 3) of a shape with few faces, triangles with their last corner twice; empty for other
    shapes."""
    corner_mesh: U1  # (f,) index of the shape's mesh
    corner_share: F4
    """(f,) share of the face's area that counts: 1 of leaves, 0.5 of closed bodies, and of saplings as much
    of these as is in view."""
    projection: F4
    """Projected area over area (meshes, knots), averaged over azimuth: the angular law of the shape's
    parts."""
    cosine: F4  # (meshes, knots, QUANTILES) quantiles of the cosine of incidence, of what is in view
    radius_m: float  # greatest distance of a corner from the shape's origin
    tufts: bool  # True if its leaves are in tufts, as in `vlp16emu.foliage.voxel`


def cloud_of(meshes: Sequence[Mesh], parts: U1, core: F8 | None = None) -> Cloud:
    """Measure the projected area of a shape of some meshes.

    Parameters
    ----------
    parts : (meshes,) `PlantPart` of each mesh; meshes that are `EXACT` are left out
    core : (2, k) heights, ascending, and radii of the stem around the shape's z axis, in which branches
        begin; None for other shapes
    """
    exact = (parts == EXACT).tolist()
    meshes = [
        Mesh(mesh.vertices_m, mesh.faces[: 0 if out else None])
        for mesh, out in zip(meshes, exact, strict=True)
    ]
    share = np.where(parts == PlantPart.LEAF, 1.0, 0.5).astype(np.float32)
    first = np.cumsum([0, *(len(mesh.faces) for mesh in meshes)])
    corners_m = np.empty((first[-1], 4, 3))
    for mesh, begin, stop in zip(meshes, first, first[1:], strict=False):
        faces_m = corners_m[begin:stop]
        faces_m[:, : mesh.faces.shape[1]] = mesh.vertices_m.take(mesh.faces, axis=0)
        if mesh.faces.shape[1] == 3:
            faces_m[:, 3] = faces_m[:, 2]
    mesh_of = np.repeat(np.arange(len(meshes)), np.diff(first))
    few = len(corners_m) <= _FEW_FACES
    if core is not None:
        corners_m, mesh_of = outside(corners_m, mesh_of, core)
        first = np.searchsorted(mesh_of, np.arange(len(meshes) + 1))
    area_m2, weight = _face_areas(corners_m, mesh_of, len(meshes))
    projection = np.zeros((len(meshes), len(KNOTS)))
    cosine = np.ones((len(meshes), len(KNOTS), QUANTILES))
    for number in np.flatnonzero(weight.any(axis=1)).tolist():
        projection[number], cosine[number] = _angular_law(weight[number])
    counted = share[mesh_of]
    is_leaf = parts == PlantPart.LEAF
    tufts = False
    if not few or (is_leaf.any() and not is_leaf.all()):
        effective, light, coarse = look_through(corners_m, first, share)
        tufts = coarse > _TUFTS
        counted = (counted * effective).astype(np.float32)
        cosine = _as_seen(cosine, light)
    if few:
        cells = np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.uint8)
        kept = corners_m.astype(np.float32), mesh_of.astype(np.uint8), counted
    else:
        cells = _cells(corners_m, mesh_of, area_m2 * counted)
        kept = np.zeros((0, 4, 3), np.float32), np.zeros(0, np.uint8), np.zeros(0, np.float32)
    radius_m = float(norm(corners_m).max(initial=0.0))
    return Cloud(*cells, *kept, projection.astype(np.float32), cosine.astype(np.float32), radius_m, tufts)


def outside(corners_m: F8, mesh_of: I8, core: F8) -> tuple[F8, I8]:
    """Return what of faces (f, 4, 3) is outside a stem, and their meshes.

    Branches begin on the stem's axis. Once it is spread over a voxel, what is inside the bark would be met in
    front of the stem too. Triangles across the bark are cut in halves, `_CUTS` times.
    """
    for _ in range(_CUTS):
        within = _is_within(corners_m, core)
        across = within.any(axis=1) & ~within.all(axis=1) & (corners_m[:, 2] == corners_m[:, 3]).all(axis=1)
        halves = _halves(corners_m[across])
        corners_m = np.concatenate([corners_m[~across], *halves])
        mesh_of = np.concatenate([mesh_of[~across], mesh_of[across], mesh_of[across]])
    keep = ~_is_within(_middles_m(corners_m), core)
    order = np.argsort(mesh_of[keep], kind="stable")
    return corners_m[keep][order], mesh_of[keep][order]


def _is_within(points_m: F8, core: F8) -> NDArray[np.bool_]:
    """Return a mask (...,) of the points (..., 3) inside a stem."""
    radius_m = np.interp(points_m[..., 2], core[0], core[1], left=0.0, right=0.0)
    return np.asarray(hypot(points_m[..., 0], points_m[..., 1]) < radius_m)


def _halves(corners_m: F8) -> tuple[F8, F8]:
    """Cut triangles (f, 4, 3), whose last corner is there twice, through the middle of their longest side."""
    corners_m = corners_m[:, :3]
    longest = norm(np.roll(corners_m, -1, axis=1) - corners_m).argmax(axis=1)
    turned = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(corners_m, turned[..., None], axis=1), 1, 0)
    middle = (a + b) / 2
    return np.stack([a, middle, c, c], axis=1), np.stack([middle, b, c, c], axis=1)


def _face_areas(corners_m: F8, mesh_of: I8, meshes: int) -> tuple[F8, F8]:
    """Return areas (f,) of faces (f, 4, 3), and their sums (meshes, `TILTS`) by tilt of the normal."""
    nx, ny, nz = _normals_m2(corners_m)
    area_m2 = np.sqrt(nx * nx + ny * ny + nz * nz)
    sine = np.minimum(np.abs(nz) / np.maximum(area_m2, 1e-12), 1.0)
    tilt = np.minimum((np.sqrt(1.0 - sine) * TILTS).astype(np.int64), TILTS - 1)
    weight = np.bincount(mesh_of * TILTS + tilt, area_m2, meshes * TILTS)  # sums in the order of faces
    return area_m2, weight.reshape(meshes, TILTS)  # type: ignore[return-value]  # its stubs know no weights


def _normals_m2(corners_m: F8) -> tuple[F8, F8, F8]:
    """Return the normals of faces (f, 4, 3) as x, y, z (f,), each as long as its face is large."""
    ax, ay, az = (corners_m[:, 2] - corners_m[:, 0]).T
    bx, by, bz = (corners_m[:, 3] - corners_m[:, 1]).T
    return 0.5 * (ay * bz - az * by), 0.5 * (az * bx - ax * bz), 0.5 * (ax * by - ay * bx)


@cache
def _incidence() -> list[tuple[NDArray[np.intp], F8]]:
    """Return, for each knot, the order that sorts the incidence cosines (`TILTS` x 64), and them sorted."""
    azimuth = (np.arange(64) + 0.5) * (np.pi / 64)
    found = []
    for up in KNOTS:
        level = math.sqrt(1.0 - up * up)
        met = np.abs(level * np.sqrt(1.0 - np.square(_SINE))[:, None] * cos(azimuth) + up * _SINE[:, None])
        order = np.argsort(met, axis=None, kind="stable")
        found.append((order, met.ravel()[order]))
    return found


def _angular_law(weight: F8) -> tuple[F8, F8]:
    """Return mean projected shares (knots,), and quantiles (knots, QUANTILES) of the incidence cosine.

    Parameters
    ----------
    weight : (`TILTS`,) area of the faces by tilt
    """
    cosine = np.empty((len(KNOTS), QUANTILES))
    for knot, (order, met) in enumerate(_incidence()):
        so_far = np.cumsum(weight[order // 64] * met)
        wanted = (np.arange(QUANTILES) + 0.5) / QUANTILES * so_far[-1]
        cosine[knot] = met[np.searchsorted(so_far, wanted)]
    return (PROJECTION * weight).sum(axis=1) / weight.sum(), cosine


def _cells(corners_m: F8, mesh_of: I8, area_m2: F8) -> tuple[F4, F4, U1]:
    """Sum faces in cells of `_CELL_M` by mesh and position; return positions, areas and mesh indices."""
    middle_m = _middles_m(corners_m)
    at = np.floor(middle_m / _CELL_M).astype(np.int64)
    at -= at.min(axis=0)
    _, ny, nz = (at.max(axis=0) + 1).tolist()
    column = mesh_of * (at[:, 0].max() + 1) + at[:, 0]
    _, some, cell = np.unique(
        (column * ny + at[:, 1]) * nz + at[:, 2], return_index=True, return_inverse=True
    )
    total = np.bincount(cell, area_m2)  # in the order of faces
    weighted = np.column_stack([np.bincount(cell, area_m2 * along_m) for along_m in middle_m.T])
    place_m = weighted / np.maximum(total, 1e-12)[:, None]
    return place_m.astype(np.float32), total.astype(np.float32), mesh_of[some].astype(np.uint8)


def _middles_m(corners_m: F8) -> F8:
    """Return the middles (f, 3) of faces (f, 4, 3)."""
    return 0.25 * (corners_m[:, 0] + corners_m[:, 1] + corners_m[:, 2] + corners_m[:, 3])


def look_through(corners_m: F8, first: I8, share: F4) -> tuple[F8, F8, float]:
    """Look through a shape along x and along y.

    Returns the share (f,) of each face's area that hides as much when placed at random; the light
    (meshes, 2, `TILTS`) of each mesh by its cosine of incidence: what is in view, and all; and the share of
    the variance of what is hidden in a voxel that lies between squares of 62 mm.

    All faces are rasterized along x and along y, voxel by voxel. Randomly placed faces that hide the same
    part of a voxel's side have an area of -log(1 - hidden) times that side (Beer's law); clumped faces have
    more area than that. Meshes have parts of it as they are in front, seen from both sides: twigs amid their
    own leaves are hardly seen.

    Parameters
    ----------
    corners_m, first : faces (f, 4, 3), and index of the first face of each mesh
    share : (meshes,) share of a face's area that counts
    """
    low, high = (limit(corners_m.reshape(-1, 3), axis=0) / VOXEL_M for limit in (np.min, np.max))
    low = np.floor(low)
    size = (np.ceil(high) - low + 1).astype(int)
    middle = _middles_m(corners_m) / VOXEL_M - low
    mesh_of = np.repeat(np.arange(len(share)), np.diff(first))
    factor = np.zeros((len(share), *size))
    total = np.zeros((len(share), *size), np.int64)
    light = np.zeros((len(share), 2, TILTS))
    variance = np.zeros(2)
    for axis in (0, 1):
        slab = middle[:, axis].astype(np.int64)
        order = np.argsort(slab, kind="stable")
        begin = np.searchsorted(slab[order], np.arange(size[axis] + 1))
        view = _View(
            np.full((2, size[1 - axis], size[2], _PIXELS, _PIXELS), np.inf, np.float32),
            np.full((2, size[1 - axis], size[2], _PIXELS, _PIXELS), -1, np.int32),
            np.empty((5, 4)),
        )
        facing = _mesh_and_facing(corners_m, mesh_of, axis)
        _look(corners_m, facing, low, axis, order, begin, view, factor, total, light, variance)
    at = np.ravel_multi_index((mesh_of, *middle.astype(np.int64).T), factor.shape)
    drawn = total.ravel()[at]
    kept = factor.ravel()[at] / (np.maximum(drawn, 1) * share[mesh_of])
    coarse = float(variance[0] / max(variance[1], 1e-12))
    return np.where(drawn > 0, kept, 1.0), light, coarse


def _mesh_and_facing(corners_m: F8, mesh_of: I8, axis: int) -> I8:
    """Return the mesh and the class of the cosine of incidence along an axis of each face, (f, 2)."""
    normal = np.stack(_normals_m2(corners_m))
    cosine = np.abs(normal[axis]) / np.maximum(np.sqrt((normal * normal).sum(axis=0)), 1e-12)
    return np.column_stack([mesh_of, np.minimum((cosine * TILTS).astype(np.int64), TILTS - 1)])


def _as_seen(cosine: F8, light: F8) -> F8:
    """Return quantiles of the cosine of incidence of what is in view, for light up to 17 degrees steep.

    Faces that light meets at a slant are hidden more often by others, so what is in view has a greater mean.
    The difference is that of level light.
    """
    mean = (light * _COSINE).sum(axis=2) / np.maximum(light.sum(axis=2), 1e-12)
    shown = cosine.copy()
    shown[:, :2] = np.clip(cosine[:, :2] + (mean[:, 0] - mean[:, 1])[:, None, None], 0.0, 1.0)
    return shown


class _View(NamedTuple):
    """Nearest things in the pixels of a slab of voxels, from front and behind; empty between slabs."""

    depth: F4  # (2, a, z, pixels, pixels) in voxels, the second one negative
    face: I4  # likewise: face that is seen; -1 for none
    edges: F8  # (5, 4)


@kernel
def _look(
    corners_m: F8,
    facing: I8,
    low: F8,
    axis: int,
    order: I8,
    begin: I8,
    view: _View,
    factor: F8,
    total: I8,
    light: F8,
    variance: F8,
) -> None:
    """Look through slab after slab along an axis; add to the effective areas and to the pixels of meshes.

    Parameters
    ----------
    facing : as from `_mesh_and_facing`
    order, begin : faces by slab, and the place of each slab's first one among them
    factor, total : (meshes, x, y, z) in pixels
    light : (meshes, 2, `TILTS`) in pixels, as `look_through` returns it
    variance : (2,) of what is hidden, summed over voxels: between squares of 62 mm, and all
    """
    for slab in range(len(begin) - 1):
        if begin[slab] == begin[slab + 1]:
            continue
        for number in range(begin[slab], begin[slab + 1]):
            face = order[number]
            _draw(corners_m[face], face, facing[face], slab, low, axis, view, total, light)
        for a in range(view.face.shape[1]):
            for z in range(view.face.shape[2]):
                x, y = (slab, a) if axis == 0 else (a, slab)
                if total[:, x, y, z].any():
                    _count(view.face[:, a, z], facing, factor[:, x, y, z], light)
                    _add_variance(view.face[0, a, z], variance)
                    view.depth[:, a, z] = np.inf
                    view.face[:, a, z] = -1


@inline_kernel
def _count(face: I4, facing: I8, factor: F8, light: F8) -> None:
    """Add the area of randomly placed faces that hide as many pixels of a voxel, to each mesh its part."""
    hidden = 0
    for row in range(_PIXELS):
        for pixel in range(_PIXELS):
            hidden += face[0, row, pixel] >= 0
    if hidden == 0:
        return
    share = min(hidden / (_PIXELS * _PIXELS), 1.0 - 0.5 / (_PIXELS * _PIXELS))
    weight = -log(1.0 - share) * (_PIXELS * _PIXELS) / (2 * hidden)
    for side in range(2):
        for row in range(_PIXELS):
            for pixel in range(_PIXELS):
                shown = face[side, row, pixel]
                if shown >= 0:
                    factor[facing[shown, 0]] += weight
                    light[facing[shown, 0], 0, facing[shown, 1]] += weight


@inline_kernel
def _add_variance(face: I4, variance: F8) -> None:
    """Add the variance of what is hidden in a voxel: between squares of 62 mm, and between pixels."""
    squares = _PIXELS // _SQUARE
    mean = 0.0
    of_squares = 0.0
    for a in range(squares):
        for b in range(squares):
            hidden = 0
            for row in range(_SQUARE * a, _SQUARE * (a + 1)):
                for pixel in range(_SQUARE * b, _SQUARE * (b + 1)):
                    hidden += face[row, pixel] >= 0
            share = hidden / (_SQUARE * _SQUARE)
            mean += share
            of_squares += share * share
    mean /= squares * squares
    variance[0] += of_squares / (squares * squares) - mean * mean
    variance[1] += mean - mean * mean


@inline_kernel
def _draw(
    corners_m: F8, face: int, facing: I8, slab: int, low: F8, axis: int, view: _View, total: I8, light: F8
) -> None:
    """Rasterize a face along an axis into the voxels of its slab; count all pixels, overlaps too."""
    edges = view.edges
    _turn_edges(corners_m, low, 1 - axis, edges)
    u = edges[0]
    v = edges[1]
    depth = edges[4]
    for c in range(4):
        depth[c] = corners_m[c, axis] / VOXEL_M - low[axis]
    middle = 0.25 * (depth[0] + depth[1] + depth[2] + depth[3])
    left, right = math.floor(min(u[0], u[1], u[2], u[3])), math.floor(max(u[0], u[1], u[2], u[3]))
    lower, upper = math.floor(min(v[0], v[1], v[2], v[3])), math.floor(max(v[0], v[1], v[2], v[3]))
    for q in range(lower, upper + 1):
        first, last = _row(edges, q + 0.5, left, right)
        for p in range(first, last + 1):
            a = p // _PIXELS
            z = q // _PIXELS
            x, y = (slab, a) if axis == 0 else (a, slab)
            total[facing[0], x, y, z] += 1
            light[facing[0], 1, facing[1]] += 1.0
            for side in range(2):
                at = middle if side == 0 else -middle
                if at < view.depth[side, a, z, q % _PIXELS, p % _PIXELS]:
                    view.depth[side, a, z, q % _PIXELS, p % _PIXELS] = at
                    view.face[side, a, z, q % _PIXELS, p % _PIXELS] = face


@inline_kernel
def _turn_edges(corners_m: F8, low: F8, across: int, edges: F8) -> None:
    """Fill starts and directions (4, 4) of the edges of a face, in pixels, with the face on their left."""
    u = edges[0]
    v = edges[1]
    du = edges[2]
    dv = edges[3]
    for c in range(4):
        u[c] = (corners_m[c, across] / VOXEL_M - low[across]) * _PIXELS
        v[c] = (corners_m[c, 2] / VOXEL_M - low[2]) * _PIXELS
    turn = 0.0
    for c in range(4):
        n = (c + 1) & 3
        turn += u[c] * v[n] - u[n] * v[c]
        du[c] = u[n] - u[c]
        dv[c] = v[n] - v[c]
    if not turn > 0:
        for c in range(4):
            du[c] = -du[c]
            dv[c] = -dv[c]


@inline_kernel
def _row(edges: F8, y: float, first: int, last: int) -> tuple[int, int]:
    """Return the first and last pixel of a row whose centres are on the left of all edges."""
    u = edges[0]
    v = edges[1]
    du = edges[2]
    dv = edges[3]
    for c in range(4):
        across = du[c] * (y - v[c])
        slope = dv[c]
        from_u = u[c]
        if slope > 0.0:
            while last >= first and across < slope * (last + 0.5 - from_u):
                last -= 1
        else:
            while last >= first and across < slope * (first + 0.5 - from_u):
                first += 1
    return first, last


class Library(NamedTuple):
    """Clouds of several shapes, concatenated."""

    first_cell: I8  # (shapes + 1,)
    place_m: F4
    area_m2: F4
    mesh: U1
    first_face: I8  # (shapes + 1,)
    corners_m: F4
    corner_mesh: U1
    corner_share: F4
    first_law: I8  # (shapes + 1,) law of each shape's first mesh
    projection: F4
    radius_m: F8  # (shapes,)
    tufts: U1  # (laws,) 1 if the leaves of its shape are in tufts

    @classmethod
    def of(cls, clouds: Sequence[Cloud]) -> "Library":
        """Concatenate clouds."""

        def first(arrays: Sequence[F4]) -> I8:
            return np.cumsum([0, *(len(array) for array in arrays)])

        joined = ("place_m", "area_m2", "mesh", "corners_m", "corner_mesh", "corner_share", "projection")
        return cls(
            first_cell=first([cloud.place_m for cloud in clouds]),
            first_face=first([cloud.corners_m for cloud in clouds]),
            first_law=first([cloud.projection for cloud in clouds]),
            radius_m=np.array([cloud.radius_m for cloud in clouds]),
            tufts=np.repeat(
                np.array([cloud.tufts for cloud in clouds], np.uint8),
                [len(cloud.projection) for cloud in clouds],
            ),
            **{name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in joined},
        )
