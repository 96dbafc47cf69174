"""Casting of tiled windows: near faces by Embree, the rest as a far medium.

Media are made from blocks of tiles and clouds of shapes, which are kept from window to window and in the
store.
"""

import math
import threading
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from copy import copy

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import hypot, norm
from vlp16emu.errors import GeometryError
from vlp16emu.foliage.cloud import Cloud, Library, cloud_of
from vlp16emu.foliage.ground import greatest_steps_m
from vlp16emu.foliage.lanes import Ground, Medium, Stems, empty_lanes
from vlp16emu.foliage.leaves import room_for_leaves
from vlp16emu.foliage.march import Passage, march_lines, march_pulses
from vlp16emu.foliage.medium import Block, Name, Shelf, block_of, pack_block, stretch_of, unpack_block
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.foliage.stems import room_for_stems, stem_lines, stems_of
from vlp16emu.foliage.tiles import STEM, FarTile, TiledWindow, TiledWorld
from vlp16emu.foliage.voxel import BRICK, COLUMNS, FINER, KNOTS, QUANTILES, VOXEL_M
from vlp16emu.raycast.build import Instances, placed_boxes
from vlp16emu.raycast.near import EmbreeCaster, EmbreeGeometry, target_of
from vlp16emu.raycast.packet import LEVEL, Target
from vlp16emu.store import recall
from vlp16emu.types import F4, F8, U1, U4, Mesh, ShapeKey, Sway, Window, World

STRAY_M = 1.0  # greatest distance of a sensor from the positions of its window
_LEVEL = float(LEVEL) - 1e-4  # slope below which the rays of a pulse are also level in float32
_TILE_M = COLUMNS * VOXEL_M
_BRICKS = COLUMNS // BRICK
_NO_GROUND_M = np.float32(-1e6)
_AROUND = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
_NO_CLOUD = cloud_of([Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))], np.zeros(1, np.uint8))
"""Library for windows where only stems and ground are far, so that no shape is measured."""


def _ground(
    window: TiledWindow,
    tiles: Mapping[Name, FarTile],
    rows: Mapping[Name, int],
    corner_m: F8,
    size: tuple[int, ...],
) -> Ground:
    ground_m = np.full((size[0] * BRICK * FINER + 1, size[1] * BRICK * FINER + 1), _NO_GROUND_M)
    surface = np.zeros(size[:2], np.uint32)
    sides = np.zeros((size[0] * BRICK * FINER, size[1] * BRICK * FINER), np.uint32)
    low = np.array(list(rows)).min(axis=0)
    for (ix, iy), row in rows.items():
        i, j = (ix - low[0]) * _BRICKS, (iy - low[1]) * _BRICKS
        surface[i : i + _BRICKS, j : j + _BRICKS] = row
        x, y = i * BRICK * FINER, j * BRICK * FINER
        tile = tiles[ix, iy]
        corners_m = tile.ground_m[FINER:-FINER, FINER:-FINER] - window.origin_m[2]
        ground_m[x : x + len(corners_m), y : y + len(corners_m)] = corners_m
        sides[x : x + len(tile.sides), y : y + len(tile.sides)] = tile.sides
    steps_m = np.array(greatest_steps_m(ground_m, float(_NO_GROUND_M) / 2), np.float32)
    steepest = float(hypot(steps_m[0], steps_m[1]) * FINER / VOXEL_M)
    facing = next(iter(tiles.values())).facing  # the same for all tiles
    return Ground(ground_m, surface, float(corner_m[0]), float(corner_m[1]), steepest, sides, facing)


def _stems(window: TiledWindow, tiles: Mapping[Name, FarTile], rows: Mapping[Name, int]) -> Stems:
    stems = np.concatenate([np.zeros(0, STEM), *(tiles[place].stems for place in rows)])
    base = np.repeat(list(rows.values()), [len(tiles[place].stems) for place in rows]).astype(np.uint32)
    foot_m = stems["foot_m"] - window.origin_m
    radius_m = stems["radius_m"]
    widest_m = np.maximum.accumulate(radius_m[:, ::-1], axis=1)[:, ::-1]
    profile = np.concatenate(
        [np.stack([stems["along_m"], radius_m, widest_m], axis=1), stems["aside_m"]], axis=1
    )
    bent_m = hypot(stems["aside_m"][:, 0], stems["aside_m"][:, 1]).max(axis=1)
    line = np.column_stack([foot_m, stems["axis"], radius_m.max(axis=1), bent_m])
    surface = stems["row"] + base[:, None]
    sway = None if window.sway is None else _sway_of(window, window.sway, stems, surface[:, 1])
    return stems_of(line, profile, surface, stems["flare_m"].copy(), sway)


