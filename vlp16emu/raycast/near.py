"""Scenes of windows: what is near as faces in Embree, what is far as a medium; shapes are kept from window to window."""

import threading
import weakref
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast import embree as rtc
from vlp16emu.raycast.batch import PulseBatch, batch_of
from vlp16emu.raycast.beam import FARTHEST, LINE, BeamModel, Footprint, beam_axis_of
from vlp16emu.raycast.build import EmbreeMesh, Placed
from vlp16emu.raycast.displace import displace
from vlp16emu.raycast.faces import inverses, relative_to_window
from vlp16emu.raycast.far import NO_MEDIUM, Far, recalled_shape
from vlp16emu.raycast.kernel import cast_lines, cast_pulses
from vlp16emu.raycast.lanes import Medium
from vlp16emu.raycast.packet import PACKET, Target, ray_packet
from vlp16emu.raycast.pieces import LEVEL, STRAY_M, within_reach
from vlp16emu.types import Firings, Hits, ShapeKey, Window, World
from vlp16emu.world.polyline import distance_m

_SECTOR_DEG = 1.6
"""What is near in one direction stays in the cache from revolution to revolution: with eight of them a fifth less time for
one ray per pulse in `scenes/reference_forest`, a seventh for an adaptive beam. Sectors of 12 degrees gain half of that."""

_LEVEL = float(LEVEL) - 1e-4
"""Where pulses are all less steep than this, so are their rays in float32."""


class EmbreeGeometry:
    """A window ready to be cast against; any number of threads may cast at once.

    Parameters
    ----------
    near, beyond : what is cast as faces up to where the medium begins, and at any range beyond
    """

    def __init__(self, near: Placed, beyond: Placed | None = None, medium: Medium = NO_MEDIUM) -> None:
        self.meshes, self.surfaces, self.medium = near.meshes, near.window.surfaces, medium
        self._placed, self._building = near, threading.Lock()
        self._met, level = within_reach(near.window, near.placement, near.boxes_m, medium.near_m)
        self._near = _target(near, level)
        if level.sum() < self._met.sum():
            self._near = self._near._replace(steep=0)
        self._kept = beyond
        self._beyond = _target(beyond) if beyond else self._near._replace(scene=0, steep=0)

    def _target(self, rise: float) -> Target:
        """Give what is near, with all that rays meet which rise or fall by so much per metre."""
        if rise > _LEVEL:
            with self._building:
                if not self._near.steep:
                    self._near = self._near._replace(steep=self._placed.scene(self._met))
        return self._near

    def cast(
        self,
        firings: Firings,
        near_m: NDArray[np.float64],
        far_m: float,
        beam: Footprint = LINE,
        *,
        as_far: bool = False,
    ) -> Hits:
        """Cast pulses.

        Parameters
        ----------
        firings : k sequences, k a multiple of 8, with `beam_axis` where the beam has a width
        near_m : (L,) range at which each laser's light begins
        far_m : range at which it is given up
        beam : how wide a pulse is
        as_far : whether also what is near is cast as the medium that it is from afar, where there is one

        Raises
        ------
        ValueError
            where the firings are not as said above
        """
        shape = firings.t_ns.shape
        if shape[0] % PACKET:
            raise ValueError(f"cast: found {shape[0]} sequences, expected a multiple of {PACKET}")
        medium = self.medium
        if as_far and np.isfinite(medium.near_m):
            medium = medium._replace(near_m=0.0)
        reach_m, lasers = min(far_m, medium.near_m), shape[1]
        pulses = PulseBatch(
            firings.origin_m,
            firings.direction,
            beam_axis_of(firings, beam) if beam.has_width else np.empty((0, 0, 0)),
            self._placed.motion.times(firings.t_ns),
            near_m,
            float(reach_m),
            float(far_m),
            _by_sectors(firings.azimuth_deg),
            beam.sigmas.astype(np.float32),
            beam.seed,
            firings.index,
        )
        lean = FARTHEST * beam.sigmas[2:].max()
        rise = float(np.abs(firings.direction[..., 2]).max(initial=0.0) + lean)
        near = self._target(rise) if reach_m > 0.0 else self._beyond
        world = (near, self._beyond, medium) if reach_m < far_m else (near, None, None)
        room = ray_packet(), batch_of(PACKET * lasers, beam.budget.most if beam.has_width else 1)
        if beam.has_width:
            count = np.empty(shape, np.uint16)
            return Hits(count, *cast_pulses(*world, pulses, *room, beam.budget, count))
        met = np.empty(shape, np.float32), np.empty(shape, np.uint32), np.empty(shape, np.float32)
        cast_lines(*world, pulses, *room, *met)
        if beam.model is BeamModel.OFFSET:
            displace(met[0], beam, firings.index)
        return Hits.one_ray_each(*met)


