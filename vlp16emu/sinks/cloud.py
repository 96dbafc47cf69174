"""Point clouds into files for other programs, block by block, in the format that the suffix names."""

import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError
from vlp16emu.output import OutputFile
from vlp16emu.sinks.columns import Block, CloudAbout, Column
from vlp16emu.text import csv_lines


class PointWriter(Protocol):
    """Takes points block by block."""

    points: int
    """So far."""

    def write(self, block: Block) -> None:
        """Add points."""

    def finish(self) -> None:
        """Write what could not be written before it was known how many points there are."""


class _Csv:
    """One line per point; the header names the units."""

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], _about: CloudAbout, _stack: ExitStack
    ) -> None:
        self._file, self._columns = file, columns
        self._decimals = np.array([column.decimals for column in columns for _ in column.csv])
        self.points = 0
        file.write(f"{','.join(name for column in columns for name in column.csv)}\n".encode())

    def write(self, block: Block) -> None:
        """Append lines."""
        numbers = [_whole(block[column.name], column) for column in self._columns]
        self._file.write(csv_lines(np.concatenate(numbers, axis=1), self._decimals))
        self.points += len(numbers[0])

    def finish(self) -> None:
        """Nothing left to do."""


_PLY_KINDS = {"<f4": "float", "<f8": "double", "|u1": "uchar", "<u2": "ushort", "<u4": "uint"}


class _Ply:
    """Binary little-endian PLY; the number of points is filled in at the end."""

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], about: CloudAbout, _stack: ExitStack
    ) -> None:
        self._file, self._comments = file, about.comments
        # Coordinates first, as some readers take for granted.
        self._columns = sorted((column for column in columns if column.ply), key=lambda c: c.ply[0] != "x")
        self._vertex = np.dtype(
            [(name, self._dtype(column)) for column in self._columns for name in column.ply]
        )
        self.points = 0
        file.write(self._header())

    def write(self, block: Block) -> None:
        """Append vertices."""
        vertices = np.empty(len(block[self._columns[0].name]), self._vertex)
        for column in self._columns:
            for name, values in column.properties(block[column.name]).items():
                vertices[name] = values
        self._file.write(vertices.tobytes())
        self.points += len(vertices)

    def finish(self) -> None:
        """Go back and write how many points there are."""
        self._file.seek(0)
        self._file.write(self._header())

    @staticmethod
    def _dtype(column: Column) -> str:
        return column.ply_dtype or column.dtype

    def _header(self) -> bytes:
        """Header of a length that does not depend on the number of points."""
        kinds = ((name, _PLY_KINDS[self._vertex[name].str]) for name in self._vertex.names or ())
        lines = [
            "ply",
            "format binary_little_endian 1.0",
            *(f"comment {comment}" for comment in self._comments),
            f"element vertex {self.points:<20}",
            *(f"property {kind} {name}" for name, kind in kinds),
            "end_header\n",
        ]
        return "\n".join(lines).encode("ascii")


class _Pcd(_Ply):
    """Binary PCD 0.7, which differs from PLY in its header alone; coordinates are float32, which PCL's types have.

    Source: pointclouds.org, The PCD (Point Cloud Data) file format.
    """

    @staticmethod
    def _dtype(column: Column) -> str:
        return "<f4" if column.ply[0] == "x" else column.ply_dtype or column.dtype

    def _header(self) -> bytes:
        """Header of a length that does not depend on the number of points."""
        fields = [self._vertex[name] for name in self._vertex.names or ()]
        lines = [
            "# .PCD v0.7 - Point Cloud Data file format",
            *(f"# {comment}" for comment in self._comments),
            "VERSION 0.7",
            f"FIELDS {' '.join(self._vertex.names or ())}",
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


class _Npz:
    """Numpy arrays by the names of the columns.

    The format wants all of one array before the next, so each waits on the disk, beside the file to come.
    """

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], _about: CloudAbout, stack: ExitStack
    ) -> None:
        self._file, self._columns = file, columns
        self.points = 0
        folder = Path(file.name).parent
        self._waiting: list[IO[bytes]] = []
        for _ in columns:
            aside = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # the stack closes it
            self._waiting.append(stack.enter_context(aside))

    def write(self, block: Block) -> None:
        """Put each array behind what there is of it."""
        for column, waiting in zip(self._columns, self._waiting, strict=True):
            waiting.write(np.ascontiguousarray(block[column.name], column.dtype).tobytes())
        self.points += len(block[self._columns[0].name])

    def finish(self) -> None:
        """Write all arrays."""
        with zipfile.ZipFile(self._file, "w") as archive:
            for column, waiting in zip(self._columns, self._waiting, strict=True):
                shape = (self.points, len(column.csv)) if len(column.csv) > 1 else (self.points,)
                header = {"descr": np.dtype(column.dtype).str, "fortran_order": False, "shape": shape}
                with archive.open(f"{column.name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array_header_1_0(member, header)
                    waiting.seek(0)
                    shutil.copyfileobj(waiting, member, 1 << 20)


def _las(
    file: IO[bytes], columns: Sequence[Column], about: CloudAbout, _stack: ExitStack, *, laz: bool = False
) -> PointWriter:
    from vlp16emu.sinks.las import LasFile

    return LasFile(file, columns, about, compressed=laz)


_WRITERS: dict[str, Callable[[IO[bytes], Sequence[Column], CloudAbout, ExitStack], PointWriter]] = {
    ".csv": _Csv,
    ".npz": _Npz,
    ".ply": _Ply,
    ".pcd": _Pcd,
    ".las": _las,
    ".laz": partial(_las, laz=True),
}


@contextmanager
def point_file(
    path: Path, columns: Sequence[Column], about: CloudAbout, *, where: str
) -> Iterator[PointWriter]:
    """Open a file for points in the format that its suffix names.

    Where the points end with an error, the file holds those that were written before it; where there are none, or
    the file itself cannot be written, there is none.

    Parameters
    ----------
    about : of all points
    where : what error lines call the file

    Raises
    ------
    InputError
        where the suffix names no format
    MissingExtraError
        where the library for a format is not there
    OutputError
        where the file cannot be opened, or another run writes it
    RunError
        where it cannot be written to its end
    """
    if path.suffix not in _WRITERS:
        raise InputError(where, f"found suffix '{path.suffix}'", ", ".join(_WRITERS))
    with OutputFile(path, where=where) as output:
        failed: Exception | None = None
        with output.writing() as file, ExitStack() as stack:
            writer = _WRITERS[path.suffix](file, columns, about, stack)
            try:
                yield writer
            except Exception as error:
                if isinstance(error, OSError) or not writer.points:
                    raise
                failed = error
            writer.finish()
        if failed:
            raise failed


def _whole(values: NDArray[Any], column: Column) -> NDArray[np.int64]:
    """Count units of the last decimal, (n, c)."""
    if column.is_float:
        values = np.rint(values.astype(np.float64) * 10**column.decimals)
    return values.reshape(len(values), len(column.csv)).astype(np.int64)
