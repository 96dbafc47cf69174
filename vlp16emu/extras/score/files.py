"""Files that are scored: point clouds and stem lists."""

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from vlp16emu.child import read_in_child
from vlp16emu.errors import InputError
from vlp16emu.inputs import LARGEST_BYTES, parsing, readable
from vlp16emu.libraries import check_extra
from vlp16emu.tables import LARGEST, Column, optional, read_table
from vlp16emu.types import AnyArray

Cloud = dict[str, AnyArray]

_PLACES = [
    names.split()
    for names in ("world_m", "xyz_m", "xyz", "world_x_m world_y_m world_z_m", "x y z", "x_m y_m z_m")
]  # names of columns with the position of a point; the world's come before the sensor's
_INSTANCES = ("instance", "treeID", "tree_id", "treeid")
"""Names of the column of instances, ours and other tools'; the first one in the file counts."""
_KEPT = ("semantic", "part", "leaf_wood", "instance")
_LARGEST_LABEL = 2**53  # whole numbers below it are exact in float64
_MOST_UNPACKED_BYTES = 8_000_000_000  # of a .npz
_NUMBERS = ("number", "tree", "treeid", "tree_id", "id")
_LARGEST_DBH_M = 15.0  # the largest tree known, Taxodium mucronatum at Tule, has 11.6 m
_COLUMNS = {
    "x_m": Column({"x": 1.0, "x_m": 1.0}),
    "y_m": Column({"y": 1.0, "y_m": 1.0}),
    "x_breast_m": optional("x_breast_m"),
    "y_breast_m": optional("y_breast_m"),
    "z_m": optional("z", "z_m"),
    "dbh_m": Column(
        {"dbh_m": 1.0, "dbh": 1.0, "dbh_cm": 0.01},
        0.001,
        _LARGEST_DBH_M,
        is_needed=False,
        is_filled=False,
        zero_is_missing=True,  # of a stem that 3DFin could not fit
    ),
    **{name: optional(name) for name in (*_NUMBERS, "list_line")},
}


@dataclass(frozen=True, slots=True)
class Stem:
    """One line of a stem list or of an inventory."""

    number: str  # number in the list, kept as it is; the line if there is none
    # position of the stem at breast height if the list has it, as inventories do; else its position
    x_m: float
    y_m: float
    z_m: float  # foot; NaN if the list has none
    dbh_m: float  # NaN if the list has none
    list_line: str  # line of the user's stem list that named the tree, in an inventory


def read_cloud(path: Path) -> Cloud:
    """Read the positions of points, `xyz` (n, 3) in metres, and their labels (n,).

    InputError if the suffix is not in `_READERS`, the file is not of this format, or has no points or a NaN;
    MissingExtraError without the library for it.
    """
    if path.suffix not in _READERS:
        raise InputError(str(path), f"found the ending {path.suffix!r}", ", ".join(_READERS))
    expected = f"points as {path.suffix}"
    library = _LIBRARIES.get(path.suffix)
    if library is None:
        with readable(path, expected, InputError, most_bytes=LARGEST_BYTES):
            columns = _READERS[path.suffix](path)
    else:
        check_extra("cloud", f"reading {path.suffix}", library)
        columns = read_in_child(_READERS[path.suffix], path, expected, InputError)
    return _checked(path, columns, expected)


def _checked(path: Path, columns: Cloud, expected: str) -> Cloud:
    """Return positions and labels of the columns of a file; InputError if they are malformed."""
    instances = [name for name in _INSTANCES if name in columns]
    if instances:
        columns["instance"] = columns[instances[0]]
    place = next((names for names in _PLACES if all(name in columns for name in names)), None)
    if place is None:
        raise InputError(str(path), f"found columns {', '.join(columns)}", "x, y and z")
    kept = [name for name in _KEPT if name in columns]
    with parsing(path, expected, InputError):
        xyz = np.column_stack([np.asarray(columns[name], np.float64) for name in place])
        labels = {name: np.asarray(columns[name], np.float64) for name in kept}
    if xyz.shape[1] != 3:
        raise InputError(str(path), f"found positions of {xyz.shape[1]} numbers", "x, y and z")
    if not len(xyz) or not np.isfinite(xyz).all():
        raise InputError(str(path), "found a NaN or infinity" if len(xyz) else "no points", "finite points")
    if (np.abs(xyz) > LARGEST).any():
        raise InputError(str(path), f"found {np.abs(xyz).max():g}", f"positions of at most {LARGEST:g} m")
    for name, values in labels.items():
        if values.shape != (len(xyz),):
            raise InputError(f"{path}: {name}", f"found {values.shape}", f"({len(xyz)},), one for each point")
        is_wrong = ~(np.abs(values) < _LARGEST_LABEL)  # NaN too
        if is_wrong.any():
            found = f"found {values[is_wrong.argmax()]:g}"
            raise InputError(f"{path}: {name}", found, f"whole numbers below {_LARGEST_LABEL}")
    return {"xyz": xyz} | {name: values.astype(np.int64) for name, values in labels.items()}


