"""Images of a scene from the place of a sensor, each of one instant: depth, labels and colours, by the rays of the lidar."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.emulator import Emulator
from vlp16emu.engine import Unit, workers
from vlp16emu.errors import InputError
from vlp16emu.extras.images.pictures import PictureFolder
from vlp16emu.extras.palette import surface_colours
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.packets import DISTANCE_LSB_M
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import SURFACE, Firings, Hits, PlantPart, Poses, Semantic, World
from vlp16emu.units import S_NS, seconds_to_ns
from vlp16emu.world.furnished import Furnished

_BODY_R_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From camera (x right, y down, z forward) to sensor (x forward, y left, z up)."""
_SKY = (176, 204, 232)
_FROM_SKY, _FROM_CAMERA, _FROM_SUN = 0.35, 0.25, 0.4
"""Shares of light: from all around; from the camera, by the cosine of its incidence, so that shapes show; and from the sun, where
nothing is between. What is met has no normals, so sunlight knows no incidence."""
_UP, _AZIMUTH = math.radians(40), math.radians(150)
_SUN = np.array([math.cos(_UP) * math.sin(_AZIMUTH), math.cos(_UP) * math.cos(_AZIMUTH), math.sin(_UP)])
"""Direction in the world: in the south-south-east, 40 degrees high."""
_CLEAR_M = 0.02
"""Between what is met and where the way to the sun begins."""
_BAND = 1 << 16
"""Pixels cast at once, about; whole rows, whatever the threads."""
_LARGEST_PX = 16_384
_ALL_ROUND_DEG = 360.0
_LABELS = ("semantic", "part", "species", "instance")


class CameraKind(StrEnum):
    """How directions become pixels."""

    PANORAMA = "panorama"
    """All around, the same angle for each column and row (equirectangular)."""
    PINHOLE = "pinhole"
    """A plane at right angles to the optical axis, which is the sensor's azimuth 0."""


_USUAL = {CameraKind.PANORAMA: ((2048, 512), _ALL_ROUND_DEG), CameraKind.PINHOLE: ((1024, 768), 90.0)}
"""Size in pixels, and field of view, where none is wanted."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera without distortion, whose principal point is the middle of its image; InputError where there is none such."""

    kind: CameraKind
    width: int
    """Pixels, a multiple of 8, as rows are cast eight rays at a time."""
    height: int
    fov_deg: float
    """From the left edge to the right one; 360 of a panorama."""

    def __post_init__(self) -> None:
        size, is_panorama = f"found {self.width}x{self.height}", self.kind is CameraKind.PANORAMA
        if self.width % 8 or not 8 <= self.width <= _LARGEST_PX or not 1 <= self.height <= _LARGEST_PX:
            raise InputError("--size", size, f"at most {_LARGEST_PX} pixels, the width a multiple of 8")
        if is_panorama and 2 * self.height > self.width:
            raise InputError("--size", size, "a panorama at most half as high as wide, which is the sphere")
        if is_panorama != (self.fov_deg == _ALL_ROUND_DEG) or not (is_panorama or 1 <= self.fov_deg <= 170):
            expected = "360 of a panorama" if is_panorama else "a number of degrees from 1 to 170"
            raise InputError("--fov", f"found {self.fov_deg:g}", expected)

    @classmethod
    def of(cls, kind: str, size: tuple[int, int] | None = None, fov_deg: float | None = None) -> Self:
        """Make a camera of a kind; what is left out is as usual for it."""
        if kind not in tuple(CameraKind):
            raise InputError("--kind", f"found {kind}", " or ".join(CameraKind))
        usual_px, usual_deg = _USUAL[CameraKind(kind)]
        return cls(CameraKind(kind), *(size or usual_px), usual_deg if fov_deg is None else fov_deg)

    @property
    def focal_px(self) -> float:
        """Pixels per unit of X/Z of a pinhole camera, per radian of a panorama."""
        half_rad = math.radians(self.fov_deg) / 2
        return self.width / 2 / (math.tan(half_rad) if self.kind is CameraKind.PINHOLE else half_rad)

    def rays(self, rows: range) -> NDArray[np.float64]:
        """Give unit directions (rows * width, 3) in the camera through the middles of pixels, row by row."""
        u = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal_px
        v = (np.array(rows)[:, None] + 0.5 - self.height / 2) / self.focal_px
        u, v = np.broadcast_arrays(u, v)
        if self.kind is CameraKind.PINHOLE:
            xyz = np.stack([u, v, np.ones_like(u)], axis=-1)
            xyz /= np.linalg.norm(xyz, axis=-1, keepdims=True)
        else:
            xyz = np.stack([np.cos(v) * np.sin(u), np.sin(v), np.cos(v) * np.cos(u)], axis=-1)
        return xyz.reshape(-1, 3)


