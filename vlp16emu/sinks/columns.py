"""The columns of point clouds, and how each file format shows them."""

from enum import IntEnum

from vlp16emu.sinks.cloud import Column
from vlp16emu.types import PlantPart, Semantic

__all__ = [
    "CAPTURE_COLUMNS",
    "CAPTURE_COMMENTS",
    "RETURN_NAMES",
    "SCENE_COLUMNS",
    "TRUTH_COLUMNS",
    "scene_comments",
]

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
CAPTURE_COMMENTS = (
    "VLP-16 sensor frame in metres: azimuth 0 on +y, clockwise seen from above",
    "time in seconds on the sensor's clock",
)

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


def scene_comments(start_utc: str) -> tuple[str, ...]:
    """Say what the columns mean, for formats that have a place for it."""
    return (
        "x, y, z in the world: local east, north, up in metres",
        "sensor_x, sensor_y, sensor_z at the pulse's instant: azimuth 0 on +y, clockwise seen from above",
        f"time in seconds since the first pulse of the run at {start_utc}",
        f"return_number: {', '.join(f'{n} {name}' for n, name in enumerate(RETURN_NAMES))}",
        f"semantic: {_codes(Semantic)}",
        f"part: {_codes(PlantPart)}",
        "leaf_wood: 0 neither, 1 wood, 2 leaf",
    )


def _codes(labels: type[IntEnum]) -> str:
    """List numbers with their names."""
    return ", ".join(f"{label} {label.name.lower()}" for label in labels)