def _ply(path: Path) -> Cloud:
    import trimesh

    data = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
    names = data.dtype.names if isinstance(data, np.ndarray) else data
    return {name: np.asarray(data[name]).reshape(len(data[name]), -1)[:, 0] for name in names}


def _npz(path: Path) -> Cloud:
    with zipfile.ZipFile(path) as archive:
        unpacked_bytes = sum(member.file_size for member in archive.infolist())
    if unpacked_bytes > _MOST_UNPACKED_BYTES:
        raise ValueError(f"{unpacked_bytes} bytes when unpacked")
    with np.load(path) as arrays:
        return dict(arrays)


def _csv(path: Path) -> Cloud:
    with path.open(encoding="utf-8-sig") as file:
        names = [name.strip() for name in file.readline().split(",")]
        table = np.loadtxt(file, delimiter=",", ndmin=2)
    if table.size and table.shape[1] != len(names):
        raise ValueError(f"{table.shape[1]} columns under {len(names)} names")
    return dict(zip(names, table.T, strict=False))


def las_points(path: Path) -> Cloud:
    """Read the points of a LAS or LAZ file, `xyz` (n, 3), and their labels."""
    import laspy

    las = laspy.read(path)
    names = [name for name in las.point_format.dimension_names if name in (*_KEPT, *_INSTANCES)]
    return {"xyz": np.asarray(las.xyz)} | {name: np.asarray(las[name]) for name in names}


def pcd_points(path: Path) -> Cloud:
    """Read the fields of a PCD file."""
    from pypcd4.pypcd4 import PointCloud

    cloud = PointCloud.from_path(path)
    data = np.atleast_1d(cloud.pc_data)
    return {name: data[name].reshape(len(data), -1)[:, 0] for name in cloud.fields}


_READERS: Mapping[str, Callable[[Path], Cloud]] = MappingProxyType(
    {".ply": _ply, ".npz": _npz, ".csv": _csv, ".pcd": pcd_points, ".las": las_points, ".laz": las_points}
)
_LIBRARIES = MappingProxyType({".pcd": "pypcd4", ".las": "laspy", ".laz": "laspy"})
"""Compiled libraries, which read in a child process."""


def read_stems(path: Path) -> tuple[Stem, ...]:
    """Read a CSV of stems with columns x, y (or x_m, y_m).

    Optional columns are z, x_breast_m, y_breast_m, dbh_m or dbh (m), dbh_cm, and a number.
    InputError if it is no such CSV, a cell is no number, two trees have one number, or a DBH is in another
    unit.
    """
    table = read_table(path, _COLUMNS, "a CSV of stems with columns x and y", InputError)
    places = table.numbers("x_m", "y_m", "z_m", "dbh_m")
    # Stem maps give positions at breast height, for example 3DFin (dendromatics, `tree_locator`: the section
    # nearest to 1.3 m); a leaning stem is not above its foot there.
    breast_m = table.numbers("x_breast_m", "y_breast_m")
    places[:, :2] = np.where(np.isnan(breast_m), places[:, :2], breast_m)
    numbers = zip(*(table.texts(name) for name in _NUMBERS), strict=True)
    list_lines = table.texts("list_line")
    stems: dict[str, Stem] = {}
    for row, (place, given) in enumerate(zip(places.tolist(), numbers, strict=True)):
        x_m, y_m, z_m, dbh_m = place
        number = next(filter(None, given), str(table.lines[row]))
        if number in stems:
            raise InputError(
                table.where(row), f"found tree {number} twice", "a number of its own for each tree"
            )
        stems[number] = Stem(number, x_m, y_m, z_m, dbh_m, list_lines[row])
    return tuple(stems.values())
