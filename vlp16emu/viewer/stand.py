"""What stands along the path as a browser can draw it: few faces for each thing, and what is there often only once."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vlp16emu.report.forest import colour_of_kind, surface_colours
from vlp16emu.report.forest.survey import Survey
from vlp16emu.types import Mesh, PlantPart
from vlp16emu.world.polyline import Polyline
from vlp16emu.world.stand.tiles import TILE_M, TileKey

__all__ = ["Piece", "fewer_faces", "pieces_of"]

Array = NDArray[np.float64]
Rgb = tuple[int, int, int]

_FACES = 600_000
"""Triangles of all plants and things together, about."""
_FEWEST, _MOST = 60, 3_000
"""Faces of one mesh of one thing."""
_CELL_M = 1.0
"""Of the ground."""
_LEFT_OUT = PlantPart.ROOT_FLARE, PlantPart.BRANCH_HIGHER_ORDER, PlantPart.DEAD_BRANCH
"""Too fine to be seen among leaves."""
_ONE = np.eye(3, 4)[None]


@dataclass(frozen=True, slots=True)
class Piece:
    """A mesh of one colour, at one place or at many."""

    name: str
    vertices_m: NDArray[np.float32]
    faces: NDArray[np.uint32]
    """(f, 3) triangles."""
    colour: Rgb
    position_m: Array
    """(n, 3) in the world."""
    wxyz: Array
    """(n, 4) unit quaternions."""
    scale: Array
    """(n, 3) along the axes of the mesh."""


def pieces_of(seen: Survey) -> Iterator[Piece]:
    """Draw the ground, the plants and the things within the radius of a survey."""
    if seen.hall is None:
        yield _piece("ground", _ground(seen), colour_of_kind("ground"), _ONE)
    window, path = seen.window, Polyline(seen.path_m[:, :2])
    colours = surface_colours(window.surfaces, seen.species)
    is_tile = np.array([isinstance(key, TileKey) for key in window.shapes], np.bool_)[window.shape]
    # A tile's place is its corner; its stems are drawn where one of them may be near.
    middle_m = window.world_T_shape[:, :2, 3] + np.where(is_tile, TILE_M / 2, 0.0)[:, None]
    radius_m = np.where(is_tile, seen.radius_m + TILE_M / 2, np.inf if seen.hall else seen.radius_m)
    near = np.flatnonzero(path.distance_m(middle_m) <= radius_m)
    most = int(np.clip(_FACES / max(len(near), 1), _FEWEST, _MOST))
    single = defaultdict[Rgb, list[Mesh]](list)
    order = near[np.argsort(window.shape[near], kind="stable")]
    for which, group in groupby(order.tolist(), key=lambda placement: int(window.shape[placement])):
        alike = np.array(list(group))
        rows = window.first_surface[alike]
        for number, mesh in enumerate(seen.grow(window.shapes[which])):
            row = int(rows[0]) + number
            part = PlantPart(window.surfaces["part"][row])
            is_ground = isinstance(window.shapes[which], TileKey) and number == 0
            if is_ground or part in _LEFT_OUT or not len(mesh.faces):
                continue
            few = mesh if part is PlantPart.STEM else fewer_faces(mesh, most, grown=part is PlantPart.LEAF)
            world_T, red_green_blue = window.world_T_shape[alike], tuple(colours[row].tolist())
            if len(alike) == 1:
                single[red_green_blue].append(_moved(few, world_T[0]))
            else:
                yield _piece(f"things/{which}_{number}", few, red_green_blue, world_T)
    for count, (colour, meshes) in enumerate(single.items()):
        yield _piece(f"single/{count}", _joined(meshes), colour, _ONE)


def fewer_faces(mesh: Mesh, most: int, *, grown: bool) -> Mesh:
    """Leave as many faces of a mesh as are wanted: of leaves any, `grown` so that their area stays; of others the largest.

    R. L. Cook et al., "Stochastic simplification of aggregate detail", SIGGRAPH 2007.
    """
    corners_m = mesh.vertices_m[mesh.faces]
    n = len(corners_m)
    if n <= most:
        return mesh
    if grown:
        kept = corners_m[np.linspace(0, n - 1, most).astype(np.int64)]
        middle_m = kept.mean(axis=1, keepdims=True)
        kept = middle_m + np.sqrt(n / most) * (kept - middle_m)
    else:
        sides_m = corners_m[:, 1:3] - corners_m[:, :1]
        area_m2 = np.linalg.norm(np.cross(sides_m[:, 0], sides_m[:, 1]), axis=1)
        kept = corners_m[np.argpartition(area_m2, n - most)[n - most :]]
    faces = np.arange(kept.shape[0] * kept.shape[1], dtype=np.uint32).reshape(kept.shape[:2])
    return Mesh(kept.reshape(-1, 3).astype(np.float32), faces)


def _ground(seen: Survey) -> Mesh:
    """Ground within the radius, in squares."""
    low = np.floor(seen.path_m[:, :2].min(axis=0) - seen.radius_m)
    high = np.ceil(seen.path_m[:, :2].max(axis=0) + seen.radius_m)
    x_m, y_m = (np.arange(a, b + _CELL_M, _CELL_M) for a, b in zip(low, high, strict=True))
    x, y = (grid.ravel() for grid in np.meshgrid(x_m, y_m, indexing="ij"))
    inside = seen.inside(np.column_stack([x, y]))
    z = np.zeros_like(x)
    z[inside] = seen.height_m(x[inside], y[inside])
    corner = np.arange(len(x)).reshape(len(x_m), len(y_m))
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1)
    quads = quads.reshape(-1, 4)
    quads = quads[inside[quads].all(axis=1)]
    used, faces = np.unique(quads, return_inverse=True)
    vertices_m = np.column_stack([x, y, z])[used].astype(np.float32)
    return Mesh(vertices_m, faces.reshape(-1, 4).astype(np.uint32))


def _moved(mesh: Mesh, world_T_shape: Array) -> Mesh:
    """Put a mesh into the world."""
    vertices_m = mesh.vertices_m @ world_T_shape[:, :3].T + world_T_shape[:, 3]
    return Mesh(vertices_m.astype(np.float32), mesh.faces)


def _joined(meshes: list[Mesh]) -> Mesh:
    """Make one mesh of triangles of several."""
    first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    faces = [_triangles(mesh) + np.uint32(begin) for mesh, begin in zip(meshes, first, strict=False)]
    return Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces))


def _triangles(mesh: Mesh) -> NDArray[np.uint32]:
    """Cut quads (a, b, c, d) into (a, b, d) and (c, d, b), as casters do."""
    faces = mesh.faces
    return faces if faces.shape[1] == 3 else np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])


def _piece(name: str, mesh: Mesh, colour: tuple[int, ...], world_T_shape: Array) -> Piece:
    """Place a mesh; a shear, which a browser's instances do not have, is left out."""
    scale = np.linalg.norm(world_T_shape[:, :, :3], axis=1)
    turn = Rotation.from_matrix(world_T_shape[:, :, :3] / scale[:, None, :])
    red, green, blue = colour
    wxyz = turn.as_quat(scalar_first=True)
    return Piece(
        name, mesh.vertices_m, _triangles(mesh), (red, green, blue), world_T_shape[:, :, 3], wxyz, scale
    )
