"""The motion of the carrier, from the table `[motion]` and the ground."""

import logging
import math

import numpy as np

from vlp16emu.doors import door
from vlp16emu.elementary import norm
from vlp16emu.motion.path import Path
from vlp16emu.motion.pose import Kinematics, Motion, rotation
from vlp16emu.motion.route import Route
from vlp16emu.motion.settings import Gait, Gps, MotionSection, Static, Walk
from vlp16emu.motion.walk import WalkMotion
from vlp16emu.motion.way_points import way_points
from vlp16emu.types import Array, HeightField, IntArray, Poses

_log = logging.getLogger(__name__)


class StaticMotion:
    """A sensor on a tripod at a place (3,) in the world, turned as by `motion.pose.rotate`: one pose, computed once."""

    run_time_s = math.inf
    moves = False

    def __init__(self, position_m: Array, yaw_deg: float, pitch_deg: float, roll_deg: float) -> None:
        turn = rotation(yaw_deg, pitch_deg, roll_deg)
        self._poses = Poses(np.zeros(1, np.int64), turn[None], position_m[None])

    def poses_at(self, t_ns: IntArray) -> Poses:  # noqa: ARG002  # the same at all times
        """Return the one pose."""
        return self._poses

    def kinematics_at(self, t_ns: IntArray) -> Kinematics:
        """Repeat the one pose at instants (n,), without any motion."""
        n, still = len(t_ns), np.zeros((len(t_ns), 3))
        turns = np.repeat(self._poses.world_R_body, n, axis=0)
        return Kinematics(t_ns, turns, np.repeat(self._poses.world_p_body_m, n, axis=0), *(still,) * 4)


def make_carrier(
    section: MotionSection,
    height_m: HeightField,
    ground: str,
    *,
    origin_m: tuple[float, float, float],
    gps: Gps,
    reach_m: float,
    start_ns: int,
    seed: int,
    obstacles: tuple[Array, Array] | None = None,
) -> tuple[Motion, Array]:
    """Return the motion of what carries the devices over the ground, and points (n, 2) of its path on the map.

    Raises TrajectoryError if a person cannot walk so, or recorded poses are no smooth motion.

    Parameters
    ----------
    ground : name of all that decides its height
    origin_m : easting, northing and height in maps that are (0, 0, 0) in the world
    gps : where on earth that is
    reach_m : how far the sensor sees
    start_ns : UTC of the first pulse
    obstacles : places (n, 2) that waypoints lead around, and how far (n,) from each
    """
    if isinstance(section, Static):
        xy_m = np.array([[section.x_m, section.y_m]])
        position_m = np.append(xy_m[0], height_m(xy_m[:, 0], xy_m[:, 1])[0] + section.height_m)
        return StaticMotion(position_m, section.yaw_deg, section.pitch_deg, section.roll_deg), xy_m
    if not isinstance(section, Walk):
        motion, xy_m = section.carrier(height_m, start_ns)
        if (places_m := getattr(motion, "position_m", None)) is not None:  # as recorded poses have, before the run
            _check_place(places_m, origin_m, height_m, reach_m)
        return motion, xy_m
    _check_gait(section.gait, section.sensor_height_m)
    points = way_points(section, gps, origin_m[:2])
    if obstacles is not None:
        points = door("way_around")(points, *obstacles)
    path = Path(points.xy_m, height_m, ground)
    route = Route(path, section, points.pause_s)
    return WalkMotion(section, route, start_ns=start_ns, seed=seed), path.xy_m


def _check_gait(gait: Gait, sensor_height_m: float) -> None:
    """Warn of a gait that lowers the sensor below the ground, from where nothing of the world is seen."""
    # The lowest point of a step that is one sigma deeper than others.
    dip_m = (1.0 + gait.variation) * (gait.vertical_m + gait.second_harmonic_m + gait.heel_strike_m)
    if dip_m >= sensor_height_m:
        _log.warning(
            "motion.gait: lowers the sensor by %.2f m, into the ground; expected less than sensor_height_m = %g m",
            *(dip_m, sensor_height_m),
        )


def _check_place(
    position_m: Array, origin_m: tuple[float, float, float], height_m: HeightField, reach_m: float
) -> None:
    """Warn of poses (n, 3) that lie about the world's origin on the map, below the ground, or out of its sight."""
    plan_m = position_m[:, :2]
    above_m = position_m[:, 2] - height_m(*plan_m.T)
    if (norm(plan_m - origin_m[:2]) < norm(plan_m)).all():  # the origin as maps have it is nearer than (0, 0)
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
