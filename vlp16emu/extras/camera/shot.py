"""Images: rays through pixels, their hits, and the light on them.

Colours need no second renderer: the camera's rays, and rays from what they meet to the sun, are cast like the
sensor's pulses.
"""

from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec, norm
from vlp16emu.engine import Engine, mounts_of
from vlp16emu.engine.windows import windows_of, workers
from vlp16emu.extras.camera import light
from vlp16emu.extras.camera.grain import grain, grain_table
from vlp16emu.extras.camera.lens import Lens
from vlp16emu.extras.camera.mount import camera_mount, camera_of, optical
from vlp16emu.extras.colours import surface_colours
from vlp16emu.forest.plants.species import flora
from vlp16emu.motion.mount import device_motion
from vlp16emu.motion.settings import Mount
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry
from vlp16emu.raycast.settings import Beam
from vlp16emu.raycast.texture import add_texture
from vlp16emu.types import (
    F4,
    F8,
    I8,
    NO_SURFACE,
    SURFACE,
    U1,
    U4,
    AnyArray,
    Firings,
    Hits,
    PlantPart,
    Semantic,
)
from vlp16emu.units import S_NS

_RAYS = 8  # rays that are cast together
_TOGETHER = 1 << 12  # pixels of a thread's job: some 50 ms, so that a run ends soon
_NEAR_M = 0.05  # beginning of the camera's rays, in front of its housing
_SUN_RAYS = Footprint(Beam(model="adaptive", rays=_RAYS, spot_mm=(0.0, 0.0), divergence_mrad=(9.3, 9.3)))
"""Rays to the sun's disc: its radius is 4.65 mrad, half of it the deviation of a uniform disc along an axis.
A beam's divergence is four deviations."""
_HIGHEST_M = 60.0  # range of rays to the sun, beyond the highest trees
_OFF_M = 0.25  # beginning of rays to the sun, outside what they start from: half a voxel of the far medium
_BACK_M = 0.02  # towards the camera
_SHADOW_PX = 2  # pixels between the places at which shadow is cast; between them it is interpolated

_T = TypeVar("_T")


class Shot(NamedTuple):
    """One image."""

    t_ns: int  # UTC of its middle row
    world_T_camera: F8  # (4, 4) at that time; camera axes x right, y down, z forward
    rgb: U1  # (height, width, 3)
    depth_m: F4  # (height, width) along the optical axis; 0 where nothing is met
    semantic: U1  # (height, width) `Semantic`
    part: U1  # (height, width) `PlantPart`
    instance: U4  # (height, width) as in labels of points


class View(NamedTuple):
    """Hits of the n rays of an image, row by row."""

    origin_m: F8  # (n, 3)
    direction: F8  # (n, 3)
    t_ns: I8  # (n,)
    range_m: F4  # (n,) inf where nothing is met
    surface: U4  # (n,)
    cosine: F4  # (n,) of incidence
    texture: F4  # (n,) factor on brightness that the lidar sees too


