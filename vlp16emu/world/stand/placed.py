"""Things that a tile holds many times: the same few shapes, placed again and again."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, generator
from vlp16emu.types import SURFACE, HeightField, ShapeKey
from vlp16emu.world.polyline import Corridor
from vlp16emu.world.stand.points import PointPattern
from vlp16emu.world.stand.stand import TREE
from vlp16emu.world.stand.tiles import tile_distance_m

__all__ = [
    "NO_TREES",
    "Layer",
    "PlacedThings",
    "Site",
    "between",
    "distinct",
    "laid",
    "placements",
    "surface_rows",
    "turned",
]

Array = NDArray[np.float64]

NO_TREES = np.zeros(0, TREE)
"""Trees of a layer that has none."""


@dataclass(frozen=True, slots=True)
class PlacedThings:
    """Things of one kind on one tile."""

    keys: tuple[ShapeKey, ...]
    """Different shapes, each once."""
    shape: NDArray[np.int64]
    """(n,) index into `keys`."""
    world_T_shape: Array
    """(n, 3, 4)."""
    surfaces: NDArray[np.void]
    """(n, parts) `SURFACE`, of each thing's meshes in order; instance still 0."""
    trees: NDArray[np.void]
    """(n,) `TREE` with id still 0 where the things are trees, else (0,)."""
    is_ground: bool = False
    """As of their layer."""


@dataclass(frozen=True, slots=True)
class Site:
    """A tile, and what keeps plants and things off it."""

    seed: int
    ix: int
    iy: int
    height_m: HeightField
    """Ground."""
    path: Corridor
    trunks: Array
    """(m, 3) x, y and radius at the ground of all stems on the tile and its neighbours."""

    @property
    def distance_m(self) -> float:
        """Of the tile from the path, or less."""
        return tile_distance_m((self.ix, self.iy), self.path)

    def draw(self, purpose: Purpose) -> np.random.Generator:
        """Make the generator for the sizes of things; their places are drawn by a pattern."""
        return generator(self.seed, purpose, self.ix, self.iy, 1)

    def clear(self, xy_m: Array, reach_m: Array, foot_m: Array) -> NDArray[np.bool_]:
        """Which points (n, 2) keep `reach_m` (n,) away from the path, and `foot_m` (n,) from all trunks."""
        free = np.asarray(self.path.distance_m(xy_m) - reach_m >= self.path.clearance_m)
        dx, dy = (xy_m[:, None, axis] - self.trunks[:, axis] for axis in (0, 1))
        gap_m = foot_m[:, None] + self.trunks[:, 2]
        blocked = np.asarray((dx * dx + dy * dy < gap_m * gap_m).any(axis=1))
        return np.logical_and(free, ~blocked)


class Layer(Protocol):
    """One kind of thing that grows or lies on the ground."""

    @property
    def pattern(self) -> PointPattern:
        """Their places, before those on the path and in trunks are left out."""

    @property
    def is_ground(self) -> bool:
        """Whether they are part of the ground: without numbers, and too low to be seen from afar."""

    def place(self, site: Site) -> PlacedThings:
        """Things of a tile, a function of the site alone."""


def between(limits: tuple[float, float], draw: Array) -> Array:
    """Evenly from limits[0] to limits[1]."""
    value: Array = limits[0] + (limits[1] - limits[0]) * draw
    return value


def distinct(keys: Sequence[ShapeKey]) -> tuple[tuple[ShapeKey, ...], NDArray[np.int64]]:
    """Split keys into the different ones, each once, and the index of each into them."""
    index_of = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    return tuple(index_of), np.array([index_of[key] for key in keys], np.int64)


def placements(place_m: Array, world_R_thing: Array, size: Array) -> Array:
    """`world_T_shape` (n, 3, 4) from places (n, 3), rotations (n, 3, 3) and scales along the axes (n, 3)."""
    return np.concatenate([world_R_thing * size[:, None, :], place_m[:, :, None]], axis=2)


def surface_rows(
    *, parts: Sequence[int], semantic: int, material: NDArray[np.int64], reflectance: Array, species: Array
) -> NDArray[np.void]:
    """`SURFACE` rows (n, parts) from materials and reflectances (n, parts) and species numbers (n,)."""
    rows = np.zeros(reflectance.shape, SURFACE)
    rows["semantic"], rows["part"] = semantic, np.array(parts)
    rows["material"], rows["reflectance"] = material, reflectance
    rows["species"] = species[:, None]
    return rows


def turned(azimuth_deg: Array) -> Array:
    """Rotations (n, 3, 3) about the vertical, counter-clockwise."""
    return laid(np.radians(azimuth_deg), np.zeros(len(azimuth_deg)))


def laid(towards: Array, slope: Array) -> Array:
    """Rotations (n, 3, 3) that lay the x axis towards an angle from east, rad, on a slope dz/ds; y stays level."""
    flat = 1 / np.hypot(1, slope)
    c, s, zero = np.cos(towards), np.sin(towards), np.zeros(len(towards))
    along = np.stack([c * flat, s * flat, slope * flat], axis=-1)
    across = np.stack([-s, c, zero], axis=-1)
    return np.stack([along, across, np.cross(along, across)], axis=-1)
