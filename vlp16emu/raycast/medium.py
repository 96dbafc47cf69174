"""Foliage from afar: voxels of 0.5 m with the leaf and wood area of the very shapes that stand there.

A shape with many faces is measured once: its projected area in cells of 0.25 m (`Cloud`). Placements add these areas, and
those of shapes with few faces face by face, to the voxels of a tile of the world (`Block`); tiles make up the medium of a
window (`vlp16emu.raycast.march`). Everything is a function of the tile and its neighbours alone, so blocks are kept from
window to window.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import FarTile, Mesh, PlantPart

__all__ = ["BRICK", "COLUMNS", "GROUND", "KNOTS", "QUANTILES", "STEM", "TAU_PER_M", "VOXEL_M", "Block", "Cloud", "Library", "block_of", "cloud_of", "stem_beside", "stem_columns", "stem_lines"]

VOXEL_M = 0.5
BRICK = 4
"""Voxels along the edge of a brick."""
COLUMNS = 40
"""Voxels along the edge of a tile of 20 m."""

KNOTS = np.array([0.0, 0.3, 1.0])
"""Sines of the elevations at which projected areas are known: level, 17 degrees, and upright."""
QUANTILES = 16
"""Of the cosine of incidence, at middles of equal shares of the projected area."""

_TAU_CODES, _TAU_MAX_PER_M = 127, 24.0
TAU_PER_M = (_TAU_MAX_PER_M * (np.arange(_TAU_CODES + 1) / _TAU_CODES) ** 2).astype(np.float32)
"""Projected area per volume of each of the codes that voxels have."""

GROUND, STEM = np.uint32(1 << 21), np.uint32(1 << 22)
"""Flags of a voxel, above its three codes of seven bits: the ground, or a stem, may be met in or beside it."""

_CELL_M = 0.25
_FEW_FACES = 2000
"""Shapes of no more faces are taken face by face: stones, logs and tufts, which are stretched where they are placed."""
_PIXELS = 32
"""Of a voxel's edge, 16 mm each, in which faces are drawn to see how much they hide of each other."""
_PIECE_M = 0.25
"""Faces larger than this are cut."""
_TILTS = 64
_ASIDE_M = 0.26 + 0.16
"""How far beside a voxel a stem may be that is looked for in it: half a voxel, for a ray is looked at in the middle of
each voxel that it passes, and the half width of a beam of 3 mrad at 100 m."""

Array = NDArray[np.float64]


def _projection() -> Array:
    """Mean over all azimuths of the projected share of a face, (knots, tilts), by the sine of the normal's elevation."""
    level, up = np.sqrt(1.0 - KNOTS**2)[:, None], KNOTS[:, None]
    sine = (np.arange(_TILTS) + 0.5) / _TILTS
    azimuth = (np.arange(256) + 0.5) * (np.pi / 256)
    a, b = level * np.sqrt(1.0 - sine**2), up * sine
    mean: Array = np.abs(a[..., None] * np.cos(azimuth) + b[..., None]).mean(axis=-1)
    return mean


_PROJECTION = _projection()


@dataclass(frozen=True, slots=True)
class Cloud:
    """A shape, as a medium takes it."""

    place_m: NDArray[np.float32]
    """(n, 3) where its area lies, in the shape's own frame; none of shapes with few faces."""
    area_m2: NDArray[np.float32]
    """(n,) that a ray can meet: one side of leaves, half the surface of closed bodies."""
    mesh: NDArray[np.uint8]
    """(n,) to which of the shape's meshes it belongs."""
    corners_m: NDArray[np.float32]
    """(f, 4, 3) faces of a shape with few of them, triangles with their last corner twice; none of other shapes."""
    corner_mesh: NDArray[np.uint8]
    """(f,) to which of the shape's meshes they belong."""
    share: NDArray[np.float32]
    """(meshes,) of a face's area that counts: 1 of leaves, 0.5 of closed bodies."""
    projection: NDArray[np.float32]
    """(meshes, knots) projected area over area, for light of any azimuth: the angular law of the shape's parts."""
    cosine: NDArray[np.float32]
    """(meshes, knots, QUANTILES) of the cosine of incidence where light meets them."""
    radius_m: float
    """Greatest distance of a corner from the shape's origin."""


