"""Files of point clouds, written block by block in the format of their suffix; columns and labels."""

import shutil
import tempfile
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from enum import IntEnum
from functools import cache
from importlib.resources import files
from itertools import chain
from pathlib import Path
from typing import IO, Any

import numpy as np

from vlp16emu.doors import DOORS, door, has_door
from vlp16emu.errors import InputError
from vlp16emu.output import OutputFile
from vlp16emu.packets import PointFrame
from vlp16emu.settings import toml
from vlp16emu.trees import Table
from vlp16emu.types import U1, U4, AnyArray, HeightField, PlantPart, Semantic


@cache
def _table(name: str) -> Table:
    return toml(files("vlp16emu.extras.clouds").joinpath(name).read_text("utf-8"))


class LabelScheme:
    """Class codes by semantic class and plant part, from a table of labels.toml."""

    def __init__(self, name: str, table: Table) -> None:
        self.name = name
        self.source: str = table["source"]  # publisher of the codes, and their meaning
        self._codes = np.full((len(Semantic), len(PlantPart)), table["none"], np.uint8)
        for semantic in Semantic:
            for part in PlantPart:
                keys = f"{semantic.name}.{part.name}".lower(), semantic.name.lower()
                self._codes[semantic, part] = next(
                    (table[key] for key in keys if key in table), table["none"]
                )

    def codes(self, semantic: U1, part: U1) -> U1:
        """Classes (n,) of points by `Semantic` (n,) and `PlantPart` (n,)."""
        return np.asarray(self._codes[semantic, part])


def label_scheme(name: str, *, where: str = "labels") -> LabelScheme:
    """Return a scheme by its name; InputError for `where` if there is none."""
    schemes = _table("labels.toml")
    if name not in schemes:
        raise InputError(where, f"found {name}", ", ".join(schemes))
    return LabelScheme(name, schemes[name])


class PointLabels:
    """Labels of points in one scheme, block by block, and heights above the ground."""

    def __init__(self, scheme: LabelScheme, height_m: HeightField) -> None:
        self._scheme = scheme
        self._height_m = height_m
        self._numbers: dict[int, int] = {}

    def labels_of(self, points: Mapping[str, AnyArray]) -> dict[str, AnyArray]:
        """Return arrays (n,) `label`, `tree_id` and `height_m`.

        They follow from `world_m` (n, 3), and from `semantic`, `part` and `instance` (n,).
        """
        x_m, y_m, z_m = np.ascontiguousarray(points["world_m"].T)
        return {
            "label": self._scheme.codes(points["semantic"], points["part"]),
            "tree_id": self._tree_numbers(points["instance"], points["semantic"]),
            "height_m": (z_m - self._height_m(x_m, y_m)).astype(np.float32),
        }

    def _tree_numbers(self, instance: U4, semantic: U1) -> U4:
        """Tree numbers (n,), 1, 2, 3 ... in order of first appearance; 0 for points that are on no tree."""
        is_tree = semantic == Semantic.TREE
        distinct, first_rows, positions = np.unique(instance[is_tree], return_index=True, return_inverse=True)
        for row in np.argsort(first_rows).tolist():
            self._numbers.setdefault(int(distinct[row]), len(self._numbers) + 1)
        dense = np.zeros(len(instance), np.uint32)
        dense[is_tree] = np.array([self._numbers[row] for row in distinct.tolist()], np.uint32)[positions]
        return dense


Block = Mapping[str, AnyArray]  # arrays of one length by the names of their columns


@dataclass(frozen=True, slots=True)
class Column:
    """One array of the points, and its form in each format: a row of `columns.toml`."""

    name: str  # in .npz
    dtype: str
    csv: Sequence[str]  # headers, one for each number of a point in this column
    decimals: int = 0  # decimals in .csv. Integers with decimals are in units of the last decimal
    ply: Sequence[str] = ()
    """Names of properties, as many as headers; empty for a column of .npz and .csv only."""
    ply_dtype: str = ""  # type of the properties, if it differs from the array's

    @property
    def property_dtype(self) -> str:
        """Type of the properties."""
        return self.ply_dtype or self.dtype

    def properties(self, values: AnyArray) -> dict[str, AnyArray]:
        """Split the array of this column into its properties, arrays (n,) by name.

        Fixed-point numbers become fractions.
        """
        if self.decimals and values.dtype.kind == "i":
            values = values / 10**self.decimals
        return dict(zip(self.ply, values.reshape(len(values), len(self.ply)).T, strict=True))


