"""Points in E57 (ASTM E2807-11), as one scan in the frame of the world, or of the sensor.

Fields of the standard are used where there is one; the rest is in an extension, by the names of .ply.
"""

import uuid
from collections.abc import Sequence
from contextlib import ExitStack
from typing import IO, Any

import numpy as np

from vlp16emu.errors import MissingExtraError
from vlp16emu.gps_time import adjusted_gps_s
from vlp16emu.sinks.cloud import Block, CloudAbout, Column
from vlp16emu.sinks.las import echoes_of, local_wkt
from vlp16emu.units import US_NS

_EXTENSION = "vlp", "urn:vlp16emu:points"
_CAPACITY = 1 << 17
"""Points that wait for the library at once."""
_STANDARD = {
    "x": "cartesianX",
    "y": "cartesianY",
    "z": "cartesianZ",
    "intensity": "intensity",
    "time": "timeStamp",
}
_SINCE_ADJUSTED_S = 1e9
"""E57 counts GPS time from 1980-01-06 (E2807-11, section 8.4.2)."""


class E57File:
    """Takes points block by block. The library writes the file by its name, in the place of ours.

    Parameters
    ----------
    file : empty
    columns : with `x`, `y` and `z` among the properties
    stack : closes what is left open after an error

    Raises
    ------
    MissingExtraError
        where pye57 is not installed
    """

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], about: CloudAbout, stack: ExitStack
    ) -> None:
        try:
            from pye57 import libe57
        except ImportError:
            raise MissingExtraError("pye57", "cloud", "writing E57") from None
        self._lib, self._about, self.points = libe57, about, 0
        self._held = 0
        self._image = libe57.ImageFile(file.name, "w")
        stack.callback(self._image.close)
        self._low_m, self._high_m = np.full(3, np.inf), np.full(3, -np.inf)
        self._columns = [column for column in columns if column.ply]
        kinds = {name: column.ply_dtype or column.dtype for column in self._columns for name in column.ply}
        kinds = {_STANDARD.get(name, f"{_EXTENSION[0]}:{name}"): kind for name, kind in kinds.items()}
        kinds |= {"returnIndex": "|u1", "returnCount": "|u1"}
        self._scan = self._begin()
        self._open(kinds)

    def write(self, block: Block) -> None:
        """Append points."""
        values = {
            _STANDARD.get(name, f"{_EXTENSION[0]}:{name}"): array
            for column in self._columns
            for name, array in column.properties(block[column.name]).items()
        }
        n = len(values["cartesianX"])
        if not n:
            return
        number, values["returnCount"] = echoes_of(block)
        values["returnIndex"] = number - 1
        begin = 0
        while begin < n:  # always as many at once, whatever the blocks: bytes depend on it
            taken = min(_CAPACITY - self._held, n - begin)
            for name, waiting in self._waiting.items():
                waiting[self._held : self._held + taken] = values[name][begin : begin + taken]
            self._held, begin = self._held + taken, begin + taken
            if self._held == _CAPACITY:
                self._pass_on()
        xyz_m = np.stack([values[_STANDARD[axis]] for axis in "xyz"])
        self._low_m = np.minimum(self._low_m, xyz_m.min(axis=1))
        self._high_m = np.maximum(self._high_m, xyz_m.max(axis=1))
        self.points += n

    def finish(self) -> None:
        """Write the bounds, and all else that the library writes last."""
        self._pass_on()
        self._writer.close()
        if self.points:
            bounds = {
                f"{axis}{end}": float(value)
                for end, values in (("Minimum", self._low_m), ("Maximum", self._high_m))
                for axis, value in zip("xyz", values, strict=True)
            }
            self._scan.set("cartesianBounds", self._structure(bounds))
        self._image.close()

    def _pass_on(self) -> None:
        if self._held:
            self._writer.write(self._held)
            self._held = 0

    def _begin(self) -> Any:
        """Describe the file and its one scan."""
        lib, image, about = self._lib, self._image, self._about
        image.extensionsAdd("", lib.E57_V1_0_URI)
        image.extensionsAdd(*_EXTENSION)
        name = f"{about.start_utc} {about.unit}"
        root = image.root()
        for key, value in {
            "formatName": "ASTM E57 3D Imaging Data File",
            "guid": f"{{{uuid.uuid5(uuid.NAMESPACE_URL, f'{_EXTENSION[1]} file {name}')}}}",
            "versionMajor": lib.E57_FORMAT_MAJOR,
            "versionMinor": lib.E57_FORMAT_MINOR,
            "e57LibraryVersion": lib.E57_LIBRARY_ID,
            "coordinateMetadata": local_wkt(*about.origin) if about.origin else "",
        }.items():
            root.set(key, self._leaf(value))
        root.set("data3D", lib.VectorNode(image, True))
        scan = self._structure(
            {
                "guid": f"{{{uuid.uuid5(uuid.NAMESPACE_URL, f'{_EXTENSION[1]} scan {name}')}}}",
                "name": f"unit {about.unit}",
                "description": "; ".join(about.comments),
            }
        )
        scan.set("intensityLimits", self._structure({"intensityMinimum": 0.0, "intensityMaximum": 255.0}))
        if about.start_utc is not None:
            start_ns = round(about.start_utc.timestamp() * 1e6) * US_NS
            gps_s = float(adjusted_gps_s(np.array([start_ns]))[0]) + _SINCE_ADJUSTED_S
            moment = {"dateTimeValue": gps_s, "isAtomicClockReferenced": 0}
            root.set("creationDateTime", self._structure(moment))
            scan.set("acquisitionStart", self._structure(moment))
        return scan

    def _open(self, kinds: dict[str, str]) -> None:
        """Make the table of points, with fields of some types."""
        lib, image = self._lib, self._image
        row, buffers = lib.StructureNode(image), lib.VectorSourceDestBuffer()
        self._waiting = {}
        for name, kind in kinds.items():
            dtype = np.dtype(kind)
            if dtype.kind == "f":
                precision = lib.E57_SINGLE if dtype.itemsize == 4 else lib.E57_DOUBLE
                row.set(name, lib.FloatNode(image, 0.0, precision))
            else:
                row.set(name, lib.IntegerNode(image, 0, 0, int(np.iinfo(dtype).max)))
                dtype = np.dtype(np.int64)  # the one type of the library that holds them all
            self._waiting[name] = np.zeros(_CAPACITY, dtype)
            buffers.append(lib.SourceDestBuffer(image, name, self._waiting[name], _CAPACITY, True, True))
        points = lib.CompressedVectorNode(image, row, lib.VectorNode(image, True))
        self._scan.set("points", points)
        image.root()["data3D"].append(self._scan)
        self._writer = points.writer(buffers)

    def _structure(self, values: dict[str, Any]) -> Any:
        node = self._lib.StructureNode(self._image)
        for name, value in values.items():
            node.set(name, self._leaf(value))
        return node

    def _leaf(self, value: str | float) -> Any:
        kinds = {str: self._lib.StringNode, int: self._lib.IntegerNode, float: self._lib.FloatNode}
        return kinds[type(value)](self._image, value)