def cloud_of(meshes: Sequence[Mesh], parts: NDArray[np.uint8]) -> Cloud:
    """Measure a shape.

    Parameters
    ----------
    parts : (meshes,) `PlantPart` of each
    """
    share = np.where(parts == PlantPart.LEAF, 1.0, 0.5).astype(np.float32)
    faces = [_corners(mesh) for mesh in meshes]
    corners_m, of = np.concatenate(faces), np.repeat(np.arange(len(meshes), dtype=np.uint8), [len(f) for f in faces])
    normal = 0.5 * np.cross(corners_m[:, 2] - corners_m[:, 0], corners_m[:, 3] - corners_m[:, 1])
    area_m2 = np.linalg.norm(normal, axis=1)
    sine = np.abs(normal[:, 2]) / np.maximum(area_m2, 1e-12)
    projection, cosine = np.zeros((len(meshes), len(KNOTS))), np.ones((len(meshes), len(KNOTS), QUANTILES))
    for mesh in range(len(meshes)):
        own = of == mesh
        if area_m2[own].sum() > 0:
            projection[mesh], cosine[mesh] = _law(area_m2[own], sine[own])
    radius_m = float(np.linalg.norm(corners_m, axis=-1).max(initial=0.0))
    none = np.zeros((0, 4, 3), np.float32), np.zeros(0, np.uint8)
    if len(corners_m) <= _FEW_FACES:
        cells = np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.uint8)
        kept = corners_m.astype(np.float32), of
    else:
        middle_m = corners_m.mean(axis=1)
        box = np.floor(corners_m.reshape(-1, 3).min(axis=0) / VOXEL_M)
        size = np.ceil(corners_m.reshape(-1, 3).max(axis=0) / VOXEL_M) - box + 1
        kept_share = _kept(corners_m / VOXEL_M - box, of, share, tuple(size.astype(int).tolist()))
        cells, kept = _cells(middle_m, area_m2 * share[of] * kept_share, of), none
    return Cloud(*cells, *kept, share, projection.astype(np.float32), cosine.astype(np.float32), radius_m)


def _corners(mesh: Mesh) -> Array:
    """Corners of faces (f, 4, 3)."""
    corners = mesh.vertices_m[mesh.faces].astype(np.float64)
    return corners if corners.shape[1] == 4 else corners[:, [0, 1, 2, 2]]


def _law(area_m2: Array, sine: Array) -> tuple[Array, Array]:
    """Mean projected share of faces (knots,), and quantiles (knots, QUANTILES) of the cosine of incidence."""
    tilt = np.minimum((sine * _TILTS).astype(np.int64), _TILTS - 1)
    weight = np.bincount(tilt, area_m2, _TILTS)
    projection = _PROJECTION @ weight / weight.sum()
    at = (np.arange(_TILTS) + 0.5) / _TILTS
    azimuth = (np.arange(64) + 0.5) * (np.pi / 64)
    cosine = np.empty((len(KNOTS), QUANTILES))
    for knot, up in enumerate(KNOTS):
        level = math.sqrt(1.0 - up * up)
        met = np.abs(level * np.sqrt(1.0 - at**2)[:, None] * np.cos(azimuth) + up * at[:, None])
        mass = weight[:, None] * met
        order = np.argsort(met, axis=None)
        so_far = np.cumsum(mass.ravel()[order])
        wanted = (np.arange(QUANTILES) + 0.5) / QUANTILES * so_far[-1]
        cosine[knot] = met.ravel()[order][np.searchsorted(so_far, wanted)]
    return projection, cosine


@numba.njit(cache=True, nogil=True)
def _kept(
    corners: Array, of: NDArray[np.uint8], share: NDArray[np.float32], size: tuple[int, int, int]
) -> Array:
    """Share of each face's area (f,) that is left where leaves that hide each other are taken for leaves at random.

    The faces of each mesh are drawn as seen along x and along y, voxel by voxel. Leaves at random that hide as much of a
    voxel's face have -log(1 - hidden) of its area (Beer's law); the sum of areas is more where leaves grow in clumps.

    Parameters
    ----------
    corners : (f, 4, 3) in voxels from the lowest corner of `size` voxels
    """
    drawn = np.zeros((*size, _PIXELS), np.uint32)
    factor, total = np.zeros((len(share), *size)), np.zeros((len(share), *size))
    for mesh in range(len(share)):
        for axis in (0, 1):
            drawn[:] = 0
            for f in range(len(corners)):
                if of[f] == mesh:
                    _draw(corners[f], axis, drawn, total[mesh])
            for i, j, k in np.ndindex(size):
                bits = 0
                for line in drawn[i, j, k]:
                    while line:
                        line &= line - np.uint32(1)
                        bits += 1
                hidden = min(bits / _PIXELS**2, 1.0 - 0.5 / _PIXELS**2)
                factor[mesh, i, j, k] -= math.log(1.0 - hidden) * _PIXELS**2
    out = np.ones(len(corners))
    for f in range(len(corners)):
        mesh = of[f]
        i, j, k = _middle(corners[f])
        if total[mesh, i, j, k] > 0:
            out[f] = factor[mesh, i, j, k] / (total[mesh, i, j, k] * share[mesh])
    return out


