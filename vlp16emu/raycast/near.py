"""Windows as Embree scenes of faces; shapes are kept from window to window."""

import threading
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.doors import Part
from vlp16emu.raycast import embree as rtc
from vlp16emu.raycast.beam import FARTHEST, LINE, ROUND, Footprint, beam_axis_of
from vlp16emu.raycast.build import EmbreeMesh, Instances, inverses, relative_to_window, shape_of
from vlp16emu.raycast.kernel import Batch, Cast, PulseBatch, batch_of, cast_lines, cast_pulses, join_rounds
from vlp16emu.raycast.packet import PACKET, RayPacket, Target, ray_packet
from vlp16emu.store import recall
from vlp16emu.types import F4, F8, I8, U4, Firings, Hits, ShapeKey, Window, World
from vlp16emu.units import INCLUSIVE

_SECTOR_DEG = 1.6
"""Width of a sector, whose faces stay in the cache from revolution to revolution: over eight revolutions it
saves a fifth of the time for one ray per pulse in `scenes/reference_forest`, a seventh for an adaptive beam.
12 degrees save half."""


DISPLACE = Part[Callable[[F4, Footprint, int], None]]("vlp16emu.extras.displace:displace")
"""Function that displaces the points of hits with the beam error of LiDAR-Forest."""


class _Scratch(NamedTuple):
    """Memory of a cast, which a later cast takes over, on any thread: a step of a live run lasts 5 ms."""

    packet: RayPacket
    batch: Batch
    passage: tuple[object, ...]
    first_round: list[U4]  # one array, of the latest cast, as in `cast_pulses`

    def first_of(self, rays: int) -> U4:
        """Return an array (3, rays) for first rounds; pages of a new one would have to be cleared."""
        if not self.first_round or self.first_round[0].shape[1] != rays:
            self.first_round[:] = [np.empty((3, rays), np.uint32)]
        return self.first_round[0]


class EmbreeGeometry:
    """A window ready for casting by any number of threads.

    Parameters
    ----------
    near : placements that are cast as faces
    kept : (n,) mask of their pieces; None for all
    """

    lines: ClassVar[Callable[..., None]] = staticmethod(cast_lines)  # kernel for beams without width
    pulses: ClassVar[Callable[..., U4]] = staticmethod(cast_pulses)  # kernel for sub-rays

    def __init__(self, near: Instances, kept: NDArray[np.bool_] | None = None) -> None:
        self.meshes = near.meshes
        self.surfaces = near.window.surfaces
        self._instances = near  # keeps its scenes alive
        self._near = target_of(near, kept)
        self.idle = dict[tuple[int, int], list[_Scratch]]()  # by pulses and greatest number of rays

    @property
    def as_far(self) -> "EmbreeGeometry":
        """The same window: nothing in it is far."""
        return self

    def near_faces(self, rise: float, far_m: float) -> tuple[Target, float]:  # noqa: ARG002 - one for all
        """Return the near faces for rays with a slope of up to `rise`, and the range at which they end."""
        return self._near, far_m

    def passage(self, pulses: int) -> tuple[object, ...]:  # noqa: ARG002 - none without a medium
        """Return further arguments of the kernels that cast so many pulses together: none.

        They are for geometry behind the near faces.
        """
        return ()

    def cast(self, firings: Firings, near_m: F8, far_m: float, beam: Footprint = LINE) -> Hits:
        """Cast pulses.

        Parameters
        ----------
        firings : k sequences, k a multiple of 8, with `beam_axis` if the beam has a width
        near_m : (L,) range at which each laser's light begins
        far_m : farthest range
        beam : footprint of a pulse

        Raises ValueError for other firings.
        """
        shape = firings.t_ns.shape
        if shape[0] % PACKET:
            raise ValueError(f"cast: found {shape[0]} sequences, expected a multiple of {PACKET}")
        sigmas = beam.sigmas
        lean = FARTHEST * sigmas[2:].max()
        rise = float(np.abs(firings.direction[..., 2]).max(initial=0.0) + lean)
        far_m *= INCLUSIVE
        near, reach_m = self.near_faces(rise, far_m)
        pulses = PulseBatch(
            firings.origin_m,
            firings.direction,
            beam_axis_of(firings, beam) if beam.has_width else np.empty((0, 0, 0)),
            self._instances.motion.times(firings.t_ns),
            np.ascontiguousarray(near_m),
            float(reach_m),
            float(far_m),
            _by_sectors(firings.azimuth_deg),
            sigmas.astype(np.float32),
            beam.seed,
            firings.index,
        )
        max_rays = beam.budget.max_rays if beam.has_width else 1
        idle = self.idle.setdefault((PACKET * shape[1], max_rays), [])
        try:
            scratch = idle.pop()
        except IndexError:  # other threads have it
            together = PACKET * shape[1]
            scratch = _Scratch(ray_packet(), batch_of(together, max_rays), self.passage(together), [])
        hits = self._hits(Cast(near, pulses, scratch.packet, scratch.batch), scratch, beam)
        idle.append(scratch)
        return hits

    def _hits(self, cast: Cast, scratch: _Scratch, beam: Footprint) -> Hits:
        """Cast pulses, and return their hits."""
        shape = cast.light.time.shape
        if beam.has_width:
            count = np.empty(shape, np.uint16)
            budget = beam.budget
            first_round = scratch.first_of(count.size * min(ROUND, budget.max_rays))
            further = self.pulses(cast, *scratch.passage, budget, count, first_round)
            # Numpy's arrays are in huge pages; arrays made in kernels have a page fault every 4 kB.
            met_bits = np.empty((3, first_round.shape[1] + further.shape[1]), np.uint32)
            join_rounds(count, first_round, further, met_bits)
            return Hits(count, met_bits[0].view(np.float32), met_bits[1], met_bits[2].view(np.float32))
        met = np.empty(shape, np.float32), np.empty(shape, np.uint32), np.empty(shape, np.float32)
        self.lines(cast, *scratch.passage, *met)
        if beam.section.model == "offset":
            DISPLACE.load()(met[0], beam, cast.light.first)
        return Hits.one_ray_each(*met)


