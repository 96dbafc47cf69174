"""A forest without edge: tiles of ground and stems, with instanced crowns, around wherever one walks."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError
from vlp16emu.types import SURFACE, Mesh, PlantPart, Semantic, ShapeKey, Window
from vlp16emu.world.crown import CrownKey, crown_meshes
from vlp16emu.world.species import species_table
from vlp16emu.world.stand import TREE, SpeciesMix, Stand
from vlp16emu.world.stem import lean_rotation, stem_meshes
from vlp16emu.world.terrain import Terrain
from vlp16emu.world.tiles import TILE_M, TileKey, ground_mesh, level_of, tile_origin_m, tiles_within

__all__ = ["Forest"]

Array = NDArray[np.float64]
Trees = NDArray[np.void]

_LITTER_REFLECTANCE = 0.30
"""Leaf litter and soil at 903 nm; assumption."""

_TREES_PER_TILE = 1024
"""Numbers set aside for the trees of a tile."""

_DENSEST_PER_HA = 12_000
"""A tile then has 480 trees on average with a sigma below 22, far from `_TREES_PER_TILE`."""

_ASIDE_M = 2 * TILE_M
"""How far a sensor may stray from the path and still see numbered trees only."""

_CROWN_PARTS = (PlantPart.BRANCH_FIRST_ORDER, PlantPart.BRANCH_HIGHER_ORDER, PlantPart.LEAF)
"""Of the meshes of a crown, in order."""


@dataclass(frozen=True, slots=True)
class _Tile:
    """What stands on one tile."""

    key: TileKey
    origin_m: Array
    trees: Trees
    crowns: tuple[CrownKey, ...]
    """Of each tree."""
    world_T_crown: Array
    """(n, 3, 4) of each tree."""


class Forest:
    """A stand of trees on a terrain; a `World`.

    The same tree has the same shape and number in every window and from either end of the path.

    Parameters
    ----------
    seed : of the scenario
    terrain : ground
    stems_per_ha : mean density over the plane
    species : the mixture
    path_clearance_m : no stem surface comes nearer to the path than this
    path_xy_m : (n, 2) float64, n >= 1, the whole way of the sensor, fine enough that its chords are the way
    reach_m : how far the sensor sees

    Raises
    ------
    GeometryError
        for an unknown species, a path with numbers that are not finite, or more trees than can be numbered
    """

    def __init__(
        self,
        *,
        seed: int,
        terrain: Terrain,
        stems_per_ha: float,
        species: Sequence[SpeciesMix],
        path_clearance_m: float,
        path_xy_m: Array,
        reach_m: float,
    ) -> None:
        if not np.isfinite(path_xy_m).all():
            row = int(np.flatnonzero(~np.isfinite(path_xy_m).all(axis=1))[0])
            raise GeometryError(f"path_xy_m[{row}]", f"found {path_xy_m[row].tolist()}", "finite numbers")
        if stems_per_ha > _DENSEST_PER_HA:
            raise GeometryError("stems_per_ha", f"found {stems_per_ha:g}", f"at most {_DENSEST_PER_HA}")
        self._seed, self._path_xy_m, self._reach_m = seed, path_xy_m, reach_m
        self.height_m = terrain.height_m
        self._stand = Stand(
            seed=seed,
            height_m=terrain.height_m,
            stems_per_ha=stems_per_ha,
            species=species,
            path_xy_m=path_xy_m,
            path_clearance_m=path_clearance_m,
        )
        self._first_tile, self._tiles_across = _numbered_tiles(path_xy_m, reach_m)
        # Twice what one window needs: tiles left behind fall out, tiles still in reach never do.
        kept = 2 * (2 + int((2 * reach_m + TILE_M) / TILE_M)) ** 2
        self._tile = lru_cache(maxsize=kept)(self._grow_tile)

    @property
    def materials(self) -> tuple[str, ...]:
        """Names by `SURFACE` material number: litter, then bark and leaf of each species of the table."""
        plants = (f"{name} {what}" for name in species_table() for what in ("bark", "leaf"))
        return ("litter", *plants)

    def trees(self, track_m: Array) -> Trees:
        """Give the records (n,) `TREE` of all trees within reach of sensor positions (m, 2 or 3)."""
        return _all_trees(self._tiles_near(track_m))

    def window(self, track_m: Array) -> Window:
        """Ground, stems and crowns within reach of sensor positions (n, 3).

        Raises
        ------
        GeometryError
            where the track leaves the surroundings of the path
        """
        tiles = self._tiles_near(track_m)
        trees = _all_trees(tiles)
        keys = [*(tile.key for tile in tiles), *(key for tile in tiles for key in tile.crowns)]
        index_of = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        stems = np.array([len(tile.trees) for tile in tiles])
        tile_first = np.concatenate([[0], np.cumsum(1 + stems)])
        crown_first = tile_first[-1] + len(_CROWN_PARTS) * np.arange(len(trees))
        tile_T = np.zeros((len(tiles), 3, 4))
        tile_T[:, :, :3], tile_T[:, :, 3] = np.eye(3), [tile.origin_m for tile in tiles]
        return Window(
            origin_m=np.round(track_m.mean(axis=0)),
            shapes=tuple(index_of),
            shape=np.array([index_of[key] for key in keys], np.int32),
            world_T_shape=np.concatenate([tile_T, *(tile.world_T_crown for tile in tiles)]),
            first_surface=np.concatenate([tile_first[:-1], crown_first]).astype(np.uint32),
            surfaces=_surfaces(trees, tile_first[:-1]),
        )

    def shape(self, key: ShapeKey) -> tuple[Mesh, ...]:
        """Meshes of a tile (ground, then its stems) or of a crown (both orders of branches, leaves)."""
        if isinstance(key, CrownKey):
            return crown_meshes(self._seed, key)
        if isinstance(key, TileKey):
            tile = self._tile(key.ix, key.iy)
            stems = stem_meshes(tile.trees, key.level, tile.origin_m, self.height_m)
            return (ground_mesh(key, self.height_m), *stems)
        raise KeyError(key)

    def _tiles_near(self, track_m: Array) -> list[_Tile]:
        """Tiles within reach of a track, in ascending order."""
        return [self._tile(int(ix), int(iy)) for ix, iy in tiles_within(track_m[:, :2], self._reach_m)]

    def _grow_tile(self, ix: int, iy: int) -> _Tile:
        """One tile with its trees numbered."""
        column, row = ix - self._first_tile[0], iy - self._first_tile[1]
        if not (0 <= column < self._tiles_across[0] and 0 <= row < self._tiles_across[1]):
            raise GeometryError(
                "track", f"reaches tile ({ix}, {iy})", f"no more than {_ASIDE_M:g} m off the path"
            )
        trees = self._stand.trees(ix, iy)
        first = 1 + (column * self._tiles_across[1] + row) * _TREES_PER_TILE
        trees["id"] = first + np.arange(len(trees))
        key = TileKey(ix, iy, level_of((ix, iy), self._path_xy_m))
        crowns = tuple(
            self._stand.crown(
                int(tree["cohort"]), int(tree["crown_class"]), int(tree["crown_variant"]), key.level
            )
            for tree in trees
        )
        return _Tile(
            key, tile_origin_m(ix, iy, self.height_m), trees, crowns, _crown_placements(trees, crowns)
        )


def _numbered_tiles(path_xy_m: Array, reach_m: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """First tile and number of tiles, in x and y, of the box around all that the walk can see."""
    aside = reach_m + _ASIDE_M
    low = np.floor((path_xy_m.min(axis=0) - aside) / TILE_M).astype(int)
    across = np.floor((path_xy_m.max(axis=0) + aside) / TILE_M).astype(int) - low + 1
    if int(across[0]) * int(across[1]) * _TREES_PER_TILE >= 2**32:
        size = " x ".join(f"{n * TILE_M / 1000:.0f} km" for n in across)
        raise GeometryError("path_xy_m", f"spans {size} with what is in reach", "at most about 40 km x 40 km")
    return (int(low[0]), int(low[1])), (int(across[0]), int(across[1]))


def _all_trees(tiles: list[_Tile]) -> Trees:
    """Trees of all tiles, tile by tile."""
    return np.concatenate([tile.trees for tile in tiles]) if tiles else np.zeros(0, TREE)


def _crown_placements(trees: Trees, crowns: Sequence[CrownKey]) -> Array:
    """`world_T_shape` of the crowns, (n, 3, 4): scaled to the tree's size, turned, and leaning with the stem."""
    prototype_m = np.array([(c.crown_width_m, c.crown_length_m) for c in crowns]).reshape(-1, 2)
    lean = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])
    upright = lean[:, 2, 2]  # cosine of the lean: heights are vertical, crowns follow the axis
    wide = trees["crown_width_m"] / prototype_m[:, 0]
    long = (trees["height_m"] - trees["crown_base_m"]) / upright / prototype_m[:, 1]
    turn = np.radians(trees["crown_azimuth_deg"])
    stem_T = np.zeros((len(trees), 3, 3))
    stem_T[:, 0, 0] = stem_T[:, 1, 1] = wide * np.cos(turn)
    stem_T[:, 1, 0], stem_T[:, 0, 1] = wide * np.sin(turn), -wide * np.sin(turn)
    stem_T[:, 2, 2] = long
    foot = np.column_stack([trees["x_m"], trees["y_m"], trees["z_m"]])
    base = foot + lean[:, :, 2] * (trees["crown_base_m"] / upright)[:, None]
    return np.concatenate([lean @ stem_T, base[..., None]], axis=2)