@numba.njit(cache=True, nogil=True)
def _middle(corners: Array) -> tuple[int, int, int]:
    """Voxel of a face's middle."""
    return (
        int(0.25 * (corners[0, 0] + corners[1, 0] + corners[2, 0] + corners[3, 0])),
        int(0.25 * (corners[0, 1] + corners[1, 1] + corners[2, 1] + corners[3, 1])),
        int(0.25 * (corners[0, 2] + corners[1, 2] + corners[2, 2] + corners[3, 2])),
    )


@numba.njit(cache=True, nogil=True)
def _draw(corners: Array, axis: int, drawn: NDArray[np.uint32], total: Array) -> None:
    """Draw a face as seen along an axis, into the voxels of its own depth; count its pixels, drawn before or not."""
    other = 1 - axis
    depth = _middle(corners)[axis]
    u, v = corners[:, other] * _PIXELS, corners[:, 2] * _PIXELS
    turn = 0.0
    for c in range(4):
        n = (c + 1) % 4
        turn += u[c] * v[n] - u[n] * v[c]
    side = 1.0 if turn > 0 else -1.0
    for p in range(int(math.floor(u.min())), int(math.floor(u.max())) + 1):
        for q in range(int(math.floor(v.min())), int(math.floor(v.max())) + 1):
            inside = True
            for c in range(4):
                n = (c + 1) % 4
                across = (u[n] - u[c]) * (q + 0.5 - v[c]) - (v[n] - v[c]) * (p + 0.5 - u[c])
                if side * across < 0.0:
                    inside = False
                    break
            if inside:
                a, b = p // _PIXELS, q // _PIXELS
                i, j = (depth, a) if axis == 0 else (a, depth)
                drawn[i, j, b, q % _PIXELS] |= np.uint32(1) << np.uint32(p % _PIXELS)
                total[i, j, b] += 1.0


