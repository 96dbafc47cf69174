"""Scenes of instanced shapes in Embree, kept from window to window."""

import threading
import weakref
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast import embree_library as rtc
from vlp16emu.raycast.adaptive import first_round, judged_to
from vlp16emu.raycast.baking import FEW_QUADS, Layout, Pile, baked, lay_out
from vlp16emu.raycast.embree_build import Grown, Solid, placed
from vlp16emu.raycast.embree_kernel import PACKET, cast_packets, cast_sub_rays
from vlp16emu.raycast.embree_sway import motion_of
from vlp16emu.raycast.embree_task import Light, Target, Wish
from vlp16emu.raycast.footprint import LINE, BeamModel, Footprint, across_of, displace, sub_rays
from vlp16emu.raycast.placement import normal_matrices, relative_to_window
from vlp16emu.raycast.slow import Met
from vlp16emu.types import Firings, Hits, Mesh, ShapeKey, Window

__all__ = ["EmbreeCaster", "EmbreeScene"]

T = TypeVar("T")

_SECTOR_DEG = 1.6
"""What is near in one direction stays in the cache from revolution to revolution: with eight of them a fifth less time for
one ray per pulse in `scenes/reference_forest`, a seventh for an adaptive beam. Sectors of 12 degrees gain half of that."""


class EmbreeScene:
    """A window ready to be cast against; any number of threads may cast at once.

    Parameters
    ----------
    solids : of the layout's piles, then of its instances
    """

    def __init__(self, window: Window, layout: Layout, solids: Sequence[Solid]) -> None:
        self._solids = solids
        self.surfaces = window.surfaces
        unturned = np.broadcast_to(np.eye(3, dtype=np.float32), (len(layout.piles), 3, 3))
        transforms = np.zeros((len(solids), 3, 4), np.float32)
        transforms[: len(layout.piles)] = np.concatenate(
            [unturned, (layout.origin_m - window.origin_m)[:, :, None]], axis=2
        )
        transforms[len(layout.piles) :] = relative_to_window(window)[layout.instances]
        self._motion, moving = motion_of(window, layout)
        scene = placed(solids, transforms, moving)
        weakref.finalize(self, rtc.library().rtcReleaseScene, scene)
        self._target = Target(
            scene,
            window.origin_m,
            np.append(layout.first_surface, window.first_surface[layout.instances]),
            np.concatenate([unturned, normal_matrices(window)[layout.instances]]),
            self._motion.shear,
            np.ascontiguousarray(window.surfaces["reflectance"]),
        )
        self._judged_m = judged_to(window.surfaces)

    def cast(
        self,
        firings: Firings,
        near_m: NDArray[np.float64],
        far_m: float,
        beam: Footprint = LINE,
        block: int | None = None,
    ) -> Hits:
        """Cast pulses.

        Parameters
        ----------
        firings : k sequences, k a multiple of 8, with `across` where the beam has a width
        near_m : (L,) range at which each laser's light begins
        far_m : range at which it is given up
        beam : how wide a pulse is. An adaptive one looks at neighbouring azimuths: always cast whole blocks.
        block : sequences of a block; all by default. Several at once take less time, for the same hits.

        Raises
        ------
        ValueError
            where the firings are not as said above
        """
        shape = firings.t_ns.shape
        if shape[0] % PACKET:
            raise ValueError(f"cast: found {shape[0]} sequences, expected a multiple of {PACKET}")
        match beam.model:
            case BeamModel.FIXED:
                wish = np.full(shape, beam.rays, np.uint16)
                empty = np.empty((0, 0), np.float32)
                return self._sub_rays(
                    firings, near_m, far_m, beam, wish, (empty, empty.view(np.uint32), empty)
                )
            case BeamModel.ANGLE:
                middle = self._middles(_disturbed(firings, beam), near_m, far_m)
            case BeamModel.ADAPTIVE:
                middle = self._middles(firings, near_m, min(self._judged_m, far_m))
                wish = first_round(firings, middle[0], middle[2], beam, block or shape[0])
                return self._sub_rays(firings, near_m, far_m, beam, wish, middle)
            case _:
                middle = self._middles(firings, near_m, far_m)
        if beam.model is BeamModel.OFFSET:
            displace(middle[0], beam, firings.index)
        return Hits.one_ray_each(*middle)

    def _middles(self, firings: Firings, near_m: NDArray[np.float64], far_m: float) -> Met:
        """Cast one ray per pulse: range, surface and cosine, (k, L) each."""
        shape, times = firings.t_ns.shape, self._motion.times(firings.t_ns)
        met = np.empty(shape, np.float32), np.empty(shape, np.uint32), np.empty(shape, np.float32)
        order = _by_sectors(firings.azimuth_deg)
        cast_packets(self._target, firings.origin_m, firings.direction, times, near_m, far_m, order, *met)
        return met

    def _sub_rays(
        self,
        firings: Firings,
        near_m: NDArray[np.float64],
        far_m: float,
        beam: Footprint,
        wish: NDArray[np.uint16],
        middle: Met,
    ) -> Hits:
        """Cast `wish` sub-rays per pulse, and more where they are not enough."""
        light = Light(
            firings.origin_m,
            firings.direction,
            across_of(firings, beam),
            self._motion.times(firings.t_ns),
            near_m,
            far_m,
            self._judged_m,
            beam.quarters,
            beam.seed,
            firings.index,
            _by_sectors(firings.azimuth_deg),
        )
        wanted = Wish(wish, beam.model is BeamModel.ADAPTIVE, beam.rays, beam.target_m, beam.resolution_m)
        count = np.empty(wish.shape, np.uint16)
        return Hits(count, *cast_sub_rays(self._target, light, wanted, middle, count))


