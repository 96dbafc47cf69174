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
_FEWEST_FACES = 6  # least number of faces of one mesh of an object; more in proportion to its size
_MOST_FACES = 3_000
_GREATEST_SCALE = 3.5
"""Greatest enlargement of a leaf in length: larger leaves look wrong, so a crown that needs them is drawn
less dense."""
_BRANCH_SHARE = 0.25  # faces of branches as a share of the faces of leaves, which largely hide them
_SIDES = 6  # of a stem
_RINGS = 7  # of a stem
_DENSE_M = 6.0
"""Ground cover is complete up to this distance from the path; beyond it thins out with the square of the
distance."""
_GOLDEN = 0.618034
_CELL_M = 1.0  # cell of the ground mesh
_LEFT_OUT = PlantPart.ROOT_FLARE, PlantPart.BRANCH_HIGHER_ORDER, PlantPart.DEAD_BRANCH
"""Parts that are too fine to be visible among leaves."""
_AT_ORIGIN = np.eye(3, 4)[None]
# Quadric decimation (fast-simplification 0.2) is no substitute: of the 219 016 faces of the stems of
# `birch_walk` it leaves 182 268 where `slim_stem` leaves 33 123, in ten times the time; of crowns, which are
# separate leaves, 8 % of the area.


def pieces_of(stand: Survey) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the ground, the plants and the objects within the radius of a survey, by name.

    Each is a mesh of one colour with its instances, as the arguments of viser's `add_batched_meshes_simple`.
    """
    if stand.hall is None:
        yield _batch("ground", _ground(stand), colour_of_kind("ground"), _AT_ORIGIN)
    window = stand.window
    colours = surface_colours(stand.window.surfaces, stand.species)
    path = Polyline(stand.path_m[:, :2])
    near, size_m = _choose_placements(stand, path)
    faces_per_m = _FACES / max(float(size_m.sum()), 1.0)
    single = defaultdict[Rgb, list[Mesh]](list)
    shapes: list[int] = window.shape[near].tolist()
    order: list[int] = np.argsort(shapes, kind="stable").tolist()
    for shape, rows in groupby(order, key=shapes.__getitem__):
        members = np.array(list(rows))
        placements = near[members]
        key = window.shapes[shape]
        limit = int(np.clip(faces_per_m * size_m[members].mean(), _FEWEST_FACES, _MOST_FACES))
        row = int(window.first_surface[placements[0]])
        for number, mesh in enumerate(stand.world.shape(key)):
            part = PlantPart(window.surfaces["part"][row + number])
            is_ground = isinstance(key, TileKey) and number == 0
            if is_ground or part in _LEFT_OUT or not len(mesh.faces):
                continue
            if isinstance(key, TileKey):
                foot_m = mesh.vertices_m[mesh.vertices_m[:, 2].argmin(), :2]
                if path.distance_m(window.world_T_shape[placements, :2, 3] + foot_m)[0] > stand.radius_m:
                    continue
            simple_mesh = _simplify(mesh, key, part, limit)
            red, green, blue = colours[row + number].tolist()
            if len(placements) == 1:
                world_T = window.world_T_shape[placements[0]]
                vertices_m = simple_mesh.vertices_m @ world_T[:, :3].T + world_T[:, 3]
                single[red, green, blue].append(Mesh(vertices_m.astype(np.float32), simple_mesh.faces))
            else:
                yield _batch(
                    f"things/{shape}_{number}",
                    simple_mesh,
                    (red, green, blue),
                    window.world_T_shape[placements],
                )
    for count, (colour, meshes) in enumerate(single.items()):
        first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
        faces = [_triangles(mesh) + np.uint32(begin) for mesh, begin in zip(meshes, first, strict=False)]
        joined = Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces))
        yield _batch(f"single/{count}", joined, colour, _AT_ORIGIN)


def _choose_placements(stand: Survey, path: Polyline) -> tuple[NDArray[np.intp], F8]:
    """Return the placements (n,) that are drawn, and the size (n,) of each in metres, 0 for a tile.

    The stems of a tile are drawn apart.
    """
    window = stand.window
    is_tile, is_floor = (
        np.array([isinstance(key, kind) for key in window.shapes], np.bool_)[window.shape]
        for kind in (TileKey, FloorKey)
    )
    # A tile's place is its corner; its stems are drawn if one of them may be near.
    gap_m = path.distance_m(window.world_T_shape[:, :2, 3] + np.where(is_tile, TILE_M / 2, 0.0)[:, None])
    radius_m = np.where(is_tile, stand.radius_m + TILE_M / 2, np.inf if stand.hall else stand.radius_m)
    dense = np.minimum(_DENSE_M / np.maximum(gap_m, _DENSE_M), 1.0) ** 2
    is_chosen = ~is_floor | (np.arange(len(gap_m)) * _GOLDEN % 1.0 < dense)
    near = np.flatnonzero((gap_m <= radius_m) & is_chosen)
    size_m = np.zeros(len(near))
    for shape in np.unique(window.shape[near]).tolist():
        if not isinstance(window.shapes[shape], TileKey):
            is_alike = window.shape[near] == shape
            scale = np.linalg.norm(window.world_T_shape[near[is_alike], :, :3], axis=1).mean(axis=1)
            meshes = (mesh for mesh in stand.world.shape(window.shapes[shape]) if len(mesh.faces))
            extents_m = (float(np.ptp(mesh.vertices_m, axis=0).max()) for mesh in meshes)
            size_m[is_alike] = scale * max(extents_m, default=0.0)
    return near, size_m


def _simplify(mesh: Mesh, key: ShapeKey, part: PlantPart, limit: int) -> Mesh:
    """Return a mesh with fewer faces, some `limit` of them, as befits its part."""
    if part is PlantPart.STEM and isinstance(key, TileKey | SaplingKey):
        return slim_stem(mesh)
    if part is PlantPart.LEAF:
        quads = mesh.faces.shape[1] == 4  # a quad is two triangles
        return fewer_faces(mesh, limit // 2 if quads else limit, keeps_area=True)
    if part is PlantPart.NONE and isinstance(key, FloorKey):
        return lump(mesh)
    if part is PlantPart.NONE:
        return mesh if len(mesh.faces) <= _MOST_FACES else fewer_faces(mesh, _MOST_FACES, keeps_area=False)
    return fewer_faces(mesh, max(int(_BRANCH_SHARE * limit), _FEWEST_FACES), keeps_area=False)


def slim_stem(mesh: Mesh) -> Mesh:
    """Simplify an upright stem to few sides and rings.

    A vertex moves to the vertex of its sector that is nearest to a ring's height.
    """
    vertices_m = mesh.vertices_m.astype(np.float64)
    along = (vertices_m[:, 2] - vertices_m[:, 2].min()) / max(float(np.ptp(vertices_m[:, 2])), 1e-6)
    axis_m = np.stack(
        [np.polyval(np.polyfit(along, vertices_m[:, axis], 3), along) for axis in (0, 1)], axis=1
    )
    aside_m = vertices_m[:, :2] - axis_m
    ring = np.rint(along * (_RINGS - 1)).astype(np.int64)
    sector = (
        np.rint(np.arctan2(aside_m[:, 1], aside_m[:, 0]) * _SIDES / (2 * np.pi)).astype(np.int64) % _SIDES
    )
    return _merge_clusters(mesh, ring * _SIDES + sector, np.abs(along * (_RINGS - 1) - ring))


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
    faces = cluster_of_vertex[_triangles(mesh)]
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


def _ground(stand: Survey) -> Mesh:
    """Return the ground within the bounds of a survey, in square cells."""
    low, high = stand.bounds_m
    axes_m = [
        np.arange(np.floor(begin_m), np.ceil(end_m) + _CELL_M, _CELL_M)
        for begin_m, end_m in zip(low, high, strict=True)
    ]
    x_m, y_m = (grid.ravel() for grid in np.meshgrid(*axes_m, indexing="ij"))
    inside = stand.inside(np.column_stack([x_m, y_m]))
    z_m = np.zeros_like(x_m)
    z_m[inside] = stand.bare.height_m(x_m[inside], y_m[inside])
    corner = np.arange(len(x_m)).reshape(len(axes_m[0]), len(axes_m[1]))
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1)
    quads = quads.reshape(-1, 4)
    quads = quads[inside[quads].all(axis=1)]
    used, faces = np.unique(quads, return_inverse=True)
    vertices_m = np.column_stack([x_m, y_m, z_m])[used].astype(np.float32)
    return Mesh(vertices_m, faces.reshape(-1, 4).astype(np.uint32))


def _triangles(mesh: Mesh) -> U4:
    """Return triangles; quads (a, b, c, d) become (a, b, d) and (c, d, b), as in the ray casters."""
    faces = mesh.faces
    return faces if faces.shape[1] == 3 else np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])


def _batch(name: str, mesh: Mesh, colour: Rgb, world_T_shape: F8) -> tuple[str, dict[str, Any]]:
    """Return a mesh with its placements (n, 3, 4), without their shear, which viser does not know."""
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