def _cells(
    middle_m: Array, area_m2: Array, mesh: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Gather faces in cells of `_CELL_M`: where their area lies, how much it is, and whose."""
    cell = np.floor(middle_m / _CELL_M).astype(np.int64) + (1 << 15)
    name = ((mesh.astype(np.int64) << 16 | cell[:, 0]) << 16 | cell[:, 1]) << 16 | cell[:, 2]
    name, of = np.unique(name, return_inverse=True)
    total = np.bincount(of, area_m2)
    place_m = np.stack([np.bincount(of, area_m2 * axis) for axis in middle_m.T], axis=1)
    place_m /= np.maximum(total, 1e-12)[:, None]
    return place_m.astype(np.float32), total.astype(np.float32), (name >> 48).astype(np.uint8)


class Library(NamedTuple):
    """Clouds of several shapes, one after the other."""

    first_cell: NDArray[np.int64]
    """(shapes + 1,)."""
    place_m: NDArray[np.float32]
    area_m2: NDArray[np.float32]
    mesh: NDArray[np.uint8]
    first_face: NDArray[np.int64]
    """(shapes + 1,)."""
    corners_m: NDArray[np.float32]
    corner_mesh: NDArray[np.uint8]
    first_law: NDArray[np.int64]
    """(shapes + 1,) law of each shape's first mesh."""
    share: NDArray[np.float32]
    projection: NDArray[np.float32]
    radius_m: NDArray[np.float64]
    """(shapes,)."""

    @classmethod
    def of(cls, clouds: Sequence[Cloud]) -> "Library":
        """Put clouds together."""

        def first(arrays: Sequence[NDArray[np.float32]]) -> NDArray[np.int64]:
            """Where each begins."""
            return np.cumsum([0, *(len(array) for array in arrays)])

        return cls(
            first([c.place_m for c in clouds]),
            np.concatenate([c.place_m for c in clouds]),
            np.concatenate([c.area_m2 for c in clouds]),
            np.concatenate([c.mesh for c in clouds]),
            first([c.corners_m for c in clouds]),
            np.concatenate([c.corners_m for c in clouds]),
            np.concatenate([c.corner_mesh for c in clouds]),
            first([c.share for c in clouds]),
            np.concatenate([c.share for c in clouds]),
            np.concatenate([c.projection for c in clouds]),
            np.array([c.radius_m for c in clouds]),
        )


@dataclass(frozen=True, slots=True)
class Block:
    """The voxels of a tile, in bricks of 4 x 4 x 4."""

    bottom: int
    """Level of the lowest bricks, in bricks from a height of 0."""
    mask: NDArray[np.uint64]
    """(10, 10, n) which voxels of each brick hold anything: bit 16 x + 4 y + z."""
    first: NDArray[np.uint32]
    """(10, 10, n) record of the first of them."""
    record: NDArray[np.uint32]
    """(m,) codes of projected area at the three knots, and flags."""
    first_owner: NDArray[np.uint32]
    """(m,) of each record; its last owner has a share of 255."""
    owner_tile: NDArray[np.uint8]
    """(o,) 3 (dx + 1) + dy + 1 of the tile whose surface it is."""
    owner_row: NDArray[np.uint32]
    """(o,) of that tile's surfaces."""
    owner_law: NDArray[np.uint32]
    """(o,) in the library."""
    owner_share: NDArray[np.uint8]
    """(o,) of the voxel's projected area that belongs to it and to those before it, in 255ths."""


def block_of(library: Library, shape_of: dict[object, int], near: dict[tuple[int, int], FarTile], ix: int, iy: int) -> Block:
    """Make the block of a tile.

    Parameters
    ----------
    shape_of : place in the library by shape
    near : tiles, at least (ix, iy) itself and the eight around it, which may reach into it
    """
    here = near[ix, iy]
    placed, corner_m = list[tuple[NDArray[np.int64], Array, NDArray[np.int64], NDArray[np.int64]]](), here.corner_m
    stems = []
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            tile = near[ix + dx, iy + dy]
            which = np.array([shape_of[key] for key in tile.keys], np.int64)[tile.shape] if len(tile.shape) else np.zeros(0, np.int64)
            world_T = tile.world_T_shape
            at_m = world_T[:, :, 3] - corner_m
            reach_m = library.radius_m[which] * np.sqrt((world_T[:, :, :3] ** 2).sum(axis=1).max(axis=-1))
            gap_m = np.maximum(np.maximum(-at_m[:, :2], at_m[:, :2] - COLUMNS * VOXEL_M), 0.0)
            own = np.flatnonzero((gap_m**2).sum(axis=1) <= reach_m**2)
            relative = world_T[own].copy()
            relative[:, :, 3] = at_m[own]
            placed.append((which[own], relative, tile.first_surface[own], np.full(len(own), 3 * (dx + 1) + dy + 1)))
            if len(tile.stems):
                stems.append(stem_lines(tile.stems, corner_m))
    which, relative, row, tile_of = (np.concatenate([part[i] for part in placed]) for i in range(4))
    lines = np.concatenate(stems) if stems else np.zeros((0, 6))
    low_m, high_m = _span(library, which, relative, lines, here.ground_m - corner_m[2])
    brick_m = BRICK * VOXEL_M
    bottom, top = math.floor(low_m / brick_m), math.ceil(high_m / brick_m)
    return Block(
        bottom + round(corner_m[2] / brick_m),
        *_filled(
            library,
            np.ascontiguousarray(which),
            np.ascontiguousarray(relative),
            row,
            tile_of,
            lines,
            (here.ground_m - corner_m[2]).astype(np.float32),
            bottom * brick_m,
            max(top - bottom, 1),
            _PROJECTION,
        ),
    )


def stem_lines(stems: NDArray[np.void], origin_m: Array) -> Array:
    """Axes of stems: (n, 7) lower end relative to an origin, rise per metre of height in x and y, height, widest radius."""
    axis = stems["axis"]
    low_m, high_m = stems["along_m"][:, 0] * axis[:, 2], stems["along_m"][:, -1] * axis[:, 2]
    slope = axis[:, :2] / axis[:, 2:]
    foot_m = stems["foot_m"] - origin_m
    lower = foot_m + np.column_stack([slope * low_m[:, None], low_m])
    return np.column_stack([lower, slope, high_m - low_m, stems["radius_m"].max(axis=1)])


def _span(library: Library, which: NDArray[np.int64], relative: Array, lines: Array, ground_m: Array) -> tuple[float, float]:
    """Heights between which anything of a tile lies."""
    reach_m = library.radius_m[which] * np.sqrt((relative[:, :, :3] ** 2).sum(axis=1).max(axis=-1))
    low = np.concatenate([ground_m.ravel() - 1.5, lines[:, 2] - 0.5])
    high = np.concatenate([ground_m.ravel() + 1.0, relative[:, 2, 3] + reach_m, lines[:, 2] + lines[:, 5] + 0.5])
    return float(low.min()), float(high.max())


@numba.njit(cache=True, nogil=True)
def _filled(
    library: Library,
    which: NDArray[np.int64],
    relative: Array,
    row: NDArray[np.int64],
    tile_of: NDArray[np.int64],
    lines: Array,
    ground_m: NDArray[np.float32],
    low_m: float,
    levels: int,
    projection: Array,
) -> tuple[
    NDArray[np.uint64],
    NDArray[np.uint32],
    NDArray[np.uint32],
    NDArray[np.uint32],
    NDArray[np.uint8],
    NDArray[np.uint32],
    NDArray[np.uint32],
    NDArray[np.uint8],
]:
    """Fill the arrays of a block, in the order of `Block`."""
    nz = levels * BRICK
    head, flags = np.full((COLUMNS, COLUMNS, nz), -1, np.int32), np.zeros((COLUMNS, COLUMNS, nz), np.uint32)
    room = 4096
    # Owners as linked lists: tile, row, law and the next one; and their projected areas at the knots.
    node, area = np.empty((room, 4), np.int64), np.empty((room, 3))
    used = 0
    add = np.empty(3)
    for p in range(which.shape[0]):
        s, T = which[p], relative[p]
        needed = used + library.first_cell[s + 1] - library.first_cell[s]
        for f in range(library.first_face[s], library.first_face[s + 1]):
            needed += _pieces(T, library.corners_m[f]) ** 2
        while needed > room:
            room *= 2
            bigger, more = np.empty((room, 4), np.int64), np.empty((room, 3))
            bigger[:used], more[:used] = node[:used], area[:used]
            node, area = bigger, more
        scale = abs(_determinant(T)) ** (2.0 / 3.0)
        for c in range(library.first_cell[s], library.first_cell[s + 1]):
            law = library.first_law[s] + library.mesh[c]
            for k in range(3):
                add[k] = library.area_m2[c] * scale * library.projection[law, k]
            a, b, z = library.place_m[c, 0], library.place_m[c, 1], library.place_m[c, 2]
            used = _put(head, node, area, used, T, a, b, z, low_m, tile_of[p], row[p] + library.mesh[c], law, add)
        for f in range(library.first_face[s], library.first_face[s + 1]):
            mesh = library.corner_mesh[f]
            used = _put_face(
                head, node, area, used, T, library.corners_m[f], library.share[library.first_law[s] + mesh],
                low_m, tile_of[p], row[p] + mesh, library.first_law[s] + mesh, add, projection,
            )  # fmt: skip
    for i in range(lines.shape[0]):
        _mark_stem(flags, lines[i], low_m)
    _mark_ground(flags, ground_m, low_m)
    return _pack(head, flags, node, area, used)


@numba.njit(cache=True, nogil=True)
def _determinant(T: Array) -> float:
    """Of the 3 x 3 part of a transform."""
    return (
        T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1])
        - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
        + T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    )


