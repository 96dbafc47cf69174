"""The stand along the path, simplified for a browser.

Few faces per object, and instances of repeated shapes.
"""

from collections import defaultdict
from collections.abc import Iterator
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vlp16emu.extras.colours import Rgb, colour_of_kind, surface_colours
from vlp16emu.extras.survey import Survey
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.plants.prototypes import SaplingKey
from vlp16emu.forest.stand.floor_shapes import FloorKey
from vlp16emu.forest.tiles import TILE_M, TileKey
from vlp16emu.types import F8, I8, U4, Mesh, PlantPart, ShapeKey

_FACES = 300_000
"""Approximate number of triangles of all plants and objects without stems: crowns look like crowns, and a
browser without a graphics card draws an image every second or two."""
# faces of one mesh of one object; between these limits in proportion to its size
_FEWEST = 6
_MOST = 3_000
_MOST_GROWN = 3.5
"""Greatest enlargement of a leaf in length: larger leaves look wrong, so a crown that needs them is drawn
less dense."""
_BRANCHES = 0.25  # faces of branches as a share of the faces of leaves, which largely hide them
_SIDES = 6  # sides and rings of a stem
_RINGS = 7
_DENSE_M = 6.0
"""Ground cover is complete up to this distance from the path; beyond it thins out with the square of the
distance."""
_GOLDEN = 0.618034
_CELL_M = 1.0  # cell of the ground mesh
_LEFT_OUT = PlantPart.ROOT_FLARE, PlantPart.BRANCH_HIGHER_ORDER, PlantPart.DEAD_BRANCH
"""Parts that are too fine to be visible among leaves."""
_ONE = np.eye(3, 4)[None]
# Quadric decimation (fast-simplification 0.2) is no substitute: of the 219 016 faces of the stems of
# `birch_walk` it leaves 182 268 where `slim_stem` leaves 33 123, in ten times the time; of crowns, which are
# separate leaves, 8 % of the area.


