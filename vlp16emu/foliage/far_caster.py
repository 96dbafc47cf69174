"""Casting of tiled windows: near faces by Embree, the far rest as a medium."""

import math
import threading
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import hypot, matvec
from vlp16emu.foliage.far import STRAY_M, Far
from vlp16emu.foliage.lanes import Medium, lanes
from vlp16emu.foliage.march import Passage
from vlp16emu.foliage.stems import seen
from vlp16emu.foliage.tiles import TiledWindow, TiledWorld
from vlp16emu.raycast.build import Placed
from vlp16emu.raycast.near import EmbreeCaster, EmbreeGeometry, Stages, target_of
from vlp16emu.raycast.packet import LEVEL, Target
from vlp16emu.types import F8, Window
from vlp16emu.world.polyline import distance_m

_LEVEL = float(LEVEL) - 1e-4
"""Slope below which the rays of a pulse are level in float32, too."""


class FarGeometry(EmbreeGeometry):
    """A window with a medium, ready to be cast against; any number of threads may cast at once.

    Parameters
    ----------
    near : what is cast as faces up to where the medium begins
    track_m : (t, 3) positions of the sensors that it is for
    beyond : what is cast as faces at any range beyond
    medium : what is far
    """

    def __init__(self, near: Placed, track_m: F8, beyond: Placed | None, medium: Medium) -> None:
        self._met, level = within_reach(near, track_m, medium.near_m)
        super().__init__(near, level)
        self.medium = medium
        self._kept, self._building = beyond, threading.Lock()
        if level.sum() < self._met.sum():
            self._near = self._near._replace(steep=0)
        self._beyond = target_of(beyond) if beyond else self._near._replace(scene=0, steep=0)

    def stages(self, far_m: float, rise: float, *, as_far: bool) -> Stages:
        """Return what rays meet up to a range that rise or fall by so much per metre, at most."""
        medium = self.medium._replace(near_m=0.0) if as_far else self.medium
        reach_m = min(far_m, medium.near_m)
        near = self._reached(rise) if reach_m > 0.0 else self._beyond
        if reach_m < far_m:
            return Stages(near, reach_m, self._beyond, Passage(medium, lanes(), seen(medium.stems)))
        return Stages(near, reach_m)

    def _reached(self, rise: float) -> Target:
        """Return the near faces; pieces that only steep rays meet are built for the first such ray."""
        if rise > _LEVEL:
            with self._building:
                if not self._near.steep:
                    self._near = self._near._replace(steep=self._placed.scene(self._met))
        return self._near


def within_reach(placed: Placed, track_m: F8, reach_m: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Find the pieces that light of some range may meet.

    Parameters
    ----------
    placed : n pieces
    track_m : (t, 3) positions of the sensors
    reach_m : range of the light

    Returns
    -------
    Those that any ray may meet (n,), and those that level ones may
    """
    window, placement = placed.window, placed.placement
    world_T_shape, half_m = window.world_T_shape[placement], np.diff(placed.boxes_m, axis=1)[:, 0] / 2
    at_m = matvec(world_T_shape[..., :3], placed.boxes_m[:, 0] + half_m) + world_T_shape[..., 3]
    half_m = matvec(np.abs(world_T_shape[..., :3]), half_m)
    low_m, high_m = at_m[:, 2] - half_m[:, 2], at_m[:, 2] + half_m[:, 2]
    aside_m = hypot(half_m[:, 0], half_m[:, 1])
    if (sway := window.sway) is not None:
        lean, foot_z_m = np.zeros((2, len(window.shape)))
        lean[sway.placement] = hypot(sway.shear[..., 0], sway.shear[..., 1]).max(axis=0)
        foot_z_m[sway.placement] = sway.foot_z_m
        foot_z_m = foot_z_m[placement]
        aside_m += lean[placement] * np.maximum(np.abs(low_m - foot_z_m), np.abs(high_m - foot_z_m))
    level_m = np.maximum(distance_m(at_m[:, :2], track_m[:, :2]) - aside_m, 0.0)
    sensors_m = track_m[:, 2]
    rise_m = np.maximum(np.maximum(low_m - sensors_m.max(), sensors_m.min() - high_m), 0.0)
    met = hypot(level_m, rise_m) <= reach_m + STRAY_M
    return met, met & (rise_m <= LEVEL * reach_m + STRAY_M)


class FarCaster(EmbreeCaster):
    """Opens windows with tiles; parameters as of `EmbreeCaster`, the world describes what is far, too."""

    def __init__(self, world: TiledWorld, workers: Executor) -> None:
        super().__init__(world, workers)
        self._near_m, self._far = world.near_m, Far(world, workers)

    def _opened(self, window: Window) -> EmbreeGeometry:
        if not isinstance(window, TiledWindow) or math.isinf(self._near_m):
            return super()._opened(window)
        tiles = self._far.tiles(window)
        exact = ~window.far
        is_near = np.empty(len(window.shape), np.bool_)
        is_near[window.far] = self._far.is_near(window)
        is_near[exact] = self._is_reached(window, exact)
        everywhere = _part(window, exact & ~window.low)
        beyond = self._placed(everywhere, self._begun(everywhere))
        part = _part(window, is_near)
        begun = self._begun(part)  # while what is far is put together
        medium = self._far.medium(window, tiles)
        near = self._placed(part, begun)
        return FarGeometry(near, window.track_m, beyond if beyond.meshes else None, medium)

    def _is_reached(self, window: TiledWindow, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which of some placements light may meet before it comes to the medium."""
        part = _part(window, kept)
        radius_m = np.array([mesh.radius_m for mesh in self._grown(part, self._begun(part))])
        stretch = np.sqrt(np.square(part.world_T_shape[:, :, :3]).sum(axis=1).max(axis=-1, initial=0.0))
        reach_m = self._near_m + STRAY_M + stretch * radius_m[part.shape]
        return distance_m(part.world_T_shape[:, :2, 3], window.track_m[:, :2]) <= reach_m


def _part(window: Window, keep: NDArray[np.bool_]) -> Window:
    used, shape = np.unique(window.shape[keep], return_inverse=True)
    sway = window.sway
    if sway is not None:
        moves = keep[sway.placement]
        number = np.cumsum(keep) - 1
        sway = replace(
            sway, placement=number[sway.placement[moves]], foot_z_m=sway.foot_z_m[moves], shear=sway.shear[:, moves]
        )
    return Window(
        origin_m=window.origin_m,
        shapes=tuple(window.shapes[number] for number in used.tolist()),
        shape=shape.astype(np.int32),
        world_T_shape=window.world_T_shape[keep],
        first_surface=window.first_surface[keep],
        surfaces=window.surfaces,
        sway=sway,
    )
