"""A folder of images: PNG to look at, OpenEXR with exact values, and the intrinsics and poses of the camera."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import MissingExtraError, RunError
from vlp16emu.extras.outputs import OutputFolder
from vlp16emu.extras.truth.folder import tum_rows
from vlp16emu.output import write_json
from vlp16emu.packets import DISTANCE_LSB_M
from vlp16emu.types import F4, U1, Poses

LAYERS = {"rgb": np.uint8, "depth": np.uint16, "semantic": np.uint8, "part": np.uint8, "species": np.uint16}
"""Folders of PNG files and the type of their pixels; depth is in steps of 2 mm, as in packets."""
_POSES = "# t_utc_s x_m y_m z_m qx qy qz qw: world_T_camera; line n is image n; camera z forward, x right, y down\n"


class PictureFolder:
    """A folder for the images of one run: a context manager that writes the poses at its end.

    It is an `OutputFolder`, and takes its name then. After an error the images so far stay without that name.

    Parameters
    ----------
    path : new or empty folder
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
        self.bytes, self._poses = 0, [_POSES]
        self._folder = OutputFolder(path)
        self._path = self._folder.path
        for layer in (*LAYERS, "exr"):
            (self._path / layer).mkdir()
        write_json(self._path / "cameras.json", cameras)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None or isinstance(error, KeyboardInterrupt):
            with self._new("poses.tum") as file:
                file.write("".join(self._poses).encode())
            self._folder.keep()
        elif self.images:
            self._folder.leave()
        self._folder.discard()

    @contextmanager
    def _new(self, name: str) -> Iterator[BinaryIO]:
        try:
            with (self._path / name).open("xb") as file:
                yield file
        except OSError as error:
            raise RunError(f"{self._path / name}: {error.strerror or error}; the images before it are whole") from error

    @property
    def images(self) -> int:
        """Number of images written."""
        return len(self._poses) - 1

    def add(self, pose: Poses, rgb: U1, depth_m: F4, labels: Mapping[str, NDArray[Any]]) -> None:
        """Write one image, taken at a pose of the camera.

        Parameters
        ----------
        rgb : (height, width, 3)
        depth_m : (height, width), 0 where nothing was met
        labels : (height, width) each: `semantic`, `part`, `species`, `instance`
        """
        name = f"{self.images:06d}"
        steps = np.rint(depth_m / DISTANCE_LSB_M)
        for layer, kind in LAYERS.items():
            pixels = {"rgb": rgb, "depth": steps}.get(layer, labels.get(layer))
            with self._new(f"{layer}/{name}.png") as file:
                self._image.fromarray(np.ascontiguousarray(pixels, kind)).save(file, "PNG")
                self.bytes += file.tell()
        with self._new(f"exr/{name}.exr") as file:
            self._write_exr(file, {"Z": depth_m} | {key: values.astype(np.uint32) for key, values in labels.items()})
        self.bytes += (self._path / "exr" / f"{name}.exr").stat().st_size
        self._poses.append(tum_rows(pose))

    def _write_exr(self, file: BinaryIO, channels: Mapping[str, NDArray[Any]]) -> None:
        header = {"compression": self._exr.ZIP_COMPRESSION, "type": self._exr.scanlineimage}
        try:
            with self._exr.File(header, {key: np.ascontiguousarray(channels[key]) for key in channels}) as image:
                image.write(file.name)
        except RuntimeError as error:
            raise RunError(f"{file.name}: {error}") from None
