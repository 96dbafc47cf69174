"""A forest without edge: tiles of ground and stems, with instanced crowns and things, around any path.

Tiles and shapes are cached.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError
from vlp16emu.foliage.tiles import FarTile, TiledWindow
from vlp16emu.forest.plants import prototypes
from vlp16emu.forest.plants.foliage import IvyKey, ivy_meshes, ivy_tops_m
from vlp16emu.forest.plants.species import Trees
from vlp16emu.forest.plants.stem import STEM_LAYERS, STEM_PARTS, StemKey, stem_layers, stem_meshes
from vlp16emu.forest.settings import Woods
from vlp16emu.forest.stand.cushions import side_of, sides_on
from vlp16emu.forest.stand.floor_shapes import FloorKey, floor_meshes
from vlp16emu.forest.stand.given_stand import GivenStand
from vlp16emu.forest.stand.inventory import far_stems
from vlp16emu.forest.stand.placement import PlacedThings, Tile, distinct, plant_surfaces, tile_of
from vlp16emu.forest.stand.points import Land
from vlp16emu.forest.stand.scatter import layers_of
from vlp16emu.forest.stand.stand import TREE, Stand, foot_discs
from vlp16emu.forest.stand.tree_models import ModelKey, TreeModels
from vlp16emu.forest.tiles import TILE_M, GroundKey, TileKey, around, ground_mesh, tile_origin_m, tiles_within
from vlp16emu.store import recall
from vlp16emu.types import F8, FIRST_FREE_INSTANCE, I8, SURFACE, Mesh, PlantPart, ShapeKey
from vlp16emu.world.vectors import places_m

_NUMBERS_PER_TILE = 8192  # numbers reserved for the trees and things of a tile
_MOST_TILES = (FIRST_FREE_INSTANCE - 1) // _NUMBERS_PER_TILE
_MOST = "209 km2"  # area of these tiles
_DENSEST_PER_HA = 125_000
"""Greatest density; a tile then holds 5000 things on average. Even in clusters of ten the number has a sigma
below 240, and with all possible patches below 500, far from `_NUMBERS_PER_TILE`."""
_TILES_IN_GROWTH = 16
"""Number of tiles whose stems are grown together, kept until all are taken: more than grow at the same
time."""
_OVERHANG_M = 10.0  # greatest reach of crowns beyond the tile of their stem
_MARGIN_M = 80.0
"""Margin of the region around the reach of the path whose tiles are numbered first: overhang of crowns, half
a tile's diagonal, one tile, since voxels of a tile also depend on the tiles around it, and 35 m to stray."""
_STEMS_IN_GROWTH = 64  # stems whose layers are kept until all are taken
T = TypeVar("T")


def _by_tile(kind: str, name: str, make: Callable[[int, int], T]) -> Callable[[int, int], T]:
    """Cache the result for each tile (ix, iy).

    `name` is the digest of all other inputs, empty for no cache.
    """
    return lambda ix, iy: recall(name and f"{name} {kind} {ix} {iy}", lambda: make(ix, iy))


def _joined(tables: Sequence[NDArray[np.void]]) -> NDArray[np.void]:
    """Join tables of surfaces as plain bytes: numpy compares the fields of each two in Python."""
    rows = np.dtype((np.void, SURFACE.itemsize))
    return np.concatenate([np.ascontiguousarray(table).view(rows) for table in tables]).view(SURFACE)


