"""A run as points with all that is known of them, straight from the returns and not through packets."""

from collections.abc import Iterator
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.assembly import Unit
from vlp16emu.cli.export import Block, Column
from vlp16emu.emulator import Emulator
from vlp16emu.sensor import place
from vlp16emu.types import SURFACE, PlantPart, ReturnMode, Returns, Semantic
from vlp16emu.units import seconds_to_ns

__all__ = ["COLUMNS", "RETURN_NAMES", "TRUTH_COLUMNS", "cloud", "comments"]

RETURN_NAMES = ("strongest", "last", "second_strongest")
"""What the numbers in the column `return_number` mean."""

_LEAF_OR_WOOD = np.array(
    [0 if p is PlantPart.NONE else 2 if p is PlantPart.LEAF else 1 for p in PlantPart], "u1"
)

COLUMNS = (
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
"""What is told of each point."""
TRUTH_COLUMNS = (
    Column("semantic", "|u1", ("semantic",), 0, ("semantic",)),
    Column("part", "|u1", ("part",), 0, ("part",)),
    Column("leaf_wood", "|u1", ("leaf_wood",), 0, ("leaf_wood",)),
    Column("instance", "<u4", ("instance",), 0, ("instance",)),
    Column("species", "<u2", ("species",), 0, ("species",)),
    Column("reflectance", "<f4", ("reflectance",), 4, ("reflectance",)),
)
"""What no sensor tells: the surface behind each point."""


def comments(start_utc: str) -> tuple[str, ...]:
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


def cloud(
    emulator: Emulator, number: int, start_s: float, stop_s: float, *, truth: bool
) -> Iterator[tuple[Block, int]]:
    """Points of all pulses fired in a span, block by block, and when the block ends, ns since the first pulse.

    Parameters
    ----------
    number : of the unit, from 0
    truth : whether `TRUTH_COLUMNS` are wanted; the emulator must keep the truth then

    Raises
    ------
    TrajectoryError
        where the walk is over before `stop_s`
    """
    start_ns = emulator.scenario.start_ns
    begin_ns, end_ns = start_ns + seconds_to_ns(start_s), start_ns + seconds_to_ns(stop_s)
    unit, sequence_ns = emulator.parts.units[number], emulator.parts.head.beams.sequence_ns
    returns = emulator.returns(start_s, stop_s, number)  # checks the span before anybody opens a file

    def blocks() -> Iterator[tuple[Block, int]]:
        """Points of each block, and the time until which they reach."""
        for block in returns:
            next_ns = int(block.firings.t_ns[-1, 0]) + sequence_ns
            made = _points(unit, block, begin_ns, end_ns, start_ns, truth=truth)
            yield made, min(next_ns, end_ns) - start_ns

    return blocks()


def _points(unit: Unit, returns: Returns, begin_ns: int, end_ns: int, start_ns: int, *, truth: bool) -> Block:
    """Make points of the returns of pulses from `begin_ns` until before `end_ns`, UTC."""
    firings, beams, t_ns = returns.firings, unit.head.beams, returns.firings.t_ns
    inside = (t_ns >= begin_ns) & (t_ns < end_ns)
    told = _told(returns.distance_m, ReturnMode(unit.section.return_mode)) & inside[..., None]
    sequence, laser, number = np.nonzero(told)
    distance_m, pulse_ns = returns.distance_m[told], t_ns[sequence, laser]
    placed = place(beams, firings, sequence, laser, distance_m, unit.motion.poses_at(pulse_ns))
    block: dict[str, NDArray[Any]] = {
        "t_ns": pulse_ns,
        "since_start_ns": pulse_ns - start_ns,
        "world_m": placed.world_m,
        "sensor_m": placed.sensor_m,
        "distance_m": distance_m,
        "azimuth_deg": placed.azimuth_deg,
        "elevation_deg": placed.elevation_deg,
        "reflectivity": returns.reflectivity[told],
        "ring": beams.ring[laser],
        "laser": laser,
        "return_number": number,
    }
    return block | _labels(returns, told) if truth else block


def _told(distance_m: NDArray[np.float32], mode: ReturnMode) -> NDArray[np.bool_]:
    """(k, L, 3) which returns the sensor would tell of: each echo once, a lone one as the strongest.

    The rules of dual return: 63-9243 Rev D, section 9.3.2.
    """
    told = distance_m > 0
    if mode is ReturnMode.DUAL:
        same = distance_m[..., 0] == distance_m[..., 1]
        told[..., 1] &= ~same
        told[..., 2] &= same
    else:
        told &= np.arange(3) == (1 if mode is ReturnMode.LAST else 0)
    return told


def _labels(returns: Returns, told: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Look up the surface behind each point; what fog or rain throws back is of no class."""
    assert returns.surface is not None
    assert returns.surfaces is not None
    surfaces = np.append(returns.surfaces, np.zeros(1, SURFACE))  # the last row stands for `NO_SURFACE`
    rows = surfaces[np.minimum(returns.surface[told], len(returns.surfaces))]
    names = ("semantic", "part", "instance", "species", "reflectance")
    return {name: rows[name] for name in names} | {"leaf_wood": _LEAF_OR_WOOD[rows["part"]]}
