"""Images of a run in a folder, with intrinsics, extrinsics and poses in the forms of other programs."""

import csv
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from threading import Event
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, TypeAdapter, with_config
from typing_extensions import TypedDict

from vlp16emu.errors import InputError, OutputError, RunError
from vlp16emu.extras.camera.lens import Lens
from vlp16emu.extras.camera.mount import AXES, camera_of
from vlp16emu.extras.camera.reconstruction import reconstruction_files
from vlp16emu.extras.camera.shot import Photographer, Shot
from vlp16emu.extras.options import ImageOptions
from vlp16emu.extras.truth.description import PARTIAL, CameraOnRig, FileName, Matrix, read_members
from vlp16emu.extras.truth.tables import POSES, quaternions
from vlp16emu.extras.truth.truth import rig_of
from vlp16emu.inputs import open_input, parsing, read_text
from vlp16emu.libraries import of_extra
from vlp16emu.output import Staged, final_name, opening, write_json
from vlp16emu.run.emulator import Emulator
from vlp16emu.trees import Table, Tree
from vlp16emu.types import F4, F8, U2, U4, AnyArray, PlantPart, Semantic
from vlp16emu.units import FOREVER_NS, S_NS, seconds_to_ns

LAYERS = ("rgb", "depth", "semantic", "part", "instance")
MOST_INSTANCES = 65_535  # numbers of 16 bits, without 0
_MM = 1e-3
_MOST_MM = 65_535
_TUM_HEAD = f"# t_utc_s x_m y_m z_m qx qy qz qw: world_T_camera; line n is image n; camera {AXES}\n"
_EXPECTED = "a folder that `images` has written"


_Size = Annotated[int, Field(ge=1, le=100_000)]


@with_config(PARTIAL)
class _Intrinsics(TypedDict):
    width: _Size
    height: _Size
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Annotated[dict[str, float], Field(min_length=5, max_length=5)]


@with_config(PARTIAL)
class _Depth(TypedDict):
    unit_m: float


@with_config(PARTIAL)
class _Image(TypedDict):
    file: FileName
    depth_file: FileName
    t_ns: Annotated[int, Field(ge=-FOREVER_NS, le=FOREVER_NS)]
    world_T_camera: Matrix


@with_config(PARTIAL)
class _Cameras(TypedDict):
    intrinsics: _Intrinsics
    rig: CameraOnRig
    depth: _Depth
    images: list[_Image]


_CAMERAS = TypeAdapter[Any](_Cameras)


@dataclass(frozen=True, slots=True)
class ImageRun:
    """Content of a folder of images."""

    folder: str
    scene: str
    width_px: int
    height_px: int
    images: int
    instances: int  # different ones
    bytes: int  # of all files
    simulated_s: float
    interrupted: bool