def _target(placed: Placed, kept: NDArray[np.bool_] | None = None) -> Target:
    """Build the scene of some pieces of a window, or of all."""
    window, placement, motion = placed.window, placed.placement, placed.motion
    scene = placed.scene(np.ones(len(placement), np.bool_) if kept is None else kept)
    return Target(
        scene,
        scene,
        window.origin_m,
        window.first_surface[placement],
        inverses(relative_to_window(window))[placement],
        placed.row,
        placed.buffers,
        np.ascontiguousarray(motion.shear[:, placement]),
        motion.foot_m[placement] if motion.span_ns else motion.foot_m,
        np.ascontiguousarray(window.surfaces["reflectance"]),
    )


def _by_sectors(azimuth_deg: NDArray[np.float64]) -> NDArray[np.int64]:
    """First sequence of each packet, (k / 8,), so that revolutions go through a sector one after the other."""
    sector = (azimuth_deg[::PACKET, 0] / _SECTOR_DEG).astype(np.int64)
    return np.argsort(sector, kind="stable") * PACKET


class EmbreeCaster:
    """Opens windows, building only what no open window has yet.

    Parameters
    ----------
    world : describes what is far, and grows the meshes of shapes
    workers : where shapes are grown and built side by side
    """

    def __init__(self, world: World, workers: Executor) -> None:
        self._world, self._workers = world, workers
        self._far = Far(world, workers)
        self._solids: weakref.WeakValueDictionary[ShapeKey, EmbreeMesh] = weakref.WeakValueDictionary()
        self._lock = threading.Lock()

    def open(self, window: Window) -> EmbreeGeometry:
        """Make a window ready for casting.

        Raises
        ------
        RunError
            where Embree reports an error, for instance that memory ran out
        """
        try:
            return self._opened(window)
        finally:
            rtc.give_memory_back()

    def _opened(self, window: Window) -> EmbreeGeometry:
        """Make a window ready for casting, one at a time."""
        with self._lock:
            if window.far is None or not np.isfinite(self._world.near_m):
                return EmbreeGeometry(self._placed(window))
            tiles = self._far.tiles(window)
            exact = ~window.far
            is_near = np.empty(len(window.shape), np.bool_)
            is_near[window.far] = self._far.is_near(window)
            is_near[exact] = self._reached(_part(window, exact))
            beyond = self._placed(_part(window, exact if window.low is None else exact & ~window.low))
            part = _part(window, is_near)
            begun = self._begun(part)  # while what is far is put together
            medium = self._far.medium(window, tiles)
            return EmbreeGeometry(self._placed(part, begun), beyond if beyond.meshes else None, medium)

    def _reached(self, window: Window) -> NDArray[np.bool_]:
        """Which placements (n,) may be met by light that has not yet come to the medium."""
        assert window.near is not None
        radius_m = np.array([mesh.radius_m for mesh in self._grown(window, self._begun(window))])
        stretch = np.sqrt(np.square(window.world_T_shape[:, :, :3]).sum(axis=1).max(axis=-1, initial=0.0))
        reach_m = self._world.near_m + STRAY_M + stretch * radius_m[window.shape]
        return distance_m(window.world_T_shape[:, :2, 3], window.near[:, :2]) <= reach_m

    def _begun(self, window: Window) -> list[EmbreeMesh | Future[EmbreeMesh]]:
        """Begin to grow the shapes of a window that no other has; all of them in order."""
        return [self._solids.get(key) or self._workers.submit(self._solid, key) for key in window.shapes]

    def _grown(self, window: Window, begun: Sequence[EmbreeMesh | Future[EmbreeMesh]]) -> list[EmbreeMesh]:
        meshes = [each.result() if isinstance(each, Future) else each for each in begun]
        self._solids.update(zip(window.shapes, meshes, strict=True))
        return meshes

    def _placed(
        self, window: Window, begun: Sequence[EmbreeMesh | Future[EmbreeMesh]] | None = None
    ) -> Placed:
        meshes = self._grown(window, self._begun(window) if begun is None else begun)
        return Placed(window, [meshes[which] for which in window.shape.tolist()], self._workers)

    def _solid(self, key: ShapeKey) -> EmbreeMesh:
        return EmbreeMesh(recalled_shape(self._world, key))


def _part(window: Window, keep: NDArray[np.bool_]) -> Window:
    """Take some placements of a window, and their shapes."""
    used, shape = np.unique(window.shape[keep], return_inverse=True)
    sway = window.sway
    if sway is not None:
        moves = keep[sway.placement]
        number = np.cumsum(keep) - 1
        sway = replace(
            sway,
            placement=number[sway.placement[moves]],
            foot_z_m=sway.foot_z_m[moves],
            shear=sway.shear[:, moves],
        )
    return replace(
        window,
        shapes=tuple(window.shapes[number] for number in used.tolist()),
        shape=shape.astype(np.int32),
        world_T_shape=window.world_T_shape[keep],
        first_surface=window.first_surface[keep],
        sway=sway,
        far=None,
        low=None,
    )