def _sway_of(window: Window, sway: Sway, stems: NDArray[np.void], surface: U4) -> tuple[F4, F4]:
    """Return shares and movement of stems (n,), as in `Stems`, by the tree of their surfaces (n,)."""
    instance = window.surfaces["instance"]
    trees, rows = np.unique(instance[window.first_surface[sway.placement]], return_index=True)
    own = instance[surface]
    at = np.minimum(np.searchsorted(trees, own), len(trees) - 1)
    moves = np.flatnonzero(trees[at] == own) if len(trees) else np.zeros(0, np.int64)
    row = rows[at[moves]]
    z_m = stems["foot_m"][moves, 2:] + stems["along_m"][moves] * stems["axis"][moves, 2:]
    knots = z_m.shape[1]
    share = np.zeros((len(stems), knots), np.float32)
    share[moves] = sway.shares(np.repeat(row, knots), z_m.ravel()).reshape(-1, knots)
    top_m = np.zeros((len(sway.top_m), len(stems), 2), np.float32)
    top_m[:, moves] = sway.top_m[:, row]
    return share, top_m


class FarGeometry(EmbreeGeometry):
    """A window with a medium, ready for casting by any number of threads.

    Parameters
    ----------
    near : placements that are cast as faces up to the range where the medium begins
    track_m : (t, 3) sensor positions of the window
    beyond : placements that are cast as faces at any range beyond
    medium : far medium
    """

    lines = staticmethod(march_lines)
    pulses = staticmethod(march_pulses)

    def __init__(self, near: Instances, track_m: F8, beyond: Instances | None, medium: Medium) -> None:
        self._within_reach, level = within_reach(near, track_m, medium.near_m)
        super().__init__(near, level)
        self.medium = medium
        self._kept = beyond
        self._building = threading.Lock()
        if level.sum() < self._within_reach.sum():
            self._near = self._near._replace(steep=0)
        self._beyond = target_of(beyond) if beyond else self._near._replace(scene=0, steep=0)

    @property
    def as_far(self) -> "FarGeometry":
        """The same window, with near content as the medium too."""
        geometry = copy(self)
        geometry.medium = self.medium._replace(near_m=0.0)
        geometry.idle = {}
        return geometry

    def near_faces(self, rise: float, far_m: float) -> tuple[Target, float]:
        """Return near faces as `EmbreeGeometry` does, none if the medium begins at the sensor."""
        reach_m = min(far_m, self.medium.near_m)
        return (self._target_for(rise) if reach_m > 0.0 else self._beyond), reach_m

    def passage(self, pulses: int) -> tuple[object, ...]:
        """Return the medium, the faces at any range, and scratch."""
        stems = room_for_stems(self.medium.stems)
        return (Passage(self.medium, self._beyond, empty_lanes(), stems, room_for_leaves(pulses)),)

    def _target_for(self, rise: float) -> Target:
        """Return the near faces; pieces that only steep rays can meet are built for the first steep ray."""
        if rise > _LEVEL:
            with self._building:
                if not self._near.steep:
                    self._near = self._near._replace(steep=self._instances.scene(self._within_reach))
        return self._near


