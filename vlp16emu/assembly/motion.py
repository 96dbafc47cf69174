"""From the `[motion]` and `[imu]` tables to a carrier, and to what hangs on it."""

import logging
import math
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from vlp16emu.motion import (
    Gait,
    Harness,
    Imu,
    ImuErrors,
    Motion,
    Mount,
    Origin,
    Pace,
    Path,
    Recorded,
    RecordedPoses,
    Route,
    Standing,
    Stop,
    Walking,
    WayPoints,
    lawn_mower,
    mounted,
    read_kitti,
    read_trajectory_csv,
    read_tum,
    read_way_points,
    step_rate_hz,
    stops_on,
)
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.harness import Harness as HarnessSection
from vlp16emu.scenario.harness import Mount as MountSection
from vlp16emu.scenario.motion import Static, Walk
from vlp16emu.scenario.way import Recorded as RecordedSection
from vlp16emu.scenario.world import Woods
from vlp16emu.types import HeightField

__all__ = ["carrier_of", "imu_of", "mounted_on"]

_log = logging.getLogger(__name__)


def carrier_of(scenario: Scenario, height_m: HeightField, ground: str) -> tuple[Motion, NDArray[np.float64]]:
    """Make what carries the devices, over the ground of that name, and its way on the map (n, 2)."""
    section = scenario.motion
    if isinstance(section, Static):
        xy_m = np.array([[section.x_m, section.y_m]])
        position_m = np.append(xy_m[0], height_m(xy_m[:, 0], xy_m[:, 1])[0] + section.height_m)
        return Standing(position_m, section.yaw_deg, section.pitch_deg, section.roll_deg), xy_m
    if isinstance(section, RecordedSection):
        recorded = _recorded(section, scenario.start_ns)
        origin_m = scenario.world.origin_m if isinstance(scenario.world, Woods) else (0.0, 0.0, 0.0)
        _look_at_place(recorded.position_m, origin_m, height_m, scenario.sensor.max_range_m)
        return recorded, np.ascontiguousarray(recorded.position_m[:, :2])
    route, path = _route(section, scenario, height_m, ground)
    return _walking(section, scenario, route), path.xy_m


def mounted_on(carrier: Motion, section: MountSection, start_ns: int) -> Motion:
    """Hang a device on its carrier."""
    return mounted(carrier, Mount(**section.model_dump()), start_ns)


def imu_of(carrier: Motion, scenario: Scenario) -> Imu | None:
    """Hang an inertial measurement unit on the carrier, if there is one."""
    if (section := scenario.imu) is None:
        return None
    return Imu(
        mounted_on(carrier, section.mount, scenario.start_ns),
        start_ns=scenario.start_ns,
        rate_hz=section.rate_hz,
        errors=ImuErrors(**section.model_dump(exclude={"preset", "rate_hz", "mount"})),
        seed=scenario.seed,
        unit=0,
    )


def _walking(section: Walk, scenario: Scenario, route: Route) -> Walking:
    """Make the person."""
    gait = section.gait.model_dump(exclude={"preset"})
    gait["step_hz"] = section.gait.step_hz or step_rate_hz(route.speed_m_s)
    return Walking(
        route,
        start_ns=scenario.start_ns,
        speed_m_s=route.speed_m_s,
        height_m=section.sensor_height_m,
        gait=Gait(**gait),
        harness=_harness(section.harness),
        seed=scenario.seed,
    )


def _harness(section: HarnessSection | None) -> Harness | None:
    """Make the straps, unless the pack is strapped tight."""
    if section is None:
        return None
    position_hz = (section.fore_aft_hz, section.sideways_hz, section.vertical_hz)
    return Harness((*position_hz, section.roll_hz, section.pitch_hz, section.yaw_hz), section.damping_ratio)


def _route(section: Walk, scenario: Scenario, height_m: HeightField, ground: str) -> tuple[Route, Path]:
    """Lay the path, and pace it."""
    points = _way_points(section, scenario)
    path = Path(points.xy_m, height_m, ground)
    stops = stops_on(path, points.pause_s)
    stops += [Stop(stop.at_m, stop.pause_s) for stop in section.stops if stop.at_m is not None]
    pace = Pace(section.acceleration_m_s2, math.radians(section.yaw_rate_deg_s), stops)
    speed_m_s = None if section.run_time_s is not None else section.speed_m_s
    route = Route(path, laps=section.laps, pace=pace, speed_m_s=speed_m_s, run_time_s=section.run_time_s)
    return route, path


def _look_at_place(
    position_m: NDArray[np.float64],
    origin_m: tuple[float, float, float],
    height_m: HeightField,
    reach_m: float,
) -> None:
    """Warn of poses (n, 3) that lie about the world's origin on the map, below the ground, or out of its sight."""
    plan_m = position_m[:, :2]
    above_m = position_m[:, 2] - height_m(*plan_m.T)
    if (np.hypot(*(plan_m - origin_m[:2]).T) < np.hypot(*plan_m.T)).all():
        _log.warning(
            "motion: recorded poses begin at (%.1f, %.1f, %.1f) m, as if in map coordinates; origin_m is not taken off"
            " them: expected motion.x_m = %.10g, y_m = %.10g, z_m = %.10g",
            *(*position_m[0], *(-value for value in origin_m)),
        )
    elif above_m.min() < 0 or above_m.min() > reach_m:
        _log.warning(
            "motion: recorded poses lie from %.1f to %.1f m above the ground; expected above it and in sight of it"
            " (motion.z_m moves them)",
            *(above_m.min(), above_m.max()),
        )


def _way_points(section: Walk, scenario: Scenario) -> WayPoints:
    """Take the way points of a walk, and the pauses at them."""
    if section.lawn_mower is not None:
        xy_m = lawn_mower(**section.lawn_mower.model_dump())
        return WayPoints(xy_m, np.zeros(len(xy_m)))
    if section.way_points_file is not None:
        gps, world = scenario.gps, scenario.world
        points = read_way_points(
            FilePath(section.way_points_file),
            origin_m=world.origin_m[:2] if isinstance(world, Woods) else (0.0, 0.0),
            geodetic_origin=Origin(gps.latitude_deg, gps.longitude_deg, gps.height_m),
        )
    else:
        xy_m = np.array(section.way_points_m)
        points = WayPoints(xy_m, np.zeros(len(xy_m)))
    for stop in section.stops:
        if stop.way_point is not None:
            points = points.with_pause(stop.way_point, stop.pause_s)
    return points


def _recorded(section: RecordedSection, start_ns: int) -> Recorded:
    """Take poses that somebody has recorded."""
    placed = section.model_dump(include={"max_gap_s", "x_m", "y_m", "z_m", "yaw_deg", "axes"})
    return Recorded(_poses(section), start_ns=start_ns, **placed)


def _poses(section: RecordedSection) -> RecordedPoses:
    """Read them; the section has seen to it that only those of KITTI have their times told apart."""
    file = FilePath(section.file)
    if section.format == "tum":
        return read_tum(file)
    if section.times_file is not None:
        return read_kitti(file, FilePath(section.times_file))
    if section.rate_hz is not None:
        return read_kitti(file, section.rate_hz)
    return read_trajectory_csv(file)
