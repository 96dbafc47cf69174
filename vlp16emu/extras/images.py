"""Images of a scene from the place of a sensor, each of one instant: depth, labels and colours."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Unit, workers
from vlp16emu.errors import MissingExtraError, RunError
from vlp16emu.extras.camera import Camera, CameraKind, look
from vlp16emu.extras.meshes.furnished import Furnished
from vlp16emu.extras.options import ImageOptions
from vlp16emu.extras.outputs import OutputFolder
from vlp16emu.extras.plots import surface_colours
from vlp16emu.extras.truth.folder import tum_rows
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.output import write_json
from vlp16emu.packets import DISTANCE_LSB_M
from vlp16emu.raycast.caster import Geometry
from vlp16emu.run.emulator import Emulator
from vlp16emu.types import F4, SURFACE, U1, PlantPart, Poses, Semantic, World
from vlp16emu.units import S_NS, seconds_to_ns

LAYERS = {"rgb": np.uint8, "depth": np.uint16, "semantic": np.uint8, "part": np.uint8, "species": np.uint16}
"""Folders of PNG files and the type of their pixels; depth is in steps of 2 mm, as in packets."""
_POSES = "# t_utc_s x_m y_m z_m qx qy qz qw: world_T_camera; line n is image n; camera z forward, x right, y down\n"


class ImageFolder(OutputFolder):
    """A new or empty folder for the images of one run; after an error the images so far stay, without its name.

    Parameters
    ----------
    path : folder
    cameras : content of `cameras.json`
    """

    def __init__(self, path: Path, cameras: Mapping[str, Any]) -> None:
        try:
            import OpenEXR
            from PIL import Image
        except ImportError as error:
            library = "OpenEXR" if error.name == "OpenEXR" else "Pillow"
            raise MissingExtraError(library, "images", "writing images") from None
        self._exr, self._image = OpenEXR, Image
        self.images = self.bytes = 0
        super().__init__(path)
        for layer in (*LAYERS, "exr"):
            (self.path / layer).mkdir()
        write_json(self.path / "cameras.json", cameras)
        (self.path / "poses.tum").write_text(_POSES)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and self.images:
            self.leave()
        super().__exit__(kind, error, trace)

    def add(self, pose: Poses, rgb: U1, depth_m: F4, labels: Mapping[str, NDArray[Any]]) -> None:
        """Write one image, taken at a pose of the camera; RunError if it cannot be written.

        Parameters
        ----------
        rgb : (height, width, 3)
        depth_m : (height, width), 0 where nothing was met
        labels : (height, width) each: `semantic`, `part`, `species`, `instance`
        """
        name = f"{self.images:06d}"
        pixels = {"rgb": rgb, "depth": np.rint(depth_m / DISTANCE_LSB_M), **labels}
        channels = {"Z": depth_m} | {key: values.astype(np.uint32) for key, values in labels.items()}
        header = {"compression": self._exr.ZIP_COMPRESSION, "type": self._exr.scanlineimage}
        files = {layer: self.path / layer / f"{name}.png" for layer in LAYERS}
        files["exr"] = self.path / "exr" / f"{name}.exr"
        try:
            for layer, kind in LAYERS.items():
                self._image.fromarray(np.ascontiguousarray(pixels[layer], kind)).save(files[layer])
            with self._exr.File(header, {key: np.ascontiguousarray(of) for key, of in channels.items()}) as image:
                image.write(str(files["exr"]))
            with (self.path / "poses.tum").open("a") as poses:
                poses.write(tum_rows(pose))
        except (OSError, RuntimeError) as error:
            found = (error.strerror if isinstance(error, OSError) else None) or error
            raise RunError(f"{self.path}: image {name}: {found}; the images before it are whole") from error
        self.images += 1
        self.bytes += sum(path.stat().st_size for path in files.values())


_BODY_R_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From camera (x right, y down, z forward) to sensor (x forward, y left, z up)."""
_SKY = (176, 204, 232)
_FROM_SKY, _FROM_CAMERA, _FROM_SUN = 0.35, 0.25, 0.4
"""Shares of light: ambient; from the camera, by the cosine of incidence, so that shapes show; and from the sun where it is not
occluded. Casters return no normals, so sunlight knows no incidence."""
_UP, _AZIMUTH = math.radians(40), math.radians(150)
_SUN = np.array([math.cos(_UP) * math.sin(_AZIMUTH), math.cos(_UP) * math.cos(_AZIMUTH), math.sin(_UP)])
"""Direction to the sun in the world: in the south-south-east, 40 degrees high."""
_CLEAR_M = 0.02  # offset of shadow rays from the surface
_BAND = 1 << 16  # pixels cast at once, about: whole rows, independent of the number of threads
_LABELS = ("semantic", "part", "species", "instance")


