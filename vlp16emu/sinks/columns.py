"""Columns of point files: what each holds, and how each format shows it."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets import PointFrame
from vlp16emu.types import PlantPart, Semantic

Block = Mapping[str, NDArray[Any]]
"""Arrays of one length by the names of their columns."""


@dataclass(frozen=True, slots=True)
class Column:
    """One array of the points, and how each format shows it."""

    name: str
    """In .npz."""
    dtype: str
    csv: tuple[str, ...]
    """Headers, one for each number that a point has in this column."""
    decimals: int = 0
    """Behind the point in .csv. Whole numbers with decimals count units of the last one."""
    ply: tuple[str, ...] = ()
    """Names of properties, as many; empty for a column that .ply leaves out."""
    ply_dtype: str = ""
    """Type of the properties where it is not that of the array."""

    @property
    def is_fixed_point(self) -> bool:
        """Whether whole numbers stand for fractions."""
        return self.decimals > 0 and not self.is_float

    @property
    def is_float(self) -> bool:
        """Whether the array holds floating-point numbers."""
        return np.dtype(self.dtype).kind == "f"

    def properties(self, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Arrays (n,) of the properties by name, fixed-point numbers as fractions.

        Parameters
        ----------
        values : the array of this column
        """
        if self.is_fixed_point:
            values = values / 10**self.decimals
        return dict(zip(self.ply, values.reshape(len(values), len(self.ply)).T, strict=True))


@dataclass(frozen=True, slots=True)
class CloudAbout:
    """What a file says of its points as a whole, where its format has a place for it."""

    comments: tuple[str, ...]
    """Lines for people."""
    start_utc: datetime | None = None
    """From when the times of the points count, where that is known; also the date of the file."""
    origin: tuple[float, float, float] | None = None
    """Latitude and longitude in degrees and height in metres (WGS 84) of (0, 0, 0), where the points are in a world."""
    unit: int = 1
    """Which sensor of a rig, from 1."""


LEAF_OR_WOOD = np.array([0, 1, 1, 1, 2, 1, 1], np.uint8)
"""Leaf (2) or wood (1) by `PlantPart`; 0 neither."""

RETURN_NAMES = ("strongest", "last", "second_strongest")
"""What the numbers in the column `return_number` mean."""

CAPTURE_COLUMNS = (
    Column("clock_ns", "<i8", ("time_s",), 9, ("time",), "<f8"),
    Column("xyz_m", "<f4", ("x_m", "y_m", "z_m"), 4, ("x", "y", "z")),
    Column("distance_m", "<f4", ("distance_m",), 3),
    Column("azimuth_deg", "<f8", ("azimuth_deg",), 4),
    Column("reflectivity", "|u1", ("reflectivity",), 0, ("intensity",), "<f4"),
    Column("ring", "|u1", ("ring",), 0, ("ring",), "<u2"),
    Column("laser", "|u1", ("laser",)),
    Column("is_last", "|b1", ("is_last",)),
)
"""Of points of a capture: the arrays of `Points`, and the sensor's clock."""
_AXES = {
    PointFrame.SENSOR: "x forward (azimuth 0), y left, z up",
    PointFrame.MANUAL: "x right, y forward (azimuth 0), z up: the frame of Velodyne's manual",
}


def capture_comments(frame: PointFrame) -> tuple[str, ...]:
    """Say what the columns of a capture's points mean, for formats that have a place for it."""
    return f"x, y, z in the sensor, in metres: {_AXES[frame]}", "time in seconds on the sensor's clock"


SCENE_COLUMNS = (
    Column("t_ns", "<i8", ("t_ns",)),
    Column("since_start_ns", "<i8", ("time_s",), 9, ("time",), "<f8"),
    Column("world_m", "<f8", ("world_x_m", "world_y_m", "world_z_m"), 4, ("x", "y", "z")),
    Column("sensor_m", "<f4", ("x_m", "y_m", "z_m"), 4, ("sensor_x", "sensor_y", "sensor_z")),
    Column("distance_m", "<f4", ("distance_m",), 4, ("distance",)),
    Column("azimuth_deg", "<f8", ("azimuth_deg",), 4, ("azimuth",), "<f4"),
    Column("elevation_deg", "<f4", ("elevation_deg",), 4, ("elevation",)),
    Column("reflectivity", "|u1", ("reflectivity",), 0, ("intensity",), "<f4"),
    Column("ring", "<u2", ("ring",), 0, ("ring",)),
    Column("laser", "<u2", ("laser",), 0, ("laser",)),
    Column("return_number", "|u1", ("return_number",), 0, ("return_number",)),
)
"""Of points of a scene."""
TRUTH_COLUMNS = (
    Column("semantic", "|u1", ("semantic",), 0, ("semantic",)),
    Column("part", "|u1", ("part",), 0, ("part",)),
    Column("leaf_wood", "|u1", ("leaf_wood",), 0, ("leaf_wood",)),
    Column("instance", "<u4", ("instance",), 0, ("instance",)),
    Column("species", "<u2", ("species",), 0, ("species",)),
    Column("reflectance", "<f4", ("reflectance",), 4, ("reflectance",)),
)
"""Of the surface behind each point of a scene."""


_VIEWPOINT = Column(
    "viewpoint_m", "<f8", ("viewpoint_x_m", "viewpoint_y_m", "viewpoint_z_m"), 4, ("vp_x", "vp_y", "vp_z")
)
DESKEWED_COLUMNS = (
    *(column for column in SCENE_COLUMNS if column.name not in ("elevation_deg", "return_number")),
    Column("is_last", "|u1", ("is_last",), 0, ("is_last",)),
    _VIEWPOINT,
)
"""Of points of a capture that a trajectory places in the world."""
LABEL_COLUMNS = (
    Column("label", "|u1", ("label",), 0, ("label",)),
    Column("tree_id", "<u4", ("tree_id",), 0, ("treeID",)),
    Column("height_m", "<f4", ("height_above_ground_m",), 4, ("height_above_ground",)),
    _VIEWPOINT,
)
"""Beside the truth, for a scheme of labels."""


def scene_comments(start_utc: str) -> tuple[str, ...]:
    """Say what the columns mean, for formats that have a place for it."""
    return (
        "x, y, z in the world: local east, north, up in metres",
        f"sensor_x, sensor_y, sensor_z at the pulse's instant: {_AXES[PointFrame.SENSOR]}",
        f"time in seconds since the first pulse of the run at {start_utc}",
        f"return_number: {', '.join(f'{n} {name}' for n, name in enumerate(RETURN_NAMES))}",
        f"semantic: {_codes(Semantic)}",
        f"part: {_codes(PlantPart)}",
        "leaf_wood: 0 neither, 1 wood, 2 leaf",
    )


def _codes(labels: type[IntEnum]) -> str:
    return ", ".join(f"{label} {label.name.lower()}" for label in labels)