@numba.njit(cache=True, nogil=True)
def _put(head, node, area, used, T, a, b, c, low_m, tile, row, law, add):
    """Add projected areas at a place of a shape to its voxel; return how many owners there are."""
    x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
    y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
    z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] - low_m
    i, j, k = math.floor(x / VOXEL_M), math.floor(y / VOXEL_M), math.floor(z / VOXEL_M)
    if not (0 <= i < head.shape[0] and 0 <= j < head.shape[1] and 0 <= k < head.shape[2]):
        return used
    at = head[i, j, k]
    while at >= 0 and not (node[at, 1] == row and node[at, 0] == tile):
        at = node[at, 3]
    if at < 0:
        at = used
        used += 1
        node[at, 0], node[at, 1], node[at, 2], node[at, 3] = tile, row, law, head[i, j, k]
        area[at, 0] = area[at, 1] = area[at, 2] = 0.0
        head[i, j, k] = at
    for knot in range(3):
        area[at, knot] += add[knot]
    return used


@numba.njit(cache=True, nogil=True)
def _pieces(T: Array, corners_m: NDArray[np.float32]) -> int:
    """Into how many pieces the sides of a face are cut."""
    longest = 0.0
    for side in range(4):
        square = 0.0
        for a in range(3):
            edge = 0.0
            for b in range(3):
                edge += T[a, b] * (corners_m[(side + 1) % 4, b] - corners_m[side, b])
            square += edge * edge
        longest = max(longest, square)
    return min(max(int(math.ceil(math.sqrt(longest) / _PIECE_M)), 1), 64)


