"""What is scored, as read from files: point clouds and stem lists."""

import csv
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import LARGEST_BYTES, InputError, MissingExtraError, readable

Cloud = dict[str, NDArray[Any]]

_PLACES = (
    ("world_m",),
    ("xyz_m",),
    ("xyz",),
    ("world_x_m", "world_y_m", "world_z_m"),
    tuple("xyz"),
    ("x_m", "y_m", "z_m"),
)
"""Columns that hold the place of a point, the world's before the sensor's."""
_LABELS = {"treeID": "instance", "tree_id": "instance", "treeid": "instance"}
"""Names of other tools for columns of ours."""
_KEPT = ("semantic", "part", "leaf_wood", "instance")
_NUMBERS = ("number", "tree", "treeid", "tree_id", "id")
_LARGEST_DBH_M = 15.0
"""Beyond that of any tree: the largest known, Taxodium mucronatum at Tule, has 11.6 m."""


@dataclass(frozen=True, slots=True)
class Stem:
    """One line of a stem list or of an inventory."""

    number: str
    """Of the list itself, kept as it is; the line where it has none."""
    x_m: float
    y_m: float
    z_m: float
    """NaN where the list has none."""
    dbh_m: float
    """NaN where the list has none."""
    list_line: str
    """Of the user's stem list that named the tree, in an inventory."""


def read_cloud(path: Path) -> Cloud:
    """Read the places of points, `xyz` (n, 3) in metres, and what labels they have (n,), from a file of a suffix in `_READERS`.

    InputError where it is no such file, has no points, or a NaN; MissingExtraError where the library of .pcd, .las or .laz is missing.
    """
    if path.suffix not in _READERS:
        raise InputError(str(path), f"found suffix '{path.suffix}'", ", ".join(_READERS))
    with readable(path, f"points as {path.suffix}", InputError, most_bytes=LARGEST_BYTES):
        try:
            columns = _READERS[path.suffix](path)
        except (ValueError, KeyError, IndexError, TypeError, EOFError) as error:
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise InputError(str(path), f"cannot be read ({reason})", f"points as {path.suffix}") from None
    columns = {_LABELS.get(name, name): values for name, values in columns.items()}
    place = next((names for names in _PLACES if all(name in columns for name in names)), None)
    if place is None:
        raise InputError(str(path), f"found columns {', '.join(columns)}", "x, y and z")
    xyz = np.column_stack([np.asarray(columns[name], np.float64) for name in place])
    if not len(xyz) or not np.isfinite(xyz).all():
        raise InputError(str(path), "found a NaN or infinity" if len(xyz) else "no points", "finite points")
    return {"xyz": xyz} | {name: np.asarray(columns[name]).astype(np.int64) for name in _KEPT if name in columns}


def _ply(path: Path) -> Cloud:
    import trimesh

    loaded = trimesh.load(path, process=False)
    data = loaded.metadata["_ply_raw"]["vertex"]["data"]
    names = data.dtype.names if isinstance(data, np.ndarray) else data
    return {name: np.asarray(data[name]).reshape(len(data[name]), -1)[:, 0] for name in names}


def _npz(path: Path) -> Cloud:
    with np.load(path) as arrays:
        return dict(arrays)


def _csv(path: Path) -> Cloud:
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    if table.size and table.shape[1] != len(names):
        raise ValueError(f"{table.shape[1]} columns under {len(names)} names")
    return dict(zip(names, table.T, strict=False))


def _library(name: str, path: Path) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise MissingExtraError(name, "cloud", f"reading {path.suffix}") from None


def _las(path: Path) -> Cloud:
    laspy = _library("laspy", path)
    try:
        las = laspy.read(path)
    except laspy.errors.LaspyException as error:
        raise ValueError(str(error)) from None
    names = [name for name in las.point_format.dimension_names if name in (*_KEPT, *_LABELS)]
    return {"xyz": np.asarray(las.xyz)} | {name: np.asarray(las[name]) for name in names}


def _pcd(path: Path) -> Cloud:
    cloud = _library("pypcd4", path).PointCloud.from_path(path)
    data = np.atleast_1d(cloud.pc_data)
    return {name: data[name].reshape(len(data), -1)[:, 0] for name in cloud.fields}


_READERS: Mapping[str, Callable[[Path], Cloud]] = MappingProxyType(
    {".ply": _ply, ".npz": _npz, ".csv": _csv, ".pcd": _pcd, ".las": _las, ".laz": _las}
)


def read_stems(path: Path) -> tuple[Stem, ...]:
    """Read a CSV of stems: x, y (or x_m, y_m), and if there are z, dbh_m or dbh (m), dbh_cm, and a number of the tree.

    InputError where it is none, a cell is no number, a number of a tree is there twice, or a DBH is in another unit.
    """
    expected = "a CSV of stems with columns x and y"
    with readable(path, expected, InputError), path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file)
        reader.fieldnames = [name.strip().lower() for name in reader.fieldnames or ()]
        rows = [(f"{path}, line {reader.line_num}", reader.line_num, row) for row in reader]
    if not any(name in reader.fieldnames for name in ("x", "x_m")):
        raise InputError(str(path), f"found columns {', '.join(reader.fieldnames) or 'none'}", expected)
    stems: dict[str, Stem] = {}
    for where, line, row in rows:
        stem = _stem(where, line, row)
        if stem.number in stems:
            raise InputError(where, f"found tree {stem.number} twice", "a number of its own for each tree")
        stems[stem.number] = stem
    return tuple(stems.values())


def _stem(where: str, line: int, row: Mapping[str, str | None]) -> Stem:
    x_m, y_m = _cell(where, row, "x", "x_m"), _cell(where, row, "y", "y_m")
    if not math.isfinite(x_m + y_m):
        raise InputError(where, "found no x or no y", "numbers of metres")
    dbh_m = _cell(where, row, "dbh_m", "dbh")
    if math.isnan(dbh_m):
        dbh_m = _cell(where, row, "dbh_cm") / 100
    if dbh_m <= 0 or dbh_m > _LARGEST_DBH_M:
        expected = f"more than 0 and at most {_LARGEST_DBH_M:g} m; `dbh_cm` is in centimetres"
        raise InputError(where, f"found DBH {dbh_m:g} m", expected)
    number = next((value.strip() for name in _NUMBERS if (value := row.get(name))), str(line))
    return Stem(number, x_m, y_m, _cell(where, row, "z", "z_m"), dbh_m, row.get("list_line") or "")


def _cell(where: str, row: Mapping[str, str | None], *names: str) -> float:
    """Read the number under the first of these names that is there, NaN where nothing is."""
    text = next((value.strip() for name in names if (value := row.get(name))), "")
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise InputError(where, f"found {text}", f"a number in column {names[0]}") from None