class ImageFolder:
    """A new or empty folder for images; a context manager.

    It is `Staged`. After a full disk the images so far stay under its temporary name.

    Raises OutputError if the folder has content, or cannot be made; MissingExtraError if pillow is not
    installed.
    """

    def __init__(self, path: Path, depth: str) -> None:
        with of_extra("picture", "writing images"):
            from PIL import Image
        self._image = Image
        self._depth = depth
        self._where = str(path)
        self._number_of = dict[int, int]()  # numbers of instances, from 1
        self.shots = list[tuple[int, F8]]()
        """UTC and world_T_camera (4, 4) of each image."""
        with opening(self._where, "a folder that can be written"):
            final_name(path).parent.mkdir(parents=True, exist_ok=True)
            self._staged = Staged(path, self._where, self._check, is_folder=True)
            self.path = self._staged.path
            for layer in LAYERS:
                (self.path / layer).mkdir()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self._staged.keep()
        elif isinstance(error, RunError):
            self._staged.leave()
        else:
            self._staged.discard()

    def _check(self, final: Path) -> None:
        if final.exists() and (not final.is_dir() or any(final.iterdir())):
            raise OutputError(self._where, "is there already", "a new or empty folder")

    @property
    def instances(self) -> int:
        """Number of different instances so far."""
        return len(self._number_of)

    def add(self, shot: Shot) -> None:
        """Write one image.

        Raises RunError if it cannot be written, or if there are more instances than numbers of 16 bits.
        """
        name = f"{len(self.shots):06d}"
        instance = self._number(shot.instance)
        with self._writing(f"image {name}"):
            self._png("rgb", name, shot.rgb)
            self._png("semantic", name, shot.semantic)
            self._png("part", name, shot.part)
            self._png("instance", name, instance)
            if self._depth == "mm":
                self._png("depth", name, _in_mm(shot.depth_m))
            else:
                np.save(self.path / "depth" / f"{name}.npy", shot.depth_m)
        self.shots.append((shot.t_ns, shot.world_T_camera))

    def finish(self, cameras: Table, lens: Lens) -> None:
        """Write the files that describe all images."""
        with self._writing("its description"):
            write_json(self.path / "cameras.json", cameras)
            (self.path / "poses.tum").write_text(_TUM_HEAD + self._poses())
            rows = "".join(f"{number},{instance}\n" for instance, number in self._number_of.items())
            (self.path / "instances.csv").write_text("number,instance\n" + rows)
            poses = [pose for _, pose in self.shots]
            for file, text in reconstruction_files(lens, poses, self.depth_suffix).items():
                (self.path / file).parent.mkdir(parents=True, exist_ok=True)
                (self.path / file).write_text(text)

    def _poses(self) -> str:
        """Return the lines of `poses.tum`; the rows have no velocities."""
        t_ns = [at_ns for at_ns, _ in self.shots]
        T = np.array([pose for _, pose in self.shots])
        rows = POSES.rows(t_ns, position_m=T[:, :3, 3], quaternion_xyzw=quaternions(T[:, :3, :3]))
        return POSES.text(rows)

    @property
    def depth_suffix(self) -> str:
        """Suffix of the files of depth."""
        return ".png" if self._depth == "mm" else ".npy"

    def _png(self, layer: str, name: str, pixels: AnyArray) -> None:
        self._image.fromarray(pixels).save(self.path / layer / f"{name}.png", compress_level=6)

    def _number(self, instance: U4) -> U2:
        """Return instances as numbers of 16 bits, in the order in which images show them; 0 stays 0."""
        different, place = np.unique(instance, return_inverse=True)
        for number in different.tolist():
            if number and number not in self._number_of:
                self._number_of[number] = len(self._number_of) + 1
        if len(self._number_of) > MOST_INSTANCES:
            found = f"more than {MOST_INSTANCES} instances in {len(self.shots)} images"
            raise RunError(f"{self._where}: {found}; they are left as {self.path}")
        numbers = np.array([self._number_of.get(number, 0) for number in different.tolist()], np.uint16)
        return numbers[place.ravel()].reshape(instance.shape)

    @contextmanager
    def _writing(self, content: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            found = error.strerror or error
            raise RunError(f"{self._where}: {content}: {found}; it is left as {self.path}") from error


def write_images(
    emulator: Emulator,
    folder: str | Path,
    *,
    progress: Callable[[float], None] = lambda _: None,
    stop: Event | None = None,
    **options: Any,
) -> ImageRun:
    """Write the images of the scene's camera, or of the default one, into a folder.

    Parameters
    ----------
    folder : new or empty
    progress, stop : as in `Emulator.record`
    options : fields of `ImageOptions`

    Raises InputError for a wrong option or a distortion that cannot be inverted; MissingExtraError if pillow
    is not installed; OutputError if the folder has content or cannot be written; TrajectoryError if the walk
    ends before the span; RunError if the disk is full, which leaves the images before; CancelledError, and no
    folder, if `stop` is set before the first image.
    """
    asked = ImageOptions.from_fields(options)
    stop = stop or Event()
    scenario = emulator.scenario.model_copy(update={"camera": camera_of(emulator.scenario)})
    engine = replace(emulator.stopped_by(stop).engine, scenario=scenario)
    begin_ns, end_ns = engine.span_ns(*scenario.span_s(asked.start_s, asked.duration_s))
    photographer = Photographer(engine, asked.samples)
    step_ns = seconds_to_ns(asked.every_s) if asked.every_s else photographer.step_ns
    with ImageFolder(Path(folder), asked.depth) as images:
        with suppress(CancelledError):
            for since_ns in range(begin_ns, end_ns, step_ns):
                images.add(photographer.take(scenario.start_ns + since_ns))
                progress((since_ns + step_ns - begin_ns) / S_NS)
                if stop.is_set():
                    break
        if not images.shots:
            raise CancelledError
        images.finish(_cameras(photographer, emulator.name, asked.depth, images), photographer.lens)
        size = sum(path.stat().st_size for path in images.path.rglob("*.*"))
        last_ns = images.shots[-1][0] - scenario.start_ns + step_ns
    return ImageRun(
        str(folder),
        emulator.name,
        photographer.lens.width,
        photographer.lens.height,
        len(images.shots),
        images.instances,
        size,
        (min(last_ns, end_ns) - begin_ns) / S_NS,
        stop.is_set(),
    )


def _cameras(photographer: Photographer, scene: str, depth: str, images: ImageFolder) -> Tree:
    """Return `cameras.json`."""
    lens = photographer.lens
    scenario = photographer.engine.scenario
    names = ("k1", "k2", "p1", "p2", "k3")
    return {
        "written_by": f"vlp16emu {version('vlp16emu')}",
        "scene": scene,
        "frames": {
            "world": "x east, y north, z up, in metres",
            "body": "x forward, y left, z up",
            "camera": AXES,
            "a_T_b": "takes coordinates in b to coordinates in a",
        },
        "intrinsics": {
            "model": "pinhole with Brown's distortion, as in OpenCV",
            "pixels": "column to the right, row down; the middle of the first pixel is (0, 0)",
            "width": lens.width,
            "height": lens.height,
            **{name: getattr(lens, name) for name in ("fx", "fy", "cx", "cy")},
            "distortion": dict(zip(names, lens.distortion, strict=True)),
        },
        "shutter": {
            "readout_s": photographer.section.readout_s,
            "time_of_row": "t_ns + ((row - (height - 1) / 2) / (height - 1)) * readout_s",
            "poses": "those of the middle row",
        },
        "rig": rig_of(scenario, photographer.engine.parts)["camera"],
        "depth": {
            "along": "the optical axis, not the ray",
            "unit_m": _MM if depth == "mm" else 1.0,
            "none": 0,
            "range_m": photographer.far_m,
        },
        "semantic": {int(label): label.name.lower() for label in Semantic},
        "part": {int(label): label.name.lower() for label in PlantPart},
        "images": [
            {
                "file": f"{number:06d}",
                "depth_file": f"{number:06d}{images.depth_suffix}",
                "t_ns": t_ns,
                "world_T_camera": pose.tolist(),
            }
            for number, (t_ns, pose) in enumerate(images.shots)
        ],
    }


def read_images(folder: Path) -> tuple[Tree, Lens, Iterator[Shot]]:
    """Return `cameras.json` of a folder of images, the lens, and its images one after another.

    Raises InputError if a file is missing or is none of `images`; MissingExtraError if pillow is not
    installed.
    """
    with of_extra("picture", "reading images"):
        import PIL.Image
    cameras = read_members(folder / "cameras.json", _EXPECTED, _CAMERAS)
    known = cameras["intrinsics"]
    focal = known["fx"], known["fy"], known["cx"], known["cy"]
    lens = Lens(known["width"], known["height"], *focal, tuple(known["distortion"].values()))
    rows = cameras["images"]
    unit_m = cameras["depth"]["unit_m"]
    table = _instances(folder / "instances.csv")

    def pixels(layer: str, name: str) -> AnyArray:
        """Read an image of a layer."""
        path = folder / layer / name
        with open_input(path, _EXPECTED, InputError) as file, parsing(path, _EXPECTED, InputError):
            is_array = path.suffix == ".npy"
            image: AnyArray = (
                np.load(file, allow_pickle=False) if is_array else np.array(PIL.Image.open(file))
            )
        size = lens.height, lens.width
        if image.shape != (*size, 3) and (layer == "rgb" or image.shape != size):
            found = f"found an image of {image.shape}"
            raise InputError(str(path), found, f"{lens.height} rows of {lens.width} pixels")
        return image

    def shots() -> Iterator[Shot]:
        """Yield the images in order of their times."""
        for row in rows:
            name = f"{row['file']}.png"
            depth_m = (pixels("depth", row["depth_file"]) * unit_m).astype(np.float32)
            instance = table[pixels("instance", name).astype(np.uint16)]
            pose = np.array(row["world_T_camera"])
            classes = pixels("semantic", name), pixels("part", name)
            yield Shot(row["t_ns"], pose, pixels("rgb", name), depth_m, *classes, instance)

    return cameras, lens, shots()


def _instances(path: Path) -> U4:
    """Return the instance of each number."""
    table = np.zeros(MOST_INSTANCES + 1, np.uint32)
    lines = read_text(path, _EXPECTED, InputError).splitlines()
    with parsing(path, _EXPECTED, InputError):
        for row in csv.DictReader(lines):
            table[np.uint16(row["number"])] = np.uint32(row["instance"])
    return table


def _in_mm(depth_m: F4) -> U2:
    """Return depth in whole millimetres; 0, as for none, beyond 65.535 m."""
    mm = np.rint(depth_m.astype(np.float64) / _MM)
    return np.where(mm <= _MOST_MM, mm, 0.0).astype(np.uint16)