@numba.njit(cache=True, nogil=True)
def _put_face(head, node, area, used, T, corners_m, share, low_m, tile, row, law, add, projection):
    """Add a face of a shape, in pieces; return how many owners there are."""
    n = _pieces(T, corners_m)
    # Normal of the placed face from its diagonals; half their cross product is its area.
    u0 = u1 = u2 = v0 = v1 = v2 = 0.0
    for b in range(3):
        first, second = corners_m[2, b] - corners_m[0, b], corners_m[3, b] - corners_m[1, b]
        u0, u1, u2 = u0 + T[0, b] * first, u1 + T[1, b] * first, u2 + T[2, b] * first
        v0, v1, v2 = v0 + T[0, b] * second, v1 + T[1, b] * second, v2 + T[2, b] * second
    x, y, z = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    double = math.sqrt(x * x + y * y + z * z)
    if double <= 0.0:
        return used
    tilt = min(int(abs(z) / double * _TILTS), _TILTS - 1)
    for knot in range(3):
        add[knot] = 0.5 * double * share * projection[knot, tilt] / (n * n)
    for p in range(n):
        for q in range(n):
            u, v = (p + 0.5) / n, (q + 0.5) / n
            w0, w1, w2, w3 = (1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v
            a = w0 * corners_m[0, 0] + w1 * corners_m[1, 0] + w2 * corners_m[2, 0] + w3 * corners_m[3, 0]
            b = w0 * corners_m[0, 1] + w1 * corners_m[1, 1] + w2 * corners_m[2, 1] + w3 * corners_m[3, 1]
            c = w0 * corners_m[0, 2] + w1 * corners_m[1, 2] + w2 * corners_m[2, 2] + w3 * corners_m[3, 2]
            used = _put(head, node, area, used, T, a, b, c, low_m, tile, row, law, add)
    return used


@numba.njit(cache=True, nogil=True)
def stem_columns(line: Array, from_m: float, to_m: float) -> tuple[int, int, int, int]:
    """First and last column of voxels, in x and y, in which a stem may be met between two heights over its lower end."""
    aside_m = line[6] + _ASIDE_M
    x0, x1, y0, y1 = line[0] + line[3] * from_m, line[0] + line[3] * to_m, line[1] + line[4] * from_m, line[1] + line[4] * to_m
    return (
        math.floor((min(x0, x1) - aside_m) / VOXEL_M),
        math.floor((max(x0, x1) + aside_m) / VOXEL_M),
        math.floor((min(y0, y1) - aside_m) / VOXEL_M),
        math.floor((max(y0, y1) + aside_m) / VOXEL_M),
    )


@numba.njit(cache=True, nogil=True)
def stem_beside(line: Array, x: int, y: int) -> bool:
    """Whether a stem comes so near to a column of voxels, at any height, that it may be met there."""
    # From the middle of the column to the axis as seen from above, which is a piece of a straight line.
    a, b = (x + 0.5) * VOXEL_M - line[0], (y + 0.5) * VOXEL_M - line[1]
    u, v = line[3] * line[5], line[4] * line[5]
    square = u * u + v * v
    share = min(max((a * u + b * v) / square, 0.0), 1.0) if square > 0.0 else 0.0
    dx, dy = abs(a - share * u) - VOXEL_M / 2, abs(b - share * v) - VOXEL_M / 2
    aside_m = line[6] + _ASIDE_M
    dx, dy = max(dx, 0.0), max(dy, 0.0)
    return dx * dx + dy * dy <= aside_m * aside_m


@numba.njit(cache=True, nogil=True)
def _mark_stem(flags: NDArray[np.uint32], line: Array, low_m: float) -> None:
    """Flag the voxels in which a stem is looked for."""
    for k in range(flags.shape[2]):
        below_m, above_m = low_m + k * VOXEL_M - line[2] - 0.26, low_m + (k + 1) * VOXEL_M - line[2] + 0.26
        if above_m < 0.0 or below_m > line[5]:
            continue
        x0, x1, y0, y1 = stem_columns(line, max(below_m, 0.0), min(above_m, line[5]))
        for i in range(max(x0, 0), min(x1, flags.shape[0] - 1) + 1):
            for j in range(max(y0, 0), min(y1, flags.shape[1] - 1) + 1):
                if stem_beside(line, i, j):
                    flags[i, j, k] |= STEM


@numba.njit(cache=True, nogil=True)
def _mark_ground(flags: NDArray[np.uint32], ground_m: NDArray[np.float32], low_m: float) -> None:
    """Flag the voxels in which the ground is looked for; heights (43, 43) begin one cell outside the tile."""
    for i in range(flags.shape[0]):
        for j in range(flags.shape[1]):
            low, high = ground_m[i, j], ground_m[i, j]
            for a in range(4):
                for b in range(4):
                    low, high = min(low, ground_m[i + a, j + b]), max(high, ground_m[i + a, j + b])
            first, last = math.floor((low - low_m - 0.6) / VOXEL_M), math.floor((high - low_m + 0.16) / VOXEL_M)
            for k in range(max(first, 0), min(last, flags.shape[2] - 1) + 1):
                flags[i, j, k] |= GROUND


@numba.njit(cache=True, nogil=True)
def _pack(head, flags, node, area, used):
    """Write out what is not empty, brick by brick."""
    nx, ny, nz = head.shape[0] // BRICK, head.shape[1] // BRICK, head.shape[2] // BRICK
    mask, first = np.zeros((nx, ny, nz), np.uint64), np.zeros((nx, ny, nz), np.uint32)
    full = 0
    for i in range(head.shape[0]):
        for j in range(head.shape[1]):
            for k in range(head.shape[2]):
                full += head[i, j, k] >= 0 or flags[i, j, k] != 0
    record, first_owner = np.empty(full, np.uint32), np.empty(full, np.uint32)
    owner_tile, owner_row = np.empty(used, np.uint8), np.empty(used, np.uint32)
    owner_law, owner_share = np.empty(used, np.uint32), np.empty(used, np.uint8)
    n = o = 0
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                first[x, y, z] = n
                for bit in range(64):
                    i, j, k = BRICK * x + (bit >> 4), BRICK * y + ((bit >> 2) & 3), BRICK * z + (bit & 3)
                    at = head[i, j, k]
                    if at < 0 and flags[i, j, k] == 0:
                        continue
                    mask[x, y, z] |= np.uint64(1) << np.uint64(bit)
                    first_owner[n] = o
                    total = area0 = area1 = area2 = 0.0
                    here = at
                    while here >= 0:
                        area0, area1, area2 = area0 + area[here, 0], area1 + area[here, 1], area2 + area[here, 2]
                        total += area[here, 1]
                        here = node[here, 3]
                    so_far = 0.0
                    while at >= 0:
                        so_far += area[at, 1]
                        owner_tile[o], owner_row[o], owner_law[o] = node[at, 0], node[at, 1], node[at, 2]
                        at = node[at, 3]
                        owner_share[o] = 255 if at < 0 or total <= 0.0 else int(255.0 * so_far / total)
                        o += 1
                    record[n] = flags[i, j, k] | _code(area0) | _code(area1) << np.uint32(7) | _code(area2) << np.uint32(14)
                    n += 1
    return mask, first, record, first_owner, owner_tile, owner_row, owner_law, owner_share


@numba.njit(cache=True, nogil=True)
def _code(area_m2: float) -> np.uint32:
    """Code of the projected area of a voxel; what is there at all has at least 1."""
    if area_m2 <= 0.0:
        return np.uint32(0)
    code = round(_TAU_CODES * math.sqrt(area_m2 / (VOXEL_M**3 * _TAU_MAX_PER_M)))
    return np.uint32(min(max(code, 1), _TAU_CODES))