def within_reach(
    instances: Instances, track_m: F8, reach_m: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks (n,), (n,) of the pieces in reach of positions (t, 3): by any ray, and by level rays."""
    window = instances.window
    placement = instances.placement
    at_m, half_m = placed_boxes(window.world_T_shape[placement], instances.boxes_m)
    low_m, high_m = at_m[:, 2] - half_m[:, 2], at_m[:, 2] + half_m[:, 2]
    aside_m = hypot(half_m[:, 0], half_m[:, 1])
    motion = instances.motion
    if motion.span_ns:
        shear = hypot(motion.shear[..., 0], motion.shear[..., 1]).max(axis=0)
        foot_z_m = motion.foot_m + window.origin_m[2]
        aside_m += shear * np.maximum(np.abs(low_m - foot_z_m), np.abs(high_m - foot_z_m))
    level_m = np.maximum(distance_m(at_m[:, :2], track_m[:, :2]) - aside_m, 0.0)
    sensors_m = track_m[:, 2]
    rise_m = np.maximum(np.maximum(low_m - sensors_m.max(), sensors_m.min() - high_m), 0.0)
    met = hypot(level_m, rise_m) <= reach_m + STRAY_M
    return met, met & (rise_m <= LEVEL * reach_m + STRAY_M)


class FarCaster(EmbreeCaster):
    """Opens windows with tiles of a world that describes its far tiles; parameters as in `EmbreeCaster`.

    Clouds of shapes and blocks of tiles are kept from window to window.
    """

    def __init__(self, world: TiledWorld, workers: Executor) -> None:
        super().__init__(world, workers)
        self._tiled = world
        self._clouds = dict[ShapeKey, Cloud]()
        self._measured = set[Name]()
        self._place = dict[object, int]()
        self._names = list[str]()
        self._library = Library.of([_NO_CLOUD])
        self._cosine = np.zeros((0, len(KNOTS), QUANTILES), np.float32)
        self._shelf = Shelf()

    def _geometry_of(self, window: Window) -> EmbreeGeometry:
        if not isinstance(window, TiledWindow) or math.isinf(self._tiled.near_m):
            return super()._geometry_of(window)
        tiles = self.tiles(window)
        exact = ~window.far
        is_near = np.empty(len(window.shape), np.bool_)
        is_near[window.far] = self._is_near(window)
        is_near[exact] = self._is_reached(window, exact)
        everywhere = _part(window, exact & ~window.low)
        beyond = self._instances(everywhere, self._start_shapes(everywhere))
        part = _part(window, is_near)
        begun = self._start_shapes(part)  # runs while the medium is put together
        medium = self.medium(window, tiles)
        near = self._instances(part, begun)
        return FarGeometry(near, window.track_m, beyond if len(beyond.placement) else None, medium)

    def _is_near(self, window: TiledWindow) -> NDArray[np.bool_]:
        """Return a mask of the placements of `window.far` that light may meet before the medium."""
        shape_radius_m = np.array(
            [self._clouds[key].radius_m if key in self._clouds else 0.0 for key in window.shapes]
        )
        radius_m = shape_radius_m[window.shape] * stretch_of(window.world_T_shape)
        at_m = window.world_T_shape[:, :2, 3].copy()
        rows = np.array([row for _, _, row in window.tiles], np.uint32)
        # The own shape of each tile is at its first surface.
        own_shapes = np.flatnonzero(np.isin(window.first_surface, rows) & window.far)
        for place, (ix, iy, _) in zip(own_shapes.tolist(), window.tiles, strict=True):
            lines = stem_lines(self._tiled.far_tile(ix, iy).stems, np.array([*at_m[place], 0.0]))
            ends_m = (
                np.concatenate([lines[:, :2] + lines[:, 3:5] * lines[:, 5:6], [[0.0, 0.0]]]) - _TILE_M / 2
            )
            at_m[place] += _TILE_M / 2
            radius_m[place] = norm(ends_m).max() + STRAY_M
        track_m = window.track_m[:, :2]
        reach_m = self._tiled.near_m + STRAY_M + radius_m + _aside_m(window)
        low_m, high_m = track_m.min(axis=0), track_m.max(axis=0)
        few = np.flatnonzero((np.maximum(low_m - at_m, at_m - high_m) <= reach_m[:, None]).all(axis=1))
        near = np.zeros(len(at_m), np.bool_)
        near[few] = distance_m(at_m[few], track_m) <= reach_m[few]
        return near[window.far]

    def tiles(self, window: TiledWindow) -> dict[Name, FarTile]:
        """Return the tiles of a window and their neighbours, with their shapes measured."""
        around = sorted({(ix + dx, iy + dy) for ix, iy, _ in window.tiles for dx, dy in _AROUND})
        far_tile = self._tiled.far_tile
        new = [name for name in around if name not in self._measured]
        made = dict(zip(new, self._workers.map(lambda name: far_tile(*name), new), strict=True))
        self._measure(made.values())
        self._measured.update(new)
        return {name: made.get(name) or far_tile(*name) for name in around}

    def medium(self, window: TiledWindow, tiles: dict[Name, FarTile]) -> Medium:
        """Put together the medium of a window from its `tiles`."""
        rows = {(ix, iy): row for ix, iy, row in window.tiles}
        self._shelf.clear(rows)
        missing = [name for name in rows if name not in self._shelf.blocks]
        made = self._workers.map(lambda name: self._block(tiles, *name), missing)
        for name, block in zip(missing, made, strict=True):
            self._shelf.put(name, block, len(rows))
        medium = self._assemble(window, tiles, rows)
        self._shelf.keep(medium.brick, rows)
        return medium

    def _assemble(
        self, window: TiledWindow, tiles: Mapping[Name, FarTile], rows: Mapping[Name, int]
    ) -> Medium:
        blocks = {name: self._shelf.blocks[name] for name in rows}
        places = np.array(list(rows))
        low, high = places.min(axis=0), places.max(axis=0) + 1
        bottom = min(block.bottom for block in blocks.values())
        top = max(block.bottom + block.mask.shape[2] for block in blocks.values())
        size = (*((high - low) * _BRICKS).tolist(), top - bottom)
        brick = np.zeros((*size, 2), np.uint64)
        surface = np.zeros((*(high - low), 9), np.uint32)
        for (ix, iy), block in blocks.items():
            i, j, k = (ix - low[0]) * _BRICKS, (iy - low[1]) * _BRICKS, block.bottom - bottom
            bricks = slice(i, i + _BRICKS), slice(j, j + _BRICKS), slice(k, k + block.mask.shape[2])
            brick[(*bricks, 0)] = block.mask
            brick[(*bricks, 1)] = block.first
            surface[ix - low[0], iy - low[1]] = [rows.get((ix + dx, iy + dy), 0) for dx, dy in _AROUND]
        corner = np.array([*(low * COLUMNS), bottom * BRICK], np.int64)
        corner_m = corner * VOXEL_M - window.origin_m
        return Medium(
            self._tiled.near_m,
            tuple(corner_m.tolist()),
            tuple(corner.tolist()),
            brick,
            *self._shelf.arrays,
            surface,
            self._cosine,
            _ground(window, tiles, rows, corner_m, size),
            _stems(window, tiles, rows),
            self._tiled.seed & 0xFFFFFFFF,
        )

    def _block(self, tiles: dict[Name, FarTile], ix: int, iy: int) -> Block:
        library = self._library
        place = self._place
        names = self._names
        world = self._tiled.name
        return recall(
            world and f"{world} block {ix} {iy}",
            lambda: block_of(library, place, tiles, ix, iy),
            lambda block: pack_block(block, library, names),
            lambda kept: unpack_block(kept, library, dict(zip(names, range(len(names)), strict=True))),
        )

    def _measure(self, tiles: Iterable[FarTile]) -> None:
        new = dict[ShapeKey, U1]()
        for tile in tiles:
            for number, key in enumerate(tile.keys):
                if key not in self._clouds:
                    new[key] = tile.part[tile.first_part[number] : tile.first_part[number + 1]]
        if not new:
            return

        def measure(shape: tuple[ShapeKey, U1]) -> Cloud:
            """Measure the cloud of a shape, or recall it from disk."""
            key, parts = shape
            name = self._tiled.shape_name(key)
            return recall(
                name and f"cloud {name} {parts.tolist()}",
                lambda: cloud_of(self._tiled.shape(key), parts, self._tiled.core(key)),
            )

        self._clouds |= dict(zip(new, self._workers.map(measure, new.items()), strict=True))
        self._place = {key: number for number, key in enumerate(self._clouds)}
        self._names = [self._tiled.shape_name(key) for key in self._clouds]
        clouds = list(self._clouds.values())
        self._library = Library.of(clouds)
        self._cosine = np.concatenate([self._cosine[:0], *(cloud.cosine for cloud in clouds)])

    def _is_reached(self, window: TiledWindow, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask of the `kept` placements that light may meet before the medium."""
        part = _part(window, kept)
        radius_m = np.array([mesh.radius_m for mesh in self._await_shapes(part, self._start_shapes(part))])
        reach_m = self._tiled.near_m + STRAY_M + stretch_of(part.world_T_shape) * radius_m[part.shape]
        reach_m += _aside_m(part)
        return distance_m(part.world_T_shape[:, :2, 3], window.track_m[:, :2]) <= reach_m


def _aside_m(window: Window) -> F8:
    """Return the greatest movement (n,) of the placements of a window at their tops."""
    aside_m = np.zeros(len(window.shape))
    if (sway := window.sway) is not None:
        aside_m[sway.placement] = hypot(sway.top_m[..., 0], sway.top_m[..., 1]).max(axis=0)
    return aside_m


def _part(window: Window, keep: NDArray[np.bool_]) -> Window:
    used, shape = np.unique(window.shape[keep], return_inverse=True)
    return Window(
        origin_m=window.origin_m,
        shapes=tuple(window.shapes[number] for number in used.tolist()),
        shape=shape.astype(np.int32),
        world_T_shape=window.world_T_shape[keep],
        first_surface=window.first_surface[keep],
        surfaces=window.surfaces,
        sway=window.sway and window.sway.of_part(keep),
    )


def far_caster(world: World, workers: Executor) -> FarCaster:
    """Make the caster of a world with a far medium; GeometryError for a world without far squares."""
    if not isinstance(world, TiledWorld):
        found = f"found near_m = {world.near_m:g} in a world of the class {type(world).__name__}"
        raise GeometryError("world", found, "near_m = inf, or a world with `far_tile`")
    return FarCaster(world, workers)