def pieces_of(seen: Survey) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the ground, the plants and the objects within the radius of a survey, by name.

    Each is a mesh of one colour with its instances, as the arguments of viser's `add_batched_meshes_simple`.
    """
    if seen.hall is None:
        yield _piece("ground", _ground(seen), colour_of_kind("ground"), _ONE)
    window = seen.window
    colours = surface_colours(seen.window.surfaces, seen.species)
    path = Polyline(seen.path_m[:, :2])
    near, size_m = _choose_placements(seen, path)
    per_m = _FACES / max(float(size_m.sum()), 1.0)
    single = defaultdict[Rgb, list[Mesh]](list)
    shapes: list[int] = window.shape[near].tolist()
    order: list[int] = np.argsort(shapes, kind="stable").tolist()
    for which, group in groupby(order, key=shapes.__getitem__):
        index = np.array(list(group))
        alike = near[index]
        key = window.shapes[which]
        most = int(np.clip(per_m * size_m[index].mean(), _FEWEST, _MOST))
        row = int(window.first_surface[alike[0]])
        for number, mesh in enumerate(seen.world.shape(key)):
            part = PlantPart(window.surfaces["part"][row + number])
            is_ground = isinstance(key, TileKey) and number == 0
            if is_ground or part in _LEFT_OUT or not len(mesh.faces):
                continue
            if isinstance(key, TileKey):
                foot_m = mesh.vertices_m[mesh.vertices_m[:, 2].argmin(), :2]
                if path.distance_m(window.world_T_shape[alike, :2, 3] + foot_m)[0] > seen.radius_m:
                    continue
            few = _simple(mesh, key, part, most)
            (red, green, blue) = colours[row + number].tolist()
            if len(alike) == 1:
                turn = window.world_T_shape[alike[0], :, :3]
                place_m = window.world_T_shape[alike[0], :, 3]
                single[red, green, blue].append(
                    Mesh((few.vertices_m @ turn.T + place_m).astype(np.float32), few.faces)
                )
            else:
                yield _piece(f"things/{which}_{number}", few, (red, green, blue), window.world_T_shape[alike])
    for count, (colour, meshes) in enumerate(single.items()):
        first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
        faces = [_triangles(mesh) + np.uint32(begin) for mesh, begin in zip(meshes, first, strict=False)]
        joined = Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces))
        yield _piece(f"single/{count}", joined, colour, _ONE)


def _choose_placements(seen: Survey, path: Polyline) -> tuple[NDArray[np.intp], F8]:
    """Return the placements (n,) that are drawn, and the size (n,) of each in metres.

    Tiles have 0, as their stems are drawn separately.
    """
    window = seen.window
    is_tile, is_floor = (
        np.array([isinstance(key, kind) for key in window.shapes], np.bool_)[window.shape]
        for kind in (TileKey, FloorKey)
    )
    # A tile's place is its corner; its stems are drawn if one of them may be near.
    gap_m = path.distance_m(window.world_T_shape[:, :2, 3] + np.where(is_tile, TILE_M / 2, 0.0)[:, None])
    radius_m = np.where(is_tile, seen.radius_m + TILE_M / 2, np.inf if seen.hall else seen.radius_m)
    dense = np.minimum(_DENSE_M / np.maximum(gap_m, _DENSE_M), 1.0) ** 2
    chosen = ~is_floor | (np.arange(len(gap_m)) * _GOLDEN % 1.0 < dense)
    near = np.flatnonzero((gap_m <= radius_m) & chosen)
    size_m = np.zeros(len(near))
    for which in np.unique(window.shape[near]).tolist():
        if not isinstance(window.shapes[which], TileKey):
            alike = window.shape[near] == which
            scale = np.linalg.norm(window.world_T_shape[near[alike], :, :3], axis=1).mean(axis=1)
            drawn = (mesh.vertices_m for mesh in seen.world.shape(window.shapes[which]) if len(mesh.faces))
            size_m[alike] = scale * max((float(np.ptp(of_m, axis=0).max()) for of_m in drawn), default=0.0)
    return near, size_m


def _simple(mesh: Mesh, key: ShapeKey, part: PlantPart, most: int) -> Mesh:
    if part is PlantPart.STEM and isinstance(key, TileKey | SaplingKey):
        return slim_stem(mesh)
    if part is PlantPart.LEAF:
        quads = mesh.faces.shape[1] == 4  # a quad is two triangles
        return fewer_faces(mesh, most // 2 if quads else most, grown=True)
    if part is PlantPart.NONE and isinstance(key, FloorKey):
        return lump(mesh)
    if part is PlantPart.NONE:
        return mesh if len(mesh.faces) <= _MOST else fewer_faces(mesh, _MOST, grown=False)
    return fewer_faces(mesh, max(int(_BRANCHES * most), _FEWEST), grown=False)


def slim_stem(mesh: Mesh) -> Mesh:
    """Simplify an upright stem to few sides and rings.

    A vertex moves to the vertex of its sector that is nearest to a ring's height.
    """
    place_m = mesh.vertices_m.astype(np.float64)
    along = (place_m[:, 2] - place_m[:, 2].min()) / max(float(np.ptp(place_m[:, 2])), 1e-6)
    axis_m = np.stack([np.polyval(np.polyfit(along, place_m[:, k], 3), along) for k in (0, 1)], axis=1)
    aside_m = place_m[:, :2] - axis_m
    ring = np.rint(along * (_RINGS - 1)).astype(np.int64)
    sector = (
        np.rint(np.arctan2(aside_m[:, 1], aside_m[:, 0]) * _SIDES / (2 * np.pi)).astype(np.int64) % _SIDES
    )
    return _merge_clusters(mesh, ring * _SIDES + sector, np.abs(along * (_RINGS - 1) - ring))


def lump(mesh: Mesh) -> Mesh:
    """Simplify a small solid object to the outermost vertex of each third of its box.

    J. Rossignac and P. Borrel, 1993.
    """
    low_m = mesh.vertices_m.min(axis=0)
    size_m = np.maximum(np.ptp(mesh.vertices_m, axis=0), 1e-6)
    place = (mesh.vertices_m - low_m) / size_m
    x, y, z = np.minimum(place * 3, 2).astype(np.int64).T
    return _merge_clusters(mesh, (x * 3 + y) * 3 + z, -np.linalg.norm(place - 0.5, axis=1))


def _merge_clusters(mesh: Mesh, cluster: I8, cost: NDArray[np.floating]) -> Mesh:
    """Move all vertices (n,) of a cluster to its vertex of least cost.

    Faces that then have no area are removed.
    """
    order = np.lexsort([cost, cluster])
    _, first, cluster_of = np.unique(cluster[order], return_index=True, return_inverse=True)
    at = np.empty(len(order), np.uint32)
    at[order] = cluster_of
    faces = at[_triangles(mesh)]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return Mesh(mesh.vertices_m[order[first]], faces[once])


def fewer_faces(mesh: Mesh, most: int, *, grown: bool) -> Mesh:
    """Keep `most` faces of a mesh.

    They are the largest, or with `grown` a sample that is enlarged to keep the total area.

    R. L. Cook et al., "Stochastic simplification of aggregate detail", SIGGRAPH 2007.
    """
    corners_m = mesh.vertices_m[mesh.faces]
    n = len(corners_m)
    if n <= most:
        return mesh
    if grown:
        kept = corners_m[np.linspace(0, n - 1, most).astype(np.int64)]
        middle_m = kept.mean(axis=1, keepdims=True)
        kept = middle_m + min(np.sqrt(n / most), _MOST_GROWN) * (kept - middle_m)
    else:
        sides_m = corners_m[:, 1:3] - corners_m[:, :1]
        area_m2 = np.linalg.norm(np.cross(sides_m[:, 0], sides_m[:, 1]), axis=1)
        kept = corners_m[np.argpartition(area_m2, n - most)[n - most :]]
    faces = np.arange(kept.shape[0] * kept.shape[1], dtype=np.uint32).reshape(kept.shape[:2])
    return Mesh(kept.reshape(-1, 3).astype(np.float32), faces)


def _ground(seen: Survey) -> Mesh:
    low, high = seen.bounds_m
    x_m, y_m = (np.arange(np.floor(a), np.ceil(b) + _CELL_M, _CELL_M) for a, b in zip(low, high, strict=True))
    x, y = (grid.ravel() for grid in np.meshgrid(x_m, y_m, indexing="ij"))
    inside = seen.inside(np.column_stack([x, y]))
    z = np.zeros_like(x)
    z[inside] = seen.bare.height_m(x[inside], y[inside])
    corner = np.arange(len(x)).reshape(len(x_m), len(y_m))
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1)
    quads = quads.reshape(-1, 4)
    quads = quads[inside[quads].all(axis=1)]
    used, faces = np.unique(quads, return_inverse=True)
    vertices_m = np.column_stack([x, y, z])[used].astype(np.float32)
    return Mesh(vertices_m, faces.reshape(-1, 4).astype(np.uint32))


def _triangles(mesh: Mesh) -> U4:
    """Return triangles; quads (a, b, c, d) become (a, b, d) and (c, d, b), as in the ray casters."""
    faces = mesh.faces
    return faces if faces.shape[1] == 3 else np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])


def _piece(name: str, mesh: Mesh, colour: Rgb, world_T_shape: F8) -> tuple[str, dict[str, Any]]:
    """Return a mesh with its placements (n, 3, 4), without shear.

    Instances in a browser cannot have any.
    """
    scale = np.linalg.norm(world_T_shape[:, :, :3], axis=1)
    turn = Rotation.from_matrix(world_T_shape[:, :, :3] / scale[:, None, :])
    return name, {
        "vertices": mesh.vertices_m,
        "faces": _triangles(mesh),
        "batched_wxyzs": turn.as_quat(scalar_first=True),
        "batched_positions": world_T_shape[:, :, 3],
        "batched_scales": scale,
        "batched_colors": colour,
    }
