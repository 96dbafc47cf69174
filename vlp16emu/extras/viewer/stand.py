"""The stand along the path, simplified for a browser.

Few faces per object, instances of repeated shapes, and colours so pale that the points of a sweep stand out.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import groupby
from types import UnionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vlp16emu.extras.colours import Rgb, colour_of_kind, surface_colours
from vlp16emu.extras.survey import Survey
from vlp16emu.extras.viewer.simplify import clumps, fewer_faces, joined, lump, slim_stem, triangles
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.plants.foliage import IvyKey
from vlp16emu.forest.plants.prototypes import SaplingKey
from vlp16emu.forest.stand.floor_shapes import FloorKey, is_ground
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.tiles import TILE_M, TileKey
from vlp16emu.types import F8, U1, Mesh, PlantPart, ShapeKey

_CLUMPS = 14_000
"""Approximate number of clumps of foliage of all plants that are not near: crowns look like crowns, and a
browser without a graphics card draws an image every second or two."""
_MOST_CLUMPS = 400  # of a plant
_BANDS_M = 14.0, 22.0
_BAND_CLUMPS = 4.0, 2.0, 0.4
"""Distances from the path from which on plants have fewer clumps, and relative numbers of clumps before,
between and after them: clumps near the camera are small."""
_LEAF_FACES = 140_000  # approximate number of triangles of the leaves and branches of all near plants
_FEWEST_FACES = 12  # least number of faces of one mesh of an object; more in proportion to its size
_MOST_FACES = 3_000
_NEAR_M = 10.0
"""Plants up to this distance from the path have leaves and branches, those beyond have clumps. The path
counts from the first place of the camera on."""
BEHIND_M = 6.0  # first place of the camera, seen from the sensor
_COVER_M = 6.0
"""Ground cover is complete up to this distance, and thins out with its square beyond."""
_BRANCH_SHARE = 0.25  # faces of branches as a share of the faces of leaves, which largely hide them
_GOLDEN = 0.618034
_CELL_M = 1.0  # cell of the ground mesh
_PALE = 0.35  # share of white in the colours of the stand
_EDGE_SHARE = 0.35  # share of the radius over which the stand fades into the white of the page
_FADES = 10  # steps of that
_MOST_FADED = 0.9  # share of the colour that is lost at the edge
_LEFT_OUT = PlantPart.BRANCH_HIGHER_ORDER, PlantPart.DEAD_BRANCH
"""Parts that are too fine to be visible among leaves."""
_UPRIGHT = PlantPart.ROOT_FLARE, PlantPart.STEM
_AT_ORIGIN = np.eye(3, 4)[None]
_NO_FACES = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))


class _Placements(NamedTuple):
    """Placements of the window that are drawn."""

    row: NDArray[np.intp]  # (n,) of the window
    gap_m: F8  # (n,) distance from the path, or from the first place of the camera
    size_m: F8  # (n,) greatest extent, 0 for a tile

    def select(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> "_Placements":
        """Return some of the placements."""
        return _Placements(self.row[chosen], self.gap_m[chosen], self.size_m[chosen])

    @property
    def is_near(self) -> NDArray[np.bool_]:
        """Mask (n,) of those with leaves and branches."""
        return self.gap_m <= _NEAR_M

    @property
    def band(self) -> NDArray[np.intp]:
        """Number (n,) of the band of distance of each, from 0."""
        return np.searchsorted(_BANDS_M, self.gap_m)


class _Budget(NamedTuple):
    """Numbers per metre of a plant's size."""

    clumps_per_m: float  # if far, times the number of its band in `_BAND_CLUMPS`
    faces_per_m: float  # of leaves, if near