_SHORTEST_S = 0.001
"""Between two images."""


@dataclass(frozen=True, slots=True)
class ImageRun:
    """What a folder of images holds."""

    folder: str
    scene: str
    unit: int
    """Which sensor of a rig, from 1."""
    kind: str
    width: int
    height: int
    images: int
    bytes: int
    """Of all images."""
    interrupted: bool
    """Ended by its stop event."""


def write_images(
    emulator: Emulator,
    folder: str | Path,
    *,
    kind: str = "panorama",
    size: tuple[int, int] | None = None,
    fov_deg: float | None = None,
    every_s: float = 1.0,
    start_s: float = 0.0,
    duration_s: float | None = None,
    unit: int = 1,
    progress: Callable[[float], None] = lambda _: None,
    stop: Event | None = None,
) -> ImageRun:
    """Write depth, labels and colours as images from the place of a sensor, each of one instant.

    Parameters
    ----------
    folder : new or empty
    kind : "panorama" or "pinhole", which looks to the sensor's azimuth 0
    size : width and height in pixels; 2048 x 512 of a panorama, 1024 x 768 of a pinhole camera, if left out
    fov_deg : of a pinhole camera, from left to right; 90 if left out
    every_s : from image to image
    start_s, duration_s, progress, stop : as of `Emulator.record`
    unit : which sensor of a rig, from 1

    Raises
    ------
    InputError
        If there is no such unit or camera
    MissingExtraError
        If Pillow or OpenEXR is not there
    OutputError
        If the folder cannot be written, or is not empty
    TrajectoryError
        If the walk ends before the span does
    RunError
        If the disk is full; the images before are kept
    """
    if not every_s >= _SHORTEST_S:
        raise InputError("--every", f"found {every_s:g}", f"a number of seconds from {_SHORTEST_S:g}")
    engine, stop, camera = emulator.engine, stop or Event(), Camera.of(kind, size, fov_deg)
    scenario, of = engine.scenario, engine.parts.units[emulator.run.number(unit)]
    begin_ns, end_ns = engine.span_ns(*scenario.span_s(start_s, duration_s))
    windows, species = engine.windows, species_of(engine.parts.world)
    pictures = PictureFolder(Path(folder), _cameras(camera, species))
    with windows.stopped_by(stop), pictures, workers(engine.threads, "image", stop) as pool, suppress(CancelledError):
        for since_ns in range(begin_ns, end_ns, seconds_to_ns(every_s)):
            geometry = windows.wait(windows.at_time(since_ns))
            t_ns = np.array([scenario.start_ns + since_ns])
            body = of.motion.poses_at(t_ns)
            pose = Poses(t_ns, body.world_R_body @ _BODY_R_CAMERA, body.world_p_body_m)
            band = max(_BAND // camera.width, 1)
            rows = [range(r, min(r + band, camera.height)) for r in range(0, camera.height, band)]
            bands = list(pool.map(partial(_pixels, camera, pose, geometry, of, species), rows))
            rgb, depth_m, *labels = (np.concatenate(parts) for parts in zip(*bands, strict=True))
            pictures.add(pose, rgb, depth_m, dict(zip(_LABELS, labels, strict=True)))
            progress((since_ns - begin_ns) / S_NS)
            if stop.is_set():
                break
    written: dict[str, Any] = {"images": pictures.images, "bytes": pictures.bytes, "interrupted": stop.is_set()}
    size_px = camera.width, camera.height
    return ImageRun(str(folder), emulator.name, unit, camera.kind, *size_px, **written)


def species_of(world: World) -> dict[int, str]:
    """Give the names of species by number."""
    bare = world.bare if isinstance(world, Furnished) else world
    return dict(bare.plants.names) if isinstance(bare, ForestWorld) else {}


def _cameras(camera: Camera, species: Mapping[int, str]) -> dict[str, Any]:
    """Say what the images are: intrinsics, axes, units and the meaning of labels."""
    sensor_T_camera = np.eye(4)
    sensor_T_camera[:3, :3] = _BODY_R_CAMERA
    size: dict[str, Any] = {"kind": camera.kind, "width": camera.width, "height": camera.height}
    size |= {"fx": camera.focal_px, "fy": camera.focal_px, "cx": camera.width / 2, "cy": camera.height / 2}
    return size | {
        "shutter": "global",
        "depth": "along the optical axis" if camera.kind is CameraKind.PINHOLE else "along the ray",
        "depth_png_m": DISTANCE_LSB_M,
        "sensor_T_camera": sensor_T_camera.tolist(),
        "semantic": {int(one): one.name.lower() for one in Semantic},
        "part": {int(one): one.name.lower() for one in PlantPart},
        "species": dict(species),
    }


def _pixels(
    camera: Camera, pose: Poses, geometry: Geometry, unit: Unit, species: Mapping[int, str], rows: range
) -> tuple[NDArray[Any], ...]:
    """Colours, depth and labels of some rows of an image."""
    rays, shape = camera.rays(rows), (len(rows), camera.width)
    firings = Firings.rays(int(pose.t_ns[0]), pose.world_p_body_m[0], (rays @ pose.world_R_body[0].T)[:, None])
    hits = geometry.cast(firings, unit.head.beams.near_m[:1], unit.section.max_range_m)
    is_met = np.isfinite(hits.range_m)
    forward = rays[:, 2] if camera.kind is CameraKind.PINHOLE else 1.0
    depth_m = np.where(is_met, hits.range_m * forward, 0.0).astype(np.float32)
    surfaces = np.append(geometry.surfaces, np.zeros(1, SURFACE))  # the last row is that of `NO_SURFACE`
    met = surfaces[np.minimum(hits.surface, len(geometry.surfaces))]
    is_lit = _in_sun(firings, hits, geometry, unit) if species else np.ones(len(rays), np.bool_)
    rgb = _rgb(hits, geometry, species, is_met=is_met, is_lit=is_lit).reshape(*shape, 3)
    return rgb, depth_m.reshape(shape), *(met[name].reshape(shape) for name in _LABELS)


def _in_sun(firings: Firings, hits: Hits, geometry: Geometry, unit: Unit) -> NDArray[np.bool_]:
    """(n,) whether nothing is between what was met and the sun."""
    range_m = np.where(np.isfinite(hits.range_m), hits.range_m, 0.0).reshape(-1, 1)
    met_m = firings.origin_m[:, 0] + firings.direction[:, 0] * (range_m - _CLEAR_M)
    to_sun = Firings.rays(int(firings.t_ns[0, 0]), met_m[:, None], _SUN)
    between = geometry.cast(to_sun, np.array([_CLEAR_M]), unit.section.max_range_m)
    return ~np.isfinite(between.range_m)


def _rgb(
    hits: Hits, geometry: Geometry, species: Mapping[int, str], *, is_met: NDArray[np.bool_], is_lit: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Colours (n, 3) of what was met, in light and shade."""
    colours = surface_colours(geometry.surfaces, species)[hits.surface[is_met]]
    light = _FROM_SKY + _FROM_CAMERA * hits.cos_incidence[is_met, None] + _FROM_SUN * is_lit[is_met, None]
    rgb = np.tile(np.array(_SKY, np.uint8), (len(is_met), 1))
    rgb[is_met] = np.rint(colours * light)
    return rgb
