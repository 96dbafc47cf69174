"""Things near a path, and a piece cut out of the world."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec, norm
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.plants.prototypes import SaplingKey
from vlp16emu.forest.stand.floor_shapes import GROUND_KINDS, FloorKey
from vlp16emu.forest.stand.inventory import hull_m
from vlp16emu.forest.tiles import TILE_M, TileKey
from vlp16emu.types import Array, Mesh, Semantic, ShapeKey, Window

Grow = Callable[[ShapeKey], tuple[Mesh, ...]]


@dataclass(frozen=True, slots=True)
class AllNear:
    """World of one window without a far medium."""

    inside: Window
    shape: Grow
    near_m: float = math.inf
    seed: int = 0

    def window(self, _track_m: Array) -> Window:
        """Return the window for any track."""
        return self.inside

    def shape_name(self, _key: ShapeKey) -> str:
        """Return no name: no shape is kept on disk."""
        return ""


@dataclass(frozen=True, slots=True)
class Thing:
    """A thing that stands or lies there and is no tree of the stand."""

    placement: int  # in the window
    instance: int
    species: int
    kind: str
    """`sapling`, or of what lies or is low the `FloorKind`; of anything else its semantic class in small letters."""
    place_m: Array  # (3,) origin of its shape in the world
    outline_m: Array  # (k, 2) convex outline seen from above, counter-clockwise, in the world
    size_m: tuple[float, float, float]
    """Along the axes of its own shape: of stones length, width and height; of logs length and mean diameter; of
    stumps the diameter at the top and the height; of anything else its extent."""


def things_near(
    window: Window, shape: Grow, *, trees: NDArray[np.uint32], path: Polyline, radius_m: float
) -> list[Thing]:
    """Things whose place is within a radius of a path, in the order of the window; instances of `trees` (n,) are none."""
    grounds = (
        isinstance(key, TileKey) or (isinstance(key, FloorKey) and key.kind in GROUND_KINDS) for key in window.shapes
    )
    is_thing = ~np.fromiter(grounds, np.bool_)[window.shape]
    no_tree = ~np.isin(window.surfaces["instance"][window.first_surface], trees)
    near = path.distance_m(window.world_T_shape[:, :2, 3]) <= radius_m
    # What spans the convex hull of a shape is all that outlines need, in any placement.
    corners = cache(lambda key: hull_m(np.concatenate([mesh.vertices_m for mesh in shape(key)]).astype(np.float64)))
    found = np.flatnonzero(is_thing & no_tree & near).tolist()
    return [_thing(window, i, corners(window.shapes[window.shape[i]])) for i in found]


def cut_out(
    window: Window, shape: Grow, *, instances: NDArray[np.uint32], inside: Callable[[Array], NDArray[np.bool_]]
) -> tuple[Window, Grow]:
    """Leave of a window the ground of a place, which points (n, 2) lie inside, and some instances (n,) whole.

    Returns a window of the same surfaces, and how its shapes grow: in tiles, meshes of other instances are left empty.
    """
    wanted = np.isin(window.surfaces["instance"], instances)
    keep, tile_at = _kept(window, wanted, inside)
    used, which = np.unique(window.shape[keep], return_inverse=True)
    shapes, first = tuple(window.shapes[i] for i in used), window.first_surface[keep]
    world_T_shape = window.world_T_shape[keep]
    left = Window(window.origin_m, shapes, which.astype(np.int32), world_T_shape, first, window.surfaces)

    def grow(key: ShapeKey) -> tuple[Mesh, ...]:
        if not isinstance(key, TileKey):
            return shape(key)
        (ground, *stems), place = shape(key), tile_at[key]
        corner_m, row = window.world_T_shape[place, :2, 3], int(window.first_surface[place]) + 1
        middles_m = ground.vertices_m[ground.faces].mean(axis=1)[:, :2] + corner_m
        stays = wanted[row : row + len(stems)].tolist()
        paired = zip(stems, stays, strict=True)
        cut = (mesh if whole else Mesh(mesh.vertices_m, mesh.faces[:0]) for mesh, whole in paired)
        corners, faces = np.unique(ground.faces[inside(middles_m)], return_inverse=True)
        return Mesh(ground.vertices_m[corners], faces.reshape(-1, 3).astype(np.uint32)), *cut

    return left, grow


def _kept(
    window: Window, wanted: NDArray[np.bool_], inside: Callable[[Array], NDArray[np.bool_]]
) -> tuple[NDArray[np.bool_], dict[TileKey, int]]:
    """Return a mask (n,) of placements that show a wanted surface or ground of the place, and the placement of each tile."""
    keys = (window.shapes[which] for which in window.shape)
    tile_at = {key: i for i, key in enumerate(keys) if isinstance(key, TileKey)}
    keep = wanted[window.first_surface]
    starts = np.append(np.sort(window.first_surface), len(wanted))
    for key, i in tile_at.items():
        first = window.first_surface[i]
        end = starts[np.searchsorted(starts, first, side="right")]
        # Points a metre apart miss no more of the place than a corner of it.
        x_m, y_m = np.meshgrid(*(TILE_M * n + np.arange(TILE_M + 1) for n in (key.ix, key.iy)))
        keep[i] = wanted[first:end].any() or inside(np.column_stack([x_m.ravel(), y_m.ravel()])).any()
    return keep, tile_at


def _thing(window: Window, placement: int, corners_m: Array) -> Thing:
    key = window.shapes[window.shape[placement]]
    row = window.surfaces[window.first_surface[placement]]
    world_T_shape = window.world_T_shape[placement]
    seen_m = (matvec(world_T_shape[:, :3], corners_m) + world_T_shape[:, 3])[:, :2]
    # Shapes of the floor have unit size by what they are, not by their outermost corner.
    unit_m = np.ones(3) if isinstance(key, FloorKey) else np.ptp(corners_m, axis=0)
    size_m = unit_m * norm(world_T_shape[:, :3].T)
    kind = key.kind.value if isinstance(key, FloorKey) else Semantic(row["semantic"]).name.lower()
    kind = "sapling" if isinstance(key, SaplingKey) else kind
    numbers, place_m = (int(row["instance"]), int(row["species"])), world_T_shape[:, 3].copy()
    return Thing(placement, *numbers, kind, place_m, hull_m(seen_m), tuple(size_m.tolist()))