@dataclass(frozen=True, slots=True)
class CloudMetadata:
    """Metadata of a file of points, for formats that have a place for it."""

    comments: tuple[str, ...]  # lines for people
    start_utc: datetime | None = None  # date of the file
    origin: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees and height in metres (WGS 84) of (0, 0, 0), for points in a world."""
    unit: int = 1  # number of the sensor in a rig, from 1


RETURN_NAMES = ("strongest", "last", "second_strongest")
"""Meaning of the numbers in the column `return_number`."""

_AXES = {
    PointFrame.SENSOR: "x forward (azimuth 0), y left, z up",
    PointFrame.MANUAL: "x right, y forward (azimuth 0), z up: the frame of Velodyne's manual",
}


def time_comment(clock: str) -> str:
    """Return the comment line that defines `time` and names its clock."""
    return f"time: UTC, seconds since 1970-01-01 without leap seconds, by the {clock} clock"


def capture_comments(frame: PointFrame, clock: str) -> tuple[str, ...]:
    """Return comment lines that define the columns of a capture's points."""
    return f"x, y, z in the sensor, in metres: {_AXES[frame]}", time_comment(clock)


_ROWS = {name: tuple(Column(*row) for row in rows) for name, rows in _table("columns.toml").items()}
CAPTURE_COLUMNS = _ROWS["capture"]
SCENE_COLUMNS = _ROWS["scene"]
TRUTH_COLUMNS = _ROWS["truth"]
"""Optional columns of points of a scene, and of a capture with ground truth: the surface of each point."""
LABEL_COLUMNS = _ROWS["labels"]
"""Optional columns of such points: labels in a scheme."""
DESKEWED_COLUMNS = (
    *(column for column in SCENE_COLUMNS if column.name not in ("elevation_deg", "return_number")),
    *_ROWS["placed"],
)
"""Columns of a capture's points that a trajectory transforms to the world."""


def scene_comments() -> tuple[str, ...]:
    """Return comment lines that define the columns of a scene's points."""
    return (
        "x, y, z in the world: local east, north, up in metres",
        f"sensor_x, sensor_y, sensor_z at the pulse's instant: {_AXES[PointFrame.SENSOR]}",
        time_comment("scene's"),
        f"return_number: {', '.join(f'{number} {name}' for number, name in enumerate(RETURN_NAMES))}",
        f"semantic: {_code_list(Semantic)}",
        f"part: {_code_list(PlantPart)}",
        "leaf_wood: 0 neither, 1 wood, 2 leaf",
    )


def _code_list(labels: type[IntEnum]) -> str:
    return ", ".join(f"{label} {label.name.lower()}" for label in labels)


class PointWriter(ABC):
    """Writer of points into a file, block by block."""

    points = 0  # number of points so far

    @abstractmethod
    def write(self, block: Block) -> None:
        """Add points."""

    def finish(self) -> None:  # noqa: B027  # most formats are complete without it
        """Write the fields that need the number of points."""


class CsvFile(PointWriter):
    """CSV with one line per point; the header names the units."""

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], _metadata: CloudMetadata, _stack: ExitStack
    ) -> None:
        self._file = file
        self._columns = columns
        file.write(f"{','.join(name for column in columns for name in column.csv)}\n".encode())

    def write(self, block: Block) -> None:
        """Write a line for each point."""
        formats = list[str]()
        fields = list[list[Any]]()
        for column in self._columns:
            values = block[column.name]
            unit = 10**column.decimals
            for array in values.reshape(len(values), len(column.csv)).T:
                if array.dtype.kind == "f":
                    formats.append(f"%.{column.decimals}f")
                    fields.append((np.rint(array.astype(np.float64) * unit) / unit + 0.0).tolist())  # no -0.0
                elif column.decimals:  # float64 cannot represent UTC in ns
                    formats.append(f"%s%d.%0{column.decimals}d")
                    integer, fraction = np.divmod(np.abs(array), unit)
                    fields += [np.where(array < 0, "-", "").tolist(), integer.tolist(), fraction.tolist()]
                else:
                    formats.append("%d")
                    fields.append(array.tolist())
        lines = f"{','.join(formats)}\n" * len(fields[0])
        self._file.write((lines % tuple(chain.from_iterable(zip(*fields, strict=True)))).encode())
        self.points += len(fields[0])


_PLY_KINDS = {"<f4": "float", "<f8": "double", "|u1": "uchar", "<u2": "uint16"}
"""Types that all readers take: Open3D 0.20 drops properties of the types ushort, uint and uint32."""