def target_of(instances: Instances, kept: NDArray[np.bool_] | None = None) -> Target:
    """Build the scene of selected pieces (n,), or of all."""
    window = instances.window
    placement = instances.placement
    motion = instances.motion
    scene = instances.scene(np.ones(len(placement), np.bool_) if kept is None else kept)
    return Target(
        scene,
        scene,
        window.origin_m,
        window.first_surface[placement],
        inverses(relative_to_window(window))[placement],
        instances.row,
        instances.buffers,
        motion.shear,
        motion.foot_m,
        window.surfaces["reflectance"].copy(),
    )


def _by_sectors(azimuth_deg: F8) -> I8:
    """Return starts of packets (k / 8,) by sector: all revolutions pass one sector before the next."""
    sector = (azimuth_deg[::PACKET, 0] / _SECTOR_DEG).astype(np.int64)
    return np.argsort(sector, kind="stable") * PACKET


_SolidKey = tuple[ShapeKey, bool]


class EmbreeCaster:
    """Opens windows; builds only shapes that no open window has.

    Parameters
    ----------
    world : grows the meshes of shapes
    workers : threads that grow and build shapes in parallel
    """

    def __init__(self, world: World, workers: Executor) -> None:
        self._world = world
        self._workers = workers
        self._solids: weakref.WeakValueDictionary[_SolidKey, EmbreeMesh] = weakref.WeakValueDictionary()
        self._lock = threading.Lock()

    def open(self, window: Window) -> EmbreeGeometry:
        """Make a window ready for casting.

        Raises RunError if Embree reports an error, for instance that memory ran out.
        """
        try:
            with self._lock:
                return self._geometry_of(window)
        finally:
            rtc.give_memory_back()

    def _geometry_of(self, window: Window) -> EmbreeGeometry:
        return EmbreeGeometry(self._instances(window, self._start_shapes(window)))

    def _start_shapes(self, window: Window) -> list[EmbreeMesh | Future[EmbreeMesh]]:
        """Return the shapes of a window in order, or futures of new shapes."""
        return [
            self._solids.get(key) or self._workers.submit(self._build_shape, *key)
            for key in _solid_keys(window)
        ]

    def _await_shapes(
        self, window: Window, started: Sequence[EmbreeMesh | Future[EmbreeMesh]]
    ) -> list[EmbreeMesh]:
        meshes = [mesh.result() if isinstance(mesh, Future) else mesh for mesh in started]
        self._solids.update(zip(_solid_keys(window), meshes, strict=True))
        return meshes

    def _instances(self, window: Window, started: Sequence[EmbreeMesh | Future[EmbreeMesh]]) -> Instances:
        return Instances(window, self._await_shapes(window, started), self._workers)

    def _build_shape(self, key: ShapeKey, bends: bool) -> EmbreeMesh:
        name = self._world.shape_name(key)
        world = self._world
        kind = "slabs" if bends else "faces"
        return EmbreeMesh(recall(name and f"{kind} {name}", lambda: shape_of(world.shape(key), bends=bends)))


def _solid_keys(window: Window) -> list[_SolidKey]:
    """Return the keys of the shapes of a window, with True for those that bend in it."""
    bends = np.zeros(len(window.shapes), np.bool_)
    if window.sway is not None:
        bends[window.shape[window.sway.placement]] = True
    return list(zip(window.shapes, bends.tolist(), strict=True))