def pieces_of(stand: Survey) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the ground, the plants and the objects within the radius of a survey, by name.

    Each is a mesh with its instances and their colours, as the arguments of viser's
    `add_batched_meshes_simple`.
    """
    path = Polyline(stand.path_m[:, :2])
    if stand.hall is None:
        rgb = np.array(colour_of_kind("ground"), np.uint8)
        for number, (gap_m, mesh) in enumerate(_ground(stand, path)):
            yield _batch(f"ground/{number}", mesh, _pale(rgb, gap_m, stand), _AT_ORIGIN)
    window = stand.window
    colours = surface_colours(window.surfaces, stand.species)
    meshes_of = cache(partial(_meshes, stand))  # they are needed twice, and take seconds to grow
    chosen = _choose_placements(stand, path, meshes_of)
    budget = _budget(stand, chosen)
    single = defaultdict[Rgb, list[Mesh]](list)
    shapes: list[int] = window.shape[chosen.row].tolist()
    order: list[int] = np.argsort(shapes, kind="stable").tolist()
    for shape, members in groupby(order, key=shapes.__getitem__):
        group = chosen.select(np.array(list(members)))
        first = int(window.first_surface[group.row[0]])
        key = window.shapes[shape]
        meshes = meshes_of(key)
        parts = list(map(PlantPart, window.surfaces["part"][first : first + len(meshes)]))
        is_bare = not any(
            len(mesh.faces) for mesh, part in zip(meshes, parts, strict=True) if part is PlantPart.LEAF
        )
        for number, (mesh, part) in enumerate(zip(meshes, parts, strict=True)):
            if part in _LEFT_OUT or not len(mesh.faces):
                continue
            if isinstance(key, TileKey | IvyKey):  # its place is the tile's
                foot_m = mesh.vertices_m[mesh.vertices_m[:, 2].argmin(), :2]
                gap_m = path.distance_m(window.world_T_shape[group.row, :2, 3] + foot_m)
                if gap_m[0] > stand.radius_m:
                    continue
                group = group._replace(gap_m=gap_m)
            for detail, (simple_mesh, drawn) in enumerate(
                _simplify(mesh, key, part, group, budget, is_bare=is_bare)
            ):
                world_T_shape = window.world_T_shape[drawn.row]
                rgb = _pale(colours[first + number], drawn.gap_m, stand)
                if len(drawn.row) == 1:
                    vertices_m = simple_mesh.vertices_m @ world_T_shape[0, :, :3].T + world_T_shape[0, :, 3]
                    red, green, blue = rgb[0].tolist()
                    single[red, green, blue].append(
                        Mesh(vertices_m.astype(np.float32), triangles(simple_mesh))
                    )
                elif len(drawn.row):
                    yield _batch(f"things/{shape}_{number}_{detail}", simple_mesh, rgb, world_T_shape)
    for count, (colour, alike) in enumerate(single.items()):
        yield _batch(f"single/{count}", joined(alike), np.array([colour], np.uint8), _AT_ORIGIN)


def _meshes(stand: Survey, key: ShapeKey) -> tuple[Mesh, ...]:
    """Return the meshes of a shape; of a tile with none in place of the ground, which `_ground` draws."""
    if isinstance(key, TileKey) and isinstance(stand.bare, ForestWorld):
        return (_NO_FACES, *stand.bare.stems(key))
    return stand.world.shape(key)


def _choose_placements(
    stand: Survey, path: Polyline, meshes_of: Callable[[ShapeKey], tuple[Mesh, ...]]
) -> _Placements:
    """Return the placements that are drawn.

    The stems of a tile are drawn apart. Moss and litter are ground, and not drawn: of few faces they would be
    folded sheets on it.
    """
    window = stand.window
    is_tile = _is_kind(stand, TileKey | IvyKey)
    # A tile's place is its corner; its stems are drawn if one of them may be near.
    xy_m = window.world_T_shape[:, :2, 3] + np.where(is_tile, TILE_M / 2, 0.0)[:, None]
    gap_m = path.distance_m(xy_m)
    radius_m = np.where(is_tile, stand.radius_m + TILE_M / 2, np.inf if stand.hall else stand.radius_m)
    dense = np.square(_COVER_M / np.maximum(gap_m, _COVER_M))
    is_chosen = ~_is_kind(stand, FloorKey) | (np.arange(len(gap_m)) * _GOLDEN % 1.0 < dense)
    moss = [isinstance(key, FloorKey) and is_ground(key.kind) for key in window.shapes]
    is_chosen &= ~np.array(moss, np.bool_)[window.shape]
    near = np.flatnonzero((gap_m <= radius_m) & is_chosen)
    size_m = np.zeros(len(near))
    for shape in np.unique(window.shape[near]).tolist():
        if not isinstance(window.shapes[shape], TileKey):
            is_alike = window.shape[near] == shape
            scale = np.linalg.norm(window.world_T_shape[near[is_alike], :, :3], axis=1).mean(axis=1)
            meshes = (mesh for mesh in meshes_of(window.shapes[shape]) if len(mesh.faces))
            extents_m = (float(np.ptp(mesh.vertices_m, axis=0).max()) for mesh in meshes)
            size_m[is_alike] = scale * max(extents_m, default=0.0)
    seen_m = Polyline(_with_camera(stand.path_m[:, :2])).distance_m(xy_m[near])
    return _Placements(near, seen_m, size_m)


def _with_camera(path_xy_m: F8) -> F8:
    """Return a path (n, 2) with the first place of the camera, straight behind, before it."""
    ahead_m = path_xy_m - path_xy_m[0]
    away_m = np.hypot(*ahead_m.T)
    if not away_m.any():
        return path_xy_m
    first = int(np.argmax(away_m > 0.0))
    camera_m = path_xy_m[0] - BEHIND_M * ahead_m[first] / away_m[first]
    return np.vstack([camera_m, path_xy_m])


def _is_kind(stand: Survey, kind: type | UnionType) -> NDArray[np.bool_]:
    """Return a mask of all placements whose shape has a key of this kind."""
    return np.array([isinstance(key, kind) for key in stand.window.shapes], np.bool_)[stand.window.shape]


def _budget(stand: Survey, chosen: _Placements) -> _Budget:
    is_plant = ~_is_kind(stand, FloorKey)[chosen.row]
    far = chosen.select(is_plant & ~chosen.is_near)
    far_m = far.size_m * np.array(_BAND_CLUMPS)[far.band]
    near_m = chosen.size_m[chosen.is_near]
    return _Budget(_CLUMPS / max(float(far_m.sum()), 1.0), _LEAF_FACES / max(float(near_m.sum()), 1.0))


def _pale(rgb: U1, gap_m: F8, stand: Survey) -> U1:
    """Return colours (n, 3) of things of one colour (3,) at distances (n,) from the path.

    Towards the edge of a forest they fade into the white of the page, in few steps.
    """
    share = np.zeros(len(gap_m)) if stand.hall else gap_m / stand.radius_m
    fade = np.clip((share - 1.0 + _EDGE_SHARE) / _EDGE_SHARE, 0.0, 1.0)
    ink = (1.0 - _PALE) * (1.0 - _MOST_FADED * np.rint(fade * _FADES) / _FADES)
    return np.rint(255.0 - ink[:, None] * (255.0 - rgb)).astype(np.uint8)


def _simplify(
    mesh: Mesh, key: ShapeKey, part: PlantPart, group: _Placements, budget: _Budget, *, is_bare: bool
) -> list[tuple[Mesh, _Placements]]:
    """Return a mesh with fewer faces, as befits its part, and where it is drawn.

    Foliage is leaves on branches near the path, and clumps beyond. A plant `is_bare` without leaves.
    """
    near = group.select(group.is_near)
    size_m = float(group.size_m.mean())
    limit = int(np.clip(budget.faces_per_m * size_m, _FEWEST_FACES, _MOST_FACES))
    if part in _UPRIGHT and isinstance(key, TileKey | SaplingKey):
        return [(slim_stem(mesh, is_flare=part is PlantPart.ROOT_FLARE), group)]
    if part is PlantPart.LEAF:
        quads = mesh.faces.shape[1] == 4  # a quad is two triangles
        leaves = fewer_faces(mesh, limit // 2 if quads else limit, keeps_area=True)
        far = group.select(~group.is_near)
        if isinstance(key, FloorKey):
            return [(clumps(mesh, 1), far), (leaves, near)]
        simplified = [(leaves, near)]
        for band, share in enumerate(_BAND_CLUMPS):
            count = int(np.clip(share * budget.clumps_per_m * size_m, 1, _MOST_CLUMPS))
            if (in_band := far.band == band).any():
                simplified.append((clumps(mesh, count), far.select(in_band)))
        return simplified
    if part is PlantPart.NONE and isinstance(key, FloorKey):
        return [(lump(mesh), group)]
    if part is PlantPart.NONE:
        few = mesh if len(mesh.faces) <= _MOST_FACES else fewer_faces(mesh, _MOST_FACES, keeps_area=False)
        return [(few, group)]
    few = fewer_faces(mesh, max(int(_BRANCH_SHARE * limit), _FEWEST_FACES), keeps_area=False)
    is_hidden = part is PlantPart.BRANCH_FIRST_ORDER and not is_bare  # in clumps
    return [(few, near if is_hidden else group)]


def _ground(stand: Survey, path: Polyline) -> Iterator[tuple[F8, Mesh]]:
    """Yield the ground within the radius of a survey in square cells, by distance from the path.

    The distance (1,) is that of the middle of the cells.
    """
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
    places_m = np.column_stack([x_m, y_m, z_m]).astype(np.float32)
    gap_m = path.distance_m(places_m[quads].mean(axis=1, dtype=np.float64)[:, :2])
    inner = np.floor((1.0 - _EDGE_SHARE) / _EDGE_SHARE * _FADES)  # the last band that does not fade
    band = np.maximum(np.rint(gap_m / stand.radius_m / _EDGE_SHARE * _FADES), inner)
    for number in np.unique(band):
        used, faces = np.unique(quads[band == number], return_inverse=True)
        middle_m = np.array([number * stand.radius_m * _EDGE_SHARE / _FADES])
        yield middle_m, Mesh(places_m[used], faces.reshape(-1, 4).astype(np.uint32))


def _batch(name: str, mesh: Mesh, rgb: U1, world_T_shape: F8) -> tuple[str, dict[str, Any]]:
    """Return a mesh with its placements (n, 3, 4) and colours (n, 3).

    The shear of placements, which viser does not know, is left out.
    """
    scale = np.linalg.norm(world_T_shape[:, :, :3], axis=1)
    turn = Rotation.from_matrix(world_T_shape[:, :, :3] / scale[:, None, :])
    return name, {
        "vertices": mesh.vertices_m,
        "faces": triangles(mesh),
        "batched_wxyzs": turn.as_quat(scalar_first=True),
        "batched_positions": world_T_shape[:, :, 3],
        "batched_scales": scale,
        "batched_colors": rgb,
    }