class Photographer:
    """A camera on the carrier of a run.

    Its windows are its own, as they depend on its path; the geometry in them is shared with the run's.

    Parameters
    ----------
    engine : of the run, whose stop ends it too; a scene without a camera gets the default one
    samples : rays of a pixel's colour along each axis; depth and labels are always those of its middle

    Raises InputError if the camera's distortion cannot be inverted over the whole image.
    """

    def __init__(self, engine: Engine, samples: int = 1) -> None:
        scenario = engine.scenario
        parts = engine.parts
        self.engine = engine
        self.section = camera_of(scenario)
        self.lens = Lens.of(self.section)
        base = scenario.motion.under_sensors(parts.carrier)
        self.motion = device_motion(base, camera_mount(scenario), scenario.start_ns)
        alone = replace(parts, units=(replace(parts.units[0], motion=self.motion),))
        windows = windows_of(alone, scenario.start_ns, engine.batching, engine.threads)
        self.windows = windows.stopped_by(engine.windows.stop)
        self._species = flora(getattr(scenario.world, "species_file", None)).names
        self._samples = samples
        # The world is laid out for the sensors' range: a camera on a longer arm sees less far.
        longest_m = max(_arm_m(mount) for mount in mounts_of(scenario))
        self.far_m = max(scenario.sensor.max_range_m - max(_arm_m(self.section.mount) - longest_m, 0.0), 1.0)
        self._rays = {fine: self._grid(fine) for fine in {1, samples}}

    @property
    def step_ns(self) -> int:
        """Time from one image to the next."""
        return max(round(S_NS / self.section.rate_hz), 1)

    def take(self, t_ns: int) -> Shot:
        """Take the image whose middle row is exposed at a UTC instant.

        Raises CancelledError if the run is stopped.
        """
        since_ns = t_ns - self.engine.scenario.start_ns
        geometry = self.windows.wait(self.windows.at_time(since_ns))
        view = self._view(geometry, t_ns, 1)
        shape = self.lens.height, self.lens.width
        fine = self._samples
        seen = self._light(geometry, view if fine == 1 else self._view(geometry, t_ns, fine), fine)
        seen = _mean(seen, shape, fine)
        pose = self.pose(t_ns)
        surfaces = np.append(geometry.surfaces, np.zeros(1, SURFACE))  # the last row is that of no surface
        row = np.minimum(view.surface, len(geometry.surfaces))
        along = self._rays[1][:, 2]
        depth_m = np.where(view.surface == NO_SURFACE, 0.0, view.range_m * along)
        return Shot(
            t_ns,
            pose,
            light.tone_map(seen).reshape(*shape, 3),
            depth_m.astype(np.float32).reshape(shape),
            surfaces["semantic"][row].reshape(shape),
            surfaces["part"][row].reshape(shape),
            surfaces["instance"][row].reshape(shape),
        )

    def pose(self, t_ns: int) -> F8:
        """Return world_T_camera (4, 4) at a UTC instant, with the axes of `Shot`."""
        poses = self.motion.poses_at(np.array([t_ns]))
        T = np.eye(4)
        T[:3, :3] = optical(poses.world_R_body[0])
        T[:3, 3] = poses.world_p_body_m[0]
        return T

    def row_times_ns(self, t_ns: int, rows: F8) -> I8:
        """Return UTC (n,) of places (n,) along the columns of an image."""
        last = max(self.lens.height - 1, 1)
        offset_s = (rows - (self.lens.height - 1) / 2.0) / last * self.section.readout_s
        return t_ns + np.rint(offset_s * S_NS).astype(np.int64)

    def _grid(self, fine: int) -> F8:
        """Return directions (n, 3) in the camera's axes through `fine` by `fine` places of each pixel."""
        columns, rows = (_places(size, fine) for size in (self.lens.width, self.lens.height))
        x, y = np.meshgrid(columns, rows)
        return self.lens.rays(x.ravel(), y.ravel())

    def _view(self, geometry: Geometry, t_ns: int, fine: int) -> View:
        """Cast the rays of an image."""
        rays = self._rays[fine]
        width = self.lens.width * fine
        row_ns = self.row_times_ns(t_ns, _places(self.lens.height, fine))
        poses = self.motion.poses_at(row_ns if self.section.readout_s else row_ns[:1])
        pose_of = np.repeat(np.minimum(np.arange(len(row_ns)), len(poses.t_ns) - 1), width)
        t = np.repeat(row_ns, width)

        def part(n: slice) -> tuple[AnyArray, ...]:
            direction = matvec(optical(poses.world_R_body)[pose_of[n]], rays[n])
            origin_m = poses.world_p_body_m[pose_of[n]]
            firings, hits = self._cast(geometry, t[n], origin_m, direction)
            cosine = hits.cos_incidence.copy()
            add_texture(firings, hits, geometry.surfaces, self.engine.parts.world.seed)
            texture = hits.cos_incidence / np.maximum(cosine, np.float32(1e-6))
            size = len(direction)
            return (
                origin_m,
                direction,
                *(values[:size] for values in (hits.range_m, hits.surface, cosine, texture)),
            )

        parts = zip(*self._in_parts(part, len(rays)), strict=True)
        origin_m, direction, *met = (np.concatenate(column) for column in parts)
        return View(origin_m, direction, t, *met)

    def _in_parts(self, work: Callable[[slice], _T], count: int) -> list[_T]:
        """Return the results of work on parts of n pixels, in order; the parts depend on nothing else."""
        if self.windows.stop.is_set():
            raise CancelledError
        with workers(self.engine.threads, "image", self.windows.stop) as pool:
            parts = [slice(first, min(first + _TOGETHER, count)) for first in range(0, count, _TOGETHER)]
            futures = [pool.submit(work, part) for part in parts]
            return [self.windows.wait(future) for future in futures]

    def _cast(
        self, geometry: Geometry, t_ns: I8, origin_m: F8, direction: F8, sun: F8 | None = None, first: int = 0
    ) -> tuple[Firings, Hits]:
        """Cast n rays, or with `sun` pulses as wide as the sun, the last repeated up to a multiple of 8."""
        ray_of = np.minimum(np.arange(len(t_ns) + -len(t_ns) % _RAYS), len(t_ns) - 1)
        shape = len(ray_of), 1
        level = None
        if sun is not None:
            level = np.broadcast_to(_across(sun), (*shape, 3)).copy()
        firings = Firings(
            first,
            t_ns[ray_of, None],
            np.zeros(len(ray_of), np.int64),
            np.zeros(shape),
            np.zeros(len(ray_of)),
            origin_m[ray_of, None],
            direction[ray_of, None],
            level,
        )
        if sun is not None:
            return firings, geometry.as_far.cast(firings, np.zeros(1), _HIGHEST_M, _SUN_RAYS)
        return firings, geometry.cast(firings, np.array([_NEAR_M]), self.far_m)

    def _light(self, geometry: Geometry, view: View, fine: int) -> F8:
        """Return the light (n, 3) that the rays of an image bring."""
        scenario = self.engine.scenario
        is_met = view.surface != NO_SURFACE
        sun = None
        if scenario.world.kind != "hall":
            gps = scenario.gps
            sun = light.sun_direction(int(view.t_ns[0]), gps.latitude_deg, gps.longitude_deg)
        place_m = view.origin_m + view.direction * np.where(is_met, view.range_m, 0.0)[:, None]
        shape = self.lens.height * fine, self.lens.width * fine
        normal = _normals(place_m, np.where(is_met, view.range_m, np.inf), view.direction, shape)
        met = np.flatnonzero(is_met)
        rows = view.surface[met]
        colours, grains, is_leaf = self._looks(geometry)
        pixel_m = view.range_m[met].astype(np.float64) / (self.lens.fx * fine)
        shades = view.texture[met] * grain(place_m[met], pixel_m, rows, grains)
        albedo = np.minimum(colours[rows] * shades[:, None], 1.0)
        surface = light.Facing(normal[met], view.cosine[met], is_leaf[rows])
        if sun is None:
            lit = light.by_lamp(albedo, surface)
        else:
            share = self._sun_share(geometry, view, place_m, is_met, sun, fine)[met] if sun[2] > 0.0 else None
            lit = light.by_day(albedo, surface, sun, share)
            lit = light.with_haze(lit, view.range_m[met])
        seen = light.sky(view.direction, sun, wooded=scenario.world.has_trees)
        seen[met] = lit
        return seen

    def _looks(self, geometry: Geometry) -> tuple[F8, F8, NDArray[np.bool_]]:
        """Return colours (m, 3), grain (m, 5) and a mask (m,) of leaves of the surfaces of a window."""
        surfaces = geometry.surfaces
        is_leaf = (surfaces["part"] == PlantPart.LEAF) | (surfaces["semantic"] == Semantic.GRASS)
        colours = light.linear(surface_colours(surfaces, self._species))
        return colours, grain_table(surfaces, self._species), is_leaf

    def _sun_share(
        self, geometry: Geometry, view: View, place_m: F8, is_met: NDArray[np.bool_], sun: F8, fine: int
    ) -> F8:
        """Return the visible share (n,) of the sun, cast at some pixels and interpolated in the world."""
        height, width = self.lens.height * fine, self.lens.width * fine
        step = _SHADOW_PX * fine
        rows, columns = (np.arange(0, size, step) for size in (height, width))
        chosen = (rows[:, None] * width + columns).ravel()
        cast = chosen[is_met[chosen]]
        start_m = place_m[cast] - view.direction[cast] * _BACK_M + sun * _OFF_M
        towards = np.broadcast_to(sun, start_m.shape)

        def part(n: slice) -> F8:
            _, hits = self._cast(geometry, view.t_ns[cast[n]], start_m[n], towards[n], sun, n.start)
            return (hits.surface == NO_SURFACE).reshape(-1, _RAYS)[: len(start_m[n])].sum(axis=1) / _RAYS

        share = np.ones(height * width)
        if len(cast):
            share[cast] = np.concatenate(self._in_parts(part, len(cast)))
        row_of = np.arange(height) // step
        column_of = np.arange(width) // step
        total = np.zeros(height * width)
        weights = np.zeros(height * width)
        pixel_m = np.where(is_met, view.range_m, 1.0) / (self.lens.fx * fine)
        for down in (0, 1):
            for right in (0, 1):
                i = rows[np.minimum(row_of + down, len(rows) - 1)]
                j = columns[np.minimum(column_of + right, len(columns) - 1)]
                neighbour = (i[:, None] * width + j).ravel()
                off_m = norm(place_m[neighbour] - place_m)
                weight = is_met[neighbour] / (pixel_m * pixel_m + off_m * off_m)
                total += weight * share[neighbour]
                weights += weight
        return np.divide(total, weights, out=share, where=weights > 0.0)