def _disturbed(firings: Firings, beam: Footprint) -> Firings:
    """Pulses along their first sub-rays: the paper's error `angle`."""
    none, shape = np.zeros(firings.t_ns.shape, np.int64), firings.origin_m.shape
    origin_m, direction = sub_rays(firings, beam, none, none + 1)
    return replace(firings, origin_m=origin_m.reshape(shape), direction=direction.reshape(shape))


def _by_sectors(azimuth_deg: NDArray[np.float64]) -> NDArray[np.int64]:
    """First sequence of each packet, (k / 8,), so that revolutions go through a sector one after the other."""
    sector = (azimuth_deg[::PACKET, 0] / _SECTOR_DEG).astype(np.int64)
    return np.argsort(sector, kind="stable") * PACKET


class EmbreeCaster:
    """Opens windows, building only the shapes that no open window has yet.

    Parameters
    ----------
    shape : grows the meshes of a shape
    workers : where shapes are grown and built side by side
    """

    def __init__(self, shape: Callable[[ShapeKey], tuple[Mesh, ...]], workers: Executor) -> None:
        self._grow, self._workers = shape, workers
        self._grown: weakref.WeakValueDictionary[ShapeKey, Grown] = weakref.WeakValueDictionary()
        self._solids: weakref.WeakValueDictionary[ShapeKey, Solid] = weakref.WeakValueDictionary()
        self._lock = threading.Lock()

    def open(self, window: Window) -> EmbreeScene:
        """Make a window ready for casting.

        Raises
        ------
        RunError
            where Embree reports an error, for instance that memory ran out
        """
        with self._lock:
            grown = self._kept(self._grown, window.shapes, lambda key: Grown(self._grow(key)))
            few = np.array([grown[key].quads <= FEW_QUADS for key in window.shapes], np.bool_)
            layout = lay_out(window, few)
            names = [*layout.piles, *(window.shapes[i] for i in window.shape[layout.instances])]
            solids = self._kept(self._solids, names, lambda name: self._solid(name, grown))
            return EmbreeScene(window, layout, [solids[name] for name in names])

    def _kept(
        self, store: MutableMapping[ShapeKey, T], names: Sequence[ShapeKey], make: Callable[[ShapeKey], T]
    ) -> dict[ShapeKey, T]:
        """Things by name: those that some window still holds, and the others made side by side."""
        kept = {name: store.get(name) for name in dict.fromkeys(names)}
        missing = [name for name, thing in kept.items() if thing is None]
        fresh = dict(zip(missing, self._workers.map(make, missing), strict=True))
        store.update(fresh)
        return {name: thing or fresh[name] for name, thing in kept.items()}

    def _solid(self, name: ShapeKey, grown: Mapping[ShapeKey, Grown]) -> Solid:
        """Build a pile, or a shape for its instances."""
        if isinstance(name, Pile):
            parts = [grown[key] for key in name.keys]
            return Solid(baked(name, [part.faces for part in parts]), parts)
        return Solid(dict(enumerate(grown[name].faces)), [grown[name]])
