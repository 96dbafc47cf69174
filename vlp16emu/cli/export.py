"""Points into files for other programs."""

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError, OutputError, RunError
from vlp16emu.packets import Points
from vlp16emu.units import S_NS

__all__ = ["PointWriter", "writing"]


class PointWriter(Protocol):
    """Takes points chunk by chunk."""

    def write(self, points: Points, clock_ns: NDArray[np.int64]) -> None:
        """Add points, and (n,) their time on the sensor's clock."""

    def finish(self) -> None:
        """Write what could not be written before all points were known."""


class _Csv:
    """One line per point; the header names the units."""

    _COLUMNS = "time_s,x_m,y_m,z_m,distance_m,azimuth_deg,reflectivity,ring,laser,is_last"
    _FORMAT = ("%.9f", "%.4f", "%.4f", "%.4f", "%.3f", "%.4f", "%d", "%d", "%d", "%d")

    def __init__(self, file: io.BufferedWriter) -> None:
        self._file = file
        file.write(f"{self._COLUMNS}\n".encode())

    def write(self, points: Points, clock_ns: NDArray[np.int64]) -> None:
        """Append lines."""
        columns = (
            clock_ns / S_NS,
            *points.xyz_m.T,
            points.distance_m,
            points.azimuth_deg,
            points.reflectivity,
            points.ring,
            points.laser,
            points.is_last,
        )
        np.savetxt(self._file, np.column_stack(columns), fmt=self._FORMAT, delimiter=",")

    def finish(self) -> None:
        """Nothing left to do."""


class _Ply:
    """Binary little-endian PLY; the number of points is filled in at the end."""

    _PROPERTIES = (
        ("x", "float", "<f4"),
        ("y", "float", "<f4"),
        ("z", "float", "<f4"),
        ("intensity", "float", "<f4"),
        ("ring", "ushort", "<u2"),
        ("time", "double", "<f8"),
    )
    _VERTEX = np.dtype([(name, code) for name, _, code in _PROPERTIES])

    def __init__(self, file: io.BufferedWriter) -> None:
        self._file = file
        self._points = 0
        file.write(self._header())

    def write(self, points: Points, clock_ns: NDArray[np.int64]) -> None:
        """Append vertices."""
        vertices = np.empty(len(points.ring), self._VERTEX)
        vertices["x"], vertices["y"], vertices["z"] = points.xyz_m.T
        vertices["intensity"] = points.reflectivity
        vertices["ring"] = points.ring
        vertices["time"] = clock_ns / S_NS
        self._file.write(vertices.tobytes())
        self._points += len(vertices)

    def finish(self) -> None:
        """Go back and tell how many points there are."""
        self._file.seek(0)
        self._file.write(self._header())

    def _header(self) -> bytes:
        """Header of a length that does not depend on the number of points."""
        lines = [
            "ply",
            "format binary_little_endian 1.0",
            "comment VLP-16 sensor frame in metres: azimuth 0 on +y, clockwise seen from above",
            "comment time in seconds on the sensor's clock",
            f"element vertex {self._points:<20}",
            *(f"property {kind} {name}" for name, kind, _ in self._PROPERTIES),
            "end_header\n",
        ]
        return "\n".join(lines).encode("ascii")


class _Npz:
    """Numpy arrays by the names of `Points`, and `clock_ns`."""

    def __init__(self, file: io.BufferedWriter) -> None:
        self._file = file
        self._chunks: list[dict[str, NDArray[np.generic]]] = []

    def write(self, points: Points, clock_ns: NDArray[np.int64]) -> None:
        """Keep arrays until the end: the format needs their length first."""
        names = ("xyz_m", "distance_m", "azimuth_deg", "reflectivity", "ring", "laser", "is_last")
        self._chunks.append({name: getattr(points, name) for name in names} | {"clock_ns": clock_ns})

    def finish(self) -> None:
        """Write all arrays."""
        joined = {name: np.concatenate([chunk[name] for chunk in self._chunks]) for name in self._chunks[0]}
        np.savez(self._file, allow_pickle=False, **joined)


_WRITERS: dict[str, Callable[[io.BufferedWriter], PointWriter]] = {".csv": _Csv, ".npz": _Npz, ".ply": _Ply}


@contextmanager
def writing(path: Path) -> Iterator[PointWriter]:
    """Open a file for points in the format that its suffix names.

    Raises
    ------
    InputError
        where the suffix names no format
    OutputError
        where the file cannot be opened
    RunError
        where it cannot be written to its end
    """
    if path.suffix not in _WRITERS:
        raise InputError(f"--out {path}", f"found suffix '{path.suffix}'", ", ".join(_WRITERS))
    try:
        file = path.open("wb")
    except OSError as error:
        raise OutputError(f"--out {path}", str(error.strerror), "a file that can be written") from error
    try:
        with file:
            writer = _WRITERS[path.suffix](file)
            yield writer
            writer.finish()
    except OSError as error:
        raise RunError(f"--out {path}: {error.strerror}; the file is not complete") from error