def _arm_m(mount: Mount) -> float:
    return float(norm(np.array(mount.lever_arm_m)))


def _places(size: int, fine: int) -> F8:
    """Return the coordinates of `fine` places in each of a number of pixels."""
    return (np.arange(size * fine) + 0.5) / fine - 0.5


def _across(direction: F8) -> F8:
    """Return a unit vector at right angles to a direction (3,), level unless that is vertical."""
    level = np.array([-direction[1], direction[0], 0.0])
    length = norm(level)
    return level / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])


def _mean(seen: F8, shape: tuple[int, int], fine: int) -> F8:
    """Return the means (n, 3) over the places of each pixel, summed in order."""
    height, width = shape
    cells = seen.reshape(height, fine, width, fine, 3)
    total = np.zeros((height, width, 3))
    for i in range(fine):
        for j in range(fine):
            total += cells[:, i, :, j]
    return total.reshape(-1, 3) / (fine * fine)


def _normals(place_m: F8, range_m: F8, direction: F8, shape: tuple[int, int]) -> F8:
    """Return normals (n, 3) from neighbouring pixels, along each axis the one at the more similar range."""
    down, right = (_difference(place_m.reshape(*shape, 3), range_m.reshape(shape), axis) for axis in (0, 1))
    normal = np.cross(down, right).reshape(-1, 3)
    normal /= np.maximum(norm(normal), 1e-12)[:, None]
    facing = normal[:, 0] * direction[:, 0] + normal[:, 1] * direction[:, 1] + normal[:, 2] * direction[:, 2]
    return np.where((facing > 0.0)[:, None], -normal, normal)


def _difference(place_m: F8, range_m: F8, axis: int) -> F8:
    """Return the difference (h, w, 3) to a pixel's neighbour along an axis."""
    step_m = np.diff(place_m, axis=axis)
    with np.errstate(invalid="ignore"):  # between two rays that meet nothing
        gap_m = np.nan_to_num(np.abs(np.diff(range_m, axis=axis)), nan=np.inf)
    after, before = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
    after[axis] = (0, 1)
    before[axis] = (1, 0)
    is_after = np.pad(gap_m, after, constant_values=np.inf) <= np.pad(gap_m, before, constant_values=np.inf)
    steps = np.pad(step_m, [*after, (0, 0)]), np.pad(step_m, [*before, (0, 0)])
    return np.where(is_after[..., None], *steps)