def _surfaces(trees: Trees, ground_rows: NDArray[np.int64]) -> NDArray[np.void]:
    """`SURFACE` table: for each tile its ground and its stems, then for each tree the parts of its crown."""
    parts = len(_CROWN_PARTS)
    rows = np.zeros(len(ground_rows) + (1 + parts) * len(trees), SURFACE)
    is_ground = np.zeros(len(rows), np.bool_)
    is_ground[ground_rows] = True
    rows["reflectance"][is_ground] = _LITTER_REFLECTANCE
    rows["semantic"][is_ground] = Semantic.GROUND
    # Stems are in the order of the trees, and so are crowns: one index serves both.
    tree = trees[np.concatenate([np.arange(len(trees)), np.repeat(np.arange(len(trees)), parts)])]
    part = np.concatenate([np.full(len(trees), PlantPart.STEM), np.tile(_CROWN_PARTS, len(trees))])
    leaf = part == PlantPart.LEAF
    plants = np.zeros(len(tree), SURFACE)
    plants["reflectance"] = np.where(leaf, tree["leaf_reflectance"], tree["bark_reflectance"])
    plants["semantic"] = Semantic.TREE
    plants["part"] = part
    plants["instance"], plants["species"] = tree["id"], tree["species"]
    numbers = np.array([species.number for species in species_table().values()])
    row_of = np.zeros(numbers.max() + 1, np.int64)
    row_of[numbers] = np.arange(len(numbers))
    plants["material"] = 1 + 2 * row_of[tree["species"]] + leaf
    rows[~is_ground] = plants
    return rows