class ForestWorld:
    """Trees with the plants and things under them on a terrain; a `World`.

    A tree or a stone has the same shape and number in every window and from either end of the path; windows
    may be anywhere, also far from the path. Raises GeometryError for a path with numbers that are not finite,
    or for more things than can be numbered.

    Parameters
    ----------
    reach_m : range of the sensor
    name, plants_name : digests of all inputs of the forest, with seed and path, and of the plants; empty if
        nothing is cached
    """

    def __init__(
        self,
        section: Woods,
        stems: Stand | GivenStand,
        land: Land,
        *,
        reach_m: float,
        near_m: float = math.inf,
        name: str = "",
        plants_name: str = "",
    ) -> None:
        self.section = section
        self.height_m = land.height_m
        self.plants = land.plants
        self.seed = land.seed
        self.near_m = near_m
        self.name = name
        self._plants_name = plants_name
        self.models = TreeModels(section.tree_models, self.plants, section.season)
        self._reach_m = reach_m
        self._layers = layers_of(section, land, stems.species)
        per_ha = stems.per_ha + sum(layer.pattern.per_ha for layer in self._layers if not layer.is_ground)
        if per_ha > _DENSEST_PER_HA:
            found = f"found {per_ha:.0f} trees and things per hectare"
            raise GeometryError("forest", found, f"at most {_DENSEST_PER_HA}")
        self._region = Region.around(land.path.xy_m, reach_m + _MARGIN_M)
        # Twice the need of one window: tiles left behind are dropped, tiles in reach never are.
        across = 4 + int((2 * reach_m + TILE_M) / TILE_M)
        kept = 2 * across * across
        self._tile = lru_cache(maxsize=kept)(_by_tile("Tile", name, self._grow_tile))
        self.far_tile = lru_cache(maxsize=kept)(_by_tile("FarTile", name, self._far_tile))
        self._trees = lru_cache(maxsize=kept)(stems.trees)
        self._crown = cache(stems.crown)
        self._stem_meshes = lru_cache(maxsize=_TILES_IN_GROWTH)(
            _by_tile("Stems", name, lambda ix, iy: self._grow_stems(TileKey(ix, iy)))
        )
        self._stem_layers = lru_cache(maxsize=_STEMS_IN_GROWTH)(self._cut_stem)
        self._ivy_meshes = lru_cache(maxsize=_TILES_IN_GROWTH)(self._grow_ivy)
        self._discs = lru_cache(maxsize=kept)(
            lambda ix, iy: foot_discs(self._trees(ix, iy), table=self.plants.trees)
        )

    @property
    def materials(self) -> tuple[str, ...]:
        """Names by `SURFACE` material number."""
        return self.plants.materials

    def trees(self, track_m: F8) -> Trees:
        """Return the records (n,) `TREE` of all trees and saplings in the window of positions (m, 2 or 3)."""
        return np.concatenate(
            [np.zeros(0, TREE), *(self._tile(*name).trees for name in self._in_view(track_m))]
        )

    def reaches(self, place_m: F8, aside_m: float) -> bool:
        """Return True if all that is seen `aside_m` around a place (3,), or nearer, is in numbered tiles."""
        aside_m = aside_m + self._reach_m + _OVERHANG_M
        corners_m = place_m[:2] + aside_m * np.array([[-1.0, -1.0], [1.0, 1.0]])
        corners = np.floor(corners_m / TILE_M).astype(int).tolist()
        return all(self._region.tiles_up_to(self._region.ring(ix, iy)) <= _MOST_TILES for ix, iy in corners)

    def window(self, track_m: F8) -> TiledWindow:
        """Return the window within reach of sensor positions (n, 3).

        Raises GeometryError beyond the numbered tiles.
        """
        names = self._in_view(track_m)
        tiles = [self._tile(*name) for name in names]
        index_of = dict[ShapeKey, int]()
        index = [np.array([index_of.setdefault(key, len(index_of)) for key in tile.keys]) for tile in tiles]
        begins = np.cumsum([0, *(len(tile.surfaces) for tile in tiles)]).tolist()
        return TiledWindow(
            origin_m=np.round(track_m.mean(axis=0)),
            shapes=tuple(index_of),
            shape=np.concatenate(
                [number[tile.shape] for number, tile in zip(index, tiles, strict=True)]
            ).astype(np.int32),
            world_T_shape=np.concatenate([tile.world_T_shape for tile in tiles]),
            first_surface=np.concatenate(
                [begin + tile.first_surface for begin, tile in zip(begins, tiles, strict=False)]
            ).astype(np.uint32),
            surfaces=_joined([tile.surfaces for tile in tiles]),
            track_m=track_m,
            tiles=tuple((ix, iy, row) for (ix, iy), row in zip(names, begins, strict=False)),
            far=np.concatenate([tile.far for tile in tiles]),
            low=np.concatenate([tile.low for tile in tiles]),
        )

    def shape_name(self, key: ShapeKey) -> str:
        """Return the cache name of a shape.

        For tiles it depends on the whole forest, for others on seed and plants alone.
        """
        if not self.name:
            return ""
        if isinstance(key, StemKey):
            return ""  # the stems of its tile are kept
        is_of_forest = isinstance(key, TileKey | GroundKey | IvyKey)
        return f"{self.name if is_of_forest else f'{self.seed} {self._plants_name}'} {key!r}"

    def _far_tile(self, ix: int, iy: int) -> FarTile:
        """Describe a tile for the far medium."""
        tile = self._tile(ix, iy)
        origin_m = tile_origin_m(ix, iy, self.height_m)
        corner_m = np.array([origin_m[0], origin_m[1], 2.0 * np.round(origin_m[2] / 2.0)])
        edge_m = np.arange(-2, 83) * 0.25
        x, y = np.meshgrid(origin_m[0] + edge_m, origin_m[1] + edge_m, indexing="ij")
        far = np.flatnonzero(tile.far)[1:]  # without the first, the tile's own shape
        keys, shape = distinct([tile.keys[number] for number in tile.shape[far].tolist()])
        begins = np.append(np.unique(tile.first_surface), len(tile.surfaces))
        rows = tile.first_surface[far]
        # One placement of each shape, for the number of its parts.
        some = rows[np.unique(shape, return_index=True)[1]]
        ends = begins[np.searchsorted(begins, some, side="right")]
        parts = [
            self.models.far_parts(key) or tile.surfaces["part"][row:end]
            for key, row, end in zip(keys, some, ends, strict=True)
        ]
        trees = self._grown_trees(ix, iy)
        stems = far_stems(trees, 1, table=self.plants.trees)
        modelled = self.models.far_stems(
            [keys[i] for i in shape], tile.world_T_shape[far], tile.first_surface[far]
        )
        return FarTile(
            corner_m=corner_m,
            keys=keys,
            shape=shape,
            world_T_shape=tile.world_T_shape[far],
            first_surface=tile.first_surface[far],
            first_part=np.cumsum([0, *map(len, parts)]),
            part=np.concatenate([np.zeros(0, np.uint8), *parts]),
            stems=np.concatenate([stems, modelled]),
            ground_m=self.height_m(x, y),
            sides=sides_on(corner_m, tile, self.seed),
            facing=side_of(self.seed)[1],
        )

    def shape(self, key: ShapeKey) -> tuple[Mesh, ...]:
        """Return the meshes of a tile (ground, then its stems), of a crown, or of a thing."""
        match key:
            case TileKey():
                return (ground_mesh(key, self.height_m), *self._grow_stems(key))
            case GroundKey():
                return (ground_mesh(key, self.height_m),)
            case StemKey():
                return self._stem_layers(key.tile, key.number)[key.layer]
            case IvyKey():
                return (self._ivy_meshes(key.tile)[key.number],)
            case ModelKey():
                return self.models.shape(key)
            case prototypes.CrownKey():
                return prototypes.crown_meshes(self.seed, key, table=self.plants.trees)
            case prototypes.SaplingKey():
                return prototypes.sapling_meshes(self.seed, key, table=self.plants.trees)
            case prototypes.ShrubKey():
                return prototypes.shrub_meshes(self.seed, key, table=self.plants.shrubs)
            case FloorKey():
                return floor_meshes(self.seed, key)
        raise KeyError(key)

    def core(self, key: ShapeKey) -> F8 | None:
        """Return heights and radii (2, k) of the stem in a crown; None for other shapes."""
        return (
            prototypes.crown_core(key, table=self.plants.trees)
            if isinstance(key, prototypes.CrownKey)
            else None
        )

    def stems(self, key: TileKey) -> list[Mesh]:
        """Return the meshes of a tile's shape without the first, the ground."""
        return self._stem_meshes(key.ix, key.iy)

    def _in_view(self, track_m: F8) -> list[tuple[int, int]]:
        return list(map(tuple, tiles_within(track_m[:, :2], self._reach_m + _OVERHANG_M).tolist()))

    def _grow_tile(self, ix: int, iy: int) -> Tile:
        tile_number = self._region.number(ix, iy)
        if tile_number >= _MOST_TILES:
            raise GeometryError("track", f"reaches tile ({ix}, {iy})", f"at most {_MOST} around the path")
        key = TileKey(ix, iy)
        trees = self._trees(ix, iy).copy()
        number = 1 + tile_number * _NUMBERS_PER_TILE
        trees["id"] = number + np.arange(len(trees))
        number += len(trees)
        is_modelled = self.models.has(trees)
        grown = trees[~is_modelled]
        modelled = self.models.place(trees[is_modelled])
        crowns = [self._crown(*name) for name in grown[["cohort", "crown_class", "crown_variant"]].tolist()]
        world_T = prototypes.crown_placements(grown, crowns)
        rows = plant_surfaces(grown, prototypes.CROWN_PARTS, self.plants)
        groups = [PlacedThings(crowns, world_T, rows, grown), *modelled]
        if self.section.ivy.share:
            groups.append(self._place_ivy(key, grown))
        trunks = around(ix, iy, self._discs) if self._layers else np.zeros((0, 3))
        for layer in self._layers:
            groups.append(placed := layer.place(ix, iy, trunks))
            if placed.is_ground:
                continue
            numbers = number + np.arange(len(placed.keys))
            placed.surfaces["instance"] = numbers[:, None]
            if len(placed.trees):
                placed.trees["id"] = numbers
            number += len(placed.keys)
        tile = tile_of(key, tile_origin_m(ix, iy, self.height_m), grown, groups, self.plants)
        is_leaf = tile.surfaces["part"] == PlantPart.LEAF
        tile.surfaces["texture"] = np.where(is_leaf, 0.0, self.section.texture)
        tile.surfaces["roughness"] = np.where(is_leaf, self.section.leaf_roughness or 0.0, 0.0)
        return tile

    def _grown_trees(self, ix: int, iy: int) -> Trees:
        trees = self._trees(ix, iy)
        return trees[~self.models.has(trees)]

    def _grow_stems(self, key: TileKey) -> list[Mesh]:
        origin_m = tile_origin_m(key.ix, key.iy, self.height_m)
        return stem_meshes(
            self._grown_trees(key.ix, key.iy), origin_m, self.height_m, table=self.plants.trees
        )

    def _cut_stem(self, key: TileKey, number: int) -> list[tuple[Mesh, ...]]:
        """Return the meshes of the layers of a tile's stem, relative to its foot."""
        first = len(STEM_PARTS) * number
        meshes = self._stem_meshes(key.ix, key.iy)[first : first + len(STEM_PARTS)]
        tree = self._grown_trees(key.ix, key.iy)[number : number + 1]
        foot_m = places_m(tree)[0] - tile_origin_m(key.ix, key.iy, self.height_m)
        return stem_layers(tree, meshes, foot_m, table=self.plants.trees)

    def _grow_ivy(self, key: TileKey) -> list[Mesh]:
        trees = self._grown_trees(key.ix, key.iy)
        origin_m = tile_origin_m(key.ix, key.iy, self.height_m)
        return ivy_meshes(
            trees, self._ivy_m(trees), origin_m, seed=self.seed, tile=key, table=self.plants.trees
        )

    def _ivy_m(self, trees: Trees) -> F8:
        return ivy_tops_m(trees, self.section.ivy.share, self.section.ivy.height_m, seed=self.seed)

    def _place_ivy(self, key: TileKey, trees: Trees) -> PlacedThings:
        numbers = np.flatnonzero(self._ivy_m(trees))
        world_T_tile = np.column_stack([np.eye(3), tile_origin_m(key.ix, key.iy, self.height_m)])
        return PlacedThings(
            [IvyKey(key, number) for number in numbers.tolist()],
            np.repeat(world_T_tile[None], len(numbers), axis=0),
            plant_surfaces(trees[numbers], (PlantPart.LEAF,), self.plants),
        )

    def with_loose_stems(self, window: TiledWindow, ids: I8) -> TiledWindow:
        """Return a window whose stems can be moved: those of trees with the numbers `ids` (n,) in layers.

        Each layer is a placement of its own, by near light alone, with the surfaces that its stem has in the
        tile's own shape. The other stems are left out: near light does not reach them.
        """
        keys = list[ShapeKey]()
        feet_m = [np.zeros((0, 3))]
        rows = list[int]()
        for ix, iy, row in window.tiles:
            trees = self._trees(ix, iy)
            is_grown = ~self.models.has(trees)
            first = 1 + self._region.number(ix, iy) * _NUMBERS_PER_TILE
            numbers = np.flatnonzero(np.isin(first + np.flatnonzero(is_grown), ids))
            feet_m.append(np.repeat(places_m(trees[is_grown][numbers]), STEM_LAYERS, axis=0))
            for number in numbers.tolist():
                keys += [StemKey(TileKey(ix, iy), number, layer) for layer in range(STEM_LAYERS)]
                rows += [row + 1 + len(STEM_PARTS) * number] * STEM_LAYERS
        count = len(keys)
        world_T_stem = np.repeat(np.eye(3, 4)[None], count, axis=0)
        world_T_stem[:, :, 3] = np.concatenate(feet_m)
        bare = (GroundKey(key.ix, key.iy) if isinstance(key, TileKey) else key for key in window.shapes)
        more = window.with_more(count)
        return replace(
            window,
            shapes=(*bare, *keys),
            shape=np.append(window.shape, len(window.shapes) + np.arange(count)).astype(np.int32),
            world_T_shape=np.concatenate([window.world_T_shape, world_T_stem]),
            first_surface=np.append(window.first_surface, rows).astype(np.uint32),
            far=more["far"],
            low=np.append(window.low, np.ones(count, np.bool_)),
        )


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of tiles around the path that grows ring by ring, so that each tile has a number."""

    first: tuple[int, int]  # south-west tile of the rectangle
    across: tuple[int, int]  # tiles in x and y

    @classmethod
    def around(cls, path_xy_m: F8, aside_m: float) -> Self:
        """Return the region around a path (n, 2); raises GeometryError if it is too large to be numbered."""
        if not np.isfinite(path_xy_m).all():
            row = int(np.flatnonzero(~np.isfinite(path_xy_m).all(axis=1))[0])
            raise GeometryError(f"path_xy_m[{row}]", f"found {path_xy_m[row].tolist()}", "finite numbers")
        low = np.floor((path_xy_m.min(axis=0) - aside_m) / TILE_M).astype(int)
        across = np.floor((path_xy_m.max(axis=0) + aside_m) / TILE_M).astype(int) - low + 1
        if int(across[0]) * int(across[1]) > _MOST_TILES:
            size = " x ".join(f"{n * TILE_M / 1000:.0f} km" for n in across)
            raise GeometryError("path_xy_m", f"spans {size} with what is in reach", f"at most {_MOST}")
        return cls((int(low[0]), int(low[1])), (int(across[0]), int(across[1])))

    def ring(self, ix: int, iy: int) -> int:
        """Return the ring of a tile around the rectangle; 0 in it."""
        column = ix - self.first[0]
        row = iy - self.first[1]
        columns, rows = self.across
        return max(-column, column - columns + 1, -row, row - rows + 1, 0)

    def tiles_up_to(self, ring: int) -> int:
        """Return the number of tiles in the rectangle and in the rings around it up to `ring`."""
        columns, rows = self.across
        return (columns + 2 * ring) * (rows + 2 * ring)

    def number(self, ix: int, iy: int) -> int:
        """Return the number of a tile: column by column in the rectangle, then around it, ring after ring."""
        column = ix - self.first[0]
        row = iy - self.first[1]
        columns, rows = self.across
        ring = self.ring(ix, iy)
        if ring == 0:
            return column * rows + row

        within = self.tiles_up_to(ring - 1)
        column += ring
        row += ring
        columns += 2 * ring
        rows += 2 * ring
        if column == 0:
            return within + row
        if column == columns - 1:
            return within + rows + row
        side = 0 if row == 0 else columns - 2
        return within + 2 * rows + side + column - 1
