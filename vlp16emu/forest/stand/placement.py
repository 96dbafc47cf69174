"""Content of a tile: its ground and stems, and instances of shared shapes."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, hypot, sin
from vlp16emu.forest.plants.species import Flora, Trees
from vlp16emu.forest.plants.stem import STEM_PARTS
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import F8, I8, SURFACE, PlantPart, Semantic, ShapeKey

_LITTER_REFLECTANCE = 0.25  # dead leaves and needles at 0.90 um, [E900] of species.toml


@dataclass(frozen=True, slots=True)
class PlacedThings:
    """Things of one kind on one tile."""

    keys: Sequence[ShapeKey]  # (n,) shape of each
    world_T_shape: F8  # (n, 3, 4).
    surfaces: NDArray[np.void]  # (n, parts) `SURFACE` of each thing's meshes in order; instance still 0
    trees: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, TREE))
    """(n,) `TREE` with id still 0 if the things are trees, else (0,)."""
    is_ground: bool = False  # True for things that are part of the ground


def in_range(limits: tuple[float, float], draw: F8) -> F8:
    """Return the numbers in a range, limits[0] to limits[1], that draws in [0, 1) stand for."""
    return limits[0] + (limits[1] - limits[0]) * draw


def distinct(keys: Sequence[ShapeKey]) -> tuple[tuple[ShapeKey, ...], I8]:
    """Return the distinct keys, and the index of each key into them."""
    index_of = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    return tuple(index_of), np.array([index_of[key] for key in keys], np.int64)


def placements(place_m: F8, world_R_thing: F8, size: F8) -> F8:
    """`world_T_shape` (n, 3, 4) from places (n, 3), rotations (n, 3, 3) and scales along the axes (n, 3)."""
    return np.concatenate([world_R_thing * size[:, None, :], place_m[:, :, None]], axis=2)


def concatenate(groups: Sequence[PlacedThings]) -> PlacedThings:
    """Concatenate groups of things of one layer, none of them trees."""
    keys = [key for group in groups for key in group.keys]
    world_T_shape = np.concatenate([group.world_T_shape for group in groups])
    return PlacedThings(keys, world_T_shape, np.concatenate([group.surfaces for group in groups]))


def about_vertical(azimuth_deg: F8) -> F8:
    """Rotations (n, 3, 3) about the vertical, counter-clockwise."""
    return along_slope(np.radians(azimuth_deg), np.zeros(len(azimuth_deg)))


def along_slope(towards: F8, slope: F8) -> F8:
    """Rotations (n, 3, 3) that turn the x axis towards an angle from east, rad, on a slope dz/ds.

    The y axis stays level.
    """
    flat = 1 / hypot(1, slope)
    c = cos(towards)
    s = sin(towards)
    zero = np.zeros(len(towards))
    along = np.stack([c * flat, s * flat, slope * flat], axis=-1)
    across = np.stack([-s, c, zero], axis=-1)
    return np.stack([along, across, np.cross(along, across)], axis=-1)


@dataclass(frozen=True, slots=True)
class Tile:
    """Content of one tile, from which a `Window` is put together."""

    trees: Trees  # all trees by number, saplings last
    keys: tuple[ShapeKey, ...]  # distinct shapes, the tile's own first
    shape: I8  # (n,) index into `keys` of each placement
    world_T_shape: F8  # (n, 3, 4).
    first_surface: I8  # (n,) first row in `surfaces`
    surfaces: NDArray[np.void]  # (m,) `SURFACE`
    far: NDArray[np.bool_]  # (n,) mask of placements that are part of the `FarTile`
    low: NDArray[np.bool_]  # (n,) mask of placements that are ground, too low for the far medium


def tile_of(key: TileKey, origin_m: F8, trees: Trees, groups: Sequence[PlacedThings], plants: Flora) -> Tile:
    """Put a tile together: first its own shape of ground and the stems of `trees`, then all placed groups."""
    ground = np.zeros(1, SURFACE)
    ground["reflectance"] = _LITTER_REFLECTANCE
    ground["semantic"] = Semantic.GROUND
    own_T = np.concatenate([np.eye(3), origin_m[:, None]], axis=1)
    rows = np.concatenate([ground, plant_surfaces(trees, STEM_PARTS, plants).ravel()])
    groups = [PlacedThings([key], own_T[None], rows[None]), *groups]
    keys, shape = distinct([key for placed in groups for key in placed.keys])
    kinds = [(placed.is_ground, placed.surfaces.shape[1]) for placed in groups]
    is_low, parts = np.repeat(kinds, [len(placed.keys) for placed in groups], axis=0).T
    placed_trees = np.concatenate([placed.trees for placed in groups])
    return Tile(
        trees=placed_trees[np.argsort(placed_trees["id"], kind="stable")],
        keys=keys,
        shape=shape,
        world_T_shape=np.concatenate([placed.world_T_shape for placed in groups]),
        first_surface=np.cumsum(parts) - parts,
        surfaces=np.concatenate([placed.surfaces.ravel() for placed in groups]),
        far=is_low == 0,
        low=is_low > 0,
    )


def plant_surfaces(
    plants: Trees, parts: Sequence[int], table: Flora, semantic: Semantic = Semantic.TREE
) -> NDArray[np.void]:
    """`SURFACE` rows (n, parts) of trees, or of shrubs as `TREE`."""
    leaf = np.array(parts) == PlantPart.LEAF
    rows = np.zeros((len(plants), len(parts)), SURFACE)
    bright = np.where(leaf, plants["leaf_reflectance"][:, None], plants["bark_reflectance"][:, None])
    rows["semantic"] = semantic
    rows["part"] = parts
    rows["reflectance"] = bright
    rows["instance"] = plants["id"][:, None]
    rows["species"] = plants["species"][:, None]
    rows["material"] = table.bark[plants["species"]][:, None] + leaf
    return rows