@dataclass(frozen=True, slots=True)
class ImageRun:
    """Content of a folder of images."""

    folder: str
    scene: str
    unit: int  # which sensor of a rig, from 1
    kind: str
    width: int
    height: int
    images: int
    bytes: int  # of all images
    interrupted: bool  # ended by its stop event


def write_images(
    emulator: Emulator,
    folder: str | Path,
    *,
    progress: Callable[[float], None] = lambda _: None,
    stop: Event | None = None,
    **options: Any,
) -> ImageRun:
    """Write depth, labels and colours as images from the place of a sensor, each of one instant.

    Parameters
    ----------
    folder : new or empty
    progress, stop : as in `Emulator.record`
    options : fields of `ImageOptions`

    Raises InputError if there is no such unit or camera; MissingExtraError if Pillow or OpenEXR is not installed;
    OutputError if the folder cannot be written, or is not empty; TrajectoryError if the walk ends before the span;
    RunError if the disk is full; the images before are kept.
    """
    asked = ImageOptions(**options)
    engine, stop, camera = emulator.engine, stop or Event(), Camera.of(asked.kind, asked.size, asked.fov_deg)
    scenario, of = engine.scenario, engine.parts.units[emulator.number(asked.unit)]
    begin_ns, end_ns = engine.span_ns(*scenario.span_s(asked.start_s, asked.duration_s))
    windows, species = engine.windows, species_of(engine.parts.world)
    pictures = ImageFolder(Path(folder), _cameras(camera, species))
    with windows.stopped_by(stop), pictures, workers(engine.threads, "image", stop) as pool, suppress(CancelledError):
        for since_ns in range(begin_ns, end_ns, seconds_to_ns(asked.every_s)):
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
    counts = pictures.images, pictures.bytes, stop.is_set()
    return ImageRun(str(folder), emulator.name, asked.unit, camera.kind, camera.width, camera.height, *counts)


def species_of(world: World) -> dict[int, str]:
    """Return the names of species by number."""
    bare = world.bare if isinstance(world, Furnished) else world
    return dict(bare.plants.names) if isinstance(bare, ForestWorld) else {}


def _cameras(camera: Camera, species: Mapping[int, str]) -> dict[str, Any]:
    sensor_T_camera = np.eye(4)
    sensor_T_camera[:3, :3] = _BODY_R_CAMERA
    return {
        "kind": camera.kind,
        "width": camera.width,
        "height": camera.height,
        **dict.fromkeys(("fx", "fy"), camera.focal_px),
        "cx": camera.width / 2,
        "cy": camera.height / 2,
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
    rays, shape = camera.rays(rows), (len(rows), camera.width)
    direction, t_ns, far_m = rays @ pose.world_R_body[0].T, int(pose.t_ns[0]), unit.section.max_range_m
    near_m = float(unit.head.beams.near_m[0])
    seen = look(geometry, pose.world_p_body_m[0], direction, far_m, near_m=near_m, t_ns=t_ns)
    is_lit = np.ones(len(rays), np.bool_)
    if species:  # in a hall the ceiling would shade all
        met_m = pose.world_p_body_m[0] + direction * (seen.range_m - _CLEAR_M)[:, None]
        is_lit = ~look(geometry, met_m, _SUN, far_m, near_m=_CLEAR_M, t_ns=t_ns).is_met
    light = _FROM_SKY + _FROM_CAMERA * seen.cos_incidence + _FROM_SUN * is_lit
    rgb = np.rint(seen.rgb(surface_colours(geometry.surfaces, species), light, _SKY)).astype(np.uint8)
    depth_m = seen.range_m * (rays[:, 2] if camera.kind is CameraKind.PINHOLE else 1.0)
    surfaces = np.append(geometry.surfaces, np.zeros(1, SURFACE))  # the last row is that of `NO_SURFACE`
    met = surfaces[np.minimum(seen.surface, len(geometry.surfaces))]
    labels = (met[name].reshape(shape) for name in _LABELS)
    return rgb.reshape(*shape, 3), depth_m.astype(np.float32).reshape(shape), *labels