class PlyFile(PointWriter):
    """Binary little-endian PLY; the number of points is filled in at the end."""

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], metadata: CloudMetadata, _stack: ExitStack
    ) -> None:
        self._file = file
        self._comments = metadata.comments
        # Coordinates first, as some readers expect.
        self._columns = sorted((column for column in columns if column.ply), key=lambda c: c.ply[0] != "x")
        self._vertex_dtype = np.dtype(
            [(name, self._property_dtype(column)) for column in self._columns for name in column.ply]
        )
        file.write(self._header())

    def write(self, block: Block) -> None:
        """Write a record for each point."""
        vertices = np.empty(len(block[self._columns[0].name]), self._vertex_dtype)
        for column in self._columns:
            for name, values in column.properties(block[column.name]).items():
                vertices[name] = values
        self._file.write(vertices.tobytes())
        self.points += len(vertices)

    def finish(self) -> None:
        """Write the number of points into the header."""
        self._file.seek(0)
        self._file.write(self._header())

    @staticmethod
    def _property_dtype(column: Column) -> str:
        dtype = column.property_dtype
        return "<f8" if dtype == "<u4" else dtype  # float64 holds all numbers of uint32

    def _header(self) -> bytes:
        kinds = ((name, _PLY_KINDS[self._vertex_dtype[name].str]) for name in self._vertex_dtype.names or ())
        lines = [
            "ply\nformat binary_little_endian 1.0",
            *(f"comment {comment}" for comment in self._comments),
            f"element vertex {self.points:<20}",
            *(f"property {kind} {name}" for name, kind in kinds),
            "end_header\n",
        ]
        return "\n".join(lines).encode("ascii")


class PcdFile(PlyFile):
    """Binary PCD 0.7, which differs from PLY in its header, and in float32 coordinates as in PCL's types.

    Source: pointclouds.org, The PCD (Point Cloud Data) file format.
    """

    @staticmethod
    def _property_dtype(column: Column) -> str:
        return "<f4" if column.ply[0] == "x" else column.property_dtype

    def _header(self) -> bytes:
        fields = [self._vertex_dtype[name] for name in self._vertex_dtype.names or ()]
        lines = [
            "# .PCD v0.7 - Point Cloud Data file format",
            *(f"# {comment}" for comment in self._comments),
            "VERSION 0.7",
            f"FIELDS {' '.join(self._vertex_dtype.names or ())}",
            f"SIZE {' '.join(str(field.itemsize) for field in fields)}",
            f"TYPE {' '.join(field.kind.upper() for field in fields)}",
            f"COUNT {' '.join('1' for _ in fields)}",
            f"WIDTH {self.points:<20}",
            "HEIGHT 1",
            "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {self.points:<20}",
            "DATA binary\n",
        ]
        return "\n".join(lines).encode("ascii")


class NpzFile(PointWriter):
    """Numpy arrays by the names of the columns.

    The format stores one array after the other, so each array waits in a temporary file beside the output.
    """

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], _metadata: CloudMetadata, stack: ExitStack
    ) -> None:
        self._file = file
        self._columns = columns
        folder = Path(file.name).parent
        self._waiting = [
            stack.enter_context(tempfile.TemporaryFile(dir=folder))  # noqa: SIM115  # in a stack
            for _ in columns
        ]

    def write(self, block: Block) -> None:
        """Append each array to its temporary file."""
        for column, waiting in zip(self._columns, self._waiting, strict=True):
            waiting.write(np.ascontiguousarray(block[column.name], column.dtype).tobytes())
        self.points += len(block[self._columns[0].name])

    def finish(self) -> None:
        """Write the archive."""
        with zipfile.ZipFile(self._file, "w") as archive:
            for column, waiting in zip(self._columns, self._waiting, strict=True):
                shape = (self.points, len(column.csv)) if len(column.csv) > 1 else (self.points,)
                header = {"descr": np.dtype(column.dtype).str, "fortran_order": False, "shape": shape}
                with archive.open(f"{column.name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array_header_1_0(member, header)
                    waiting.seek(0)
                    shutil.copyfileobj(waiting, member, 1 << 20)


@contextmanager
def point_file(
    path: Path, columns: Sequence[Column], metadata: CloudMetadata, *, where: str, inputs: Iterable[Path] = ()
) -> Iterator[PointWriter]:
    """Open a file for points in the format of its suffix.

    If an error ends the points, the file has the points before it. If there are no points, or the file itself
    cannot be written, there is no file.

    Parameters
    ----------
    columns : columns of each block that is written
    where : the file in error lines
    inputs : files that must not be replaced

    Raises InputError if the suffix names no format, MissingExtraError if its library is not installed;
    OutputError and RunError as `OutputFile`.
    """
    if not has_door(path.suffix, "clouds"):
        raise InputError(where, f"found the ending {path.suffix!r}", ", ".join(DOORS["clouds"]))
    writer_class = door(path.suffix, "clouds")
    with OutputFile(path, where=where, inputs=inputs) as output:
        failure: Exception | None = None
        with output.writing() as file, ExitStack() as stack:
            writer = writer_class(file, columns, metadata, stack)
            try:
                yield writer
            except Exception as error:
                if isinstance(error, OSError) or not writer.points:
                    raise
                failure = error
            writer.finish()
        if failure:
            raise failure
