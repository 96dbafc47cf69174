"""Motion of a body along recorded poses."""

import logging
import math

import numpy as np

from vlp16emu.elementary import acos, cos, norm, sin
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.recorded.files import RecordedPoses
from vlp16emu.extras.recorded.settings import Recorded
from vlp16emu.extras.splines import Spline, interpolant
from vlp16emu.motion.piecewise import POWERS, KnotMotion
from vlp16emu.types import F8, I8
from vlp16emu.units import S_NS
from vlp16emu.world.settings import Site

_log = logging.getLogger(__name__)

_MOST_TURN_DEG = 90.0
"""Greatest turn from one pose to the next: half the angle at which the sense of a turn is undefined."""
_LEAST_NORM = 0.5
"""Least norm of the quaternion spline: it is 1 at each pose; the lower it is between poses, the more it
distorts the turn."""
_LOOKS = 8  # samples of this norm between two poses


class RecordedMotion(KnotMotion):
    """Recorded poses, interpolated with two continuous derivatives in position and rotation.

    Positions and quaternions are cubic splines. Each quaternion has the sign that is nearer to the one
    before, and the spline scaled to unit length is the rotation. On a steady turn of 10 degrees from pose
    to pose the rotation is correct within 1e-6 rad.

    Raises TrajectoryError if the time between two poses is above the greatest gap, the turn between them is
    above 90 degrees, or times are too uneven for a smooth turn.

    Parameters
    ----------
    recorded : greatest gap between poses, place and axes of the recording
    poses : recorded poses
    start_ns : UTC of the first pose
    """

    def __init__(self, recorded: Recorded, poses: RecordedPoses, *, start_ns: int) -> None:
        knots_ns = poses.t_ns - poses.t_ns[0]
        self.run_time_s = float(knots_ns[-1] / S_NS)
        quaternion = _sign_continuous(poses.quaternion)
        _check_steps(poses, knots_ns, quaternion, recorded.max_gap_s)
        position_m, quaternion = _to_world(recorded, poses.position_m, quaternion)
        spline = interpolant(knots_ns / S_NS, np.column_stack([position_m, quaternion]))
        _check_norm(poses, spline)
        powers = np.zeros((len(knots_ns) - 1, 7, POWERS))
        powers[..., : len(spline.powers)] = np.moveaxis(spline.powers, 0, -1)
        super().__init__(start_ns, knots_ns, powers)
        self.position_m = powers[:, :3, 0].copy()  # (n - 1, 3) of all poses but the last, in the world


def _check_norm(poses: RecordedPoses, spline: Spline) -> None:
    """Refuse a spline (7 values) whose quaternion is too short or too long between two poses."""
    found = "no smooth turn leads here from the pose before: times are too uneven"
    steps_s = np.diff(spline.breaks)
    for look in range(1, _LOOKS):
        quaternion = spline(spline.breaks[:-1] + look / _LOOKS * steps_s)[:, 3:]
        off = np.abs(norm(quaternion) - 1.0)
        _refuse(poses, off, 1.0 - _LEAST_NORM, found, "poses at more even times")


def _refuse(poses: RecordedPoses, values: F8, most: float, found: str, expected: str) -> None:
    """Raise TrajectoryError for the first step (n - 1,) with a value above `most`; `found` formats it."""
    if (values > most).any():
        i = int((values > most).argmax())
        raise TrajectoryError(poses.where[i + 1], found.format(values[i]), expected)


def _sign_continuous(quaternion: F8) -> F8:
    """Return the same rotations (n, 4), each with the sign that is nearer to the one before."""
    flips = (quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0
    sign = np.cumprod(np.concatenate([[1.0], np.where(flips, -1.0, 1.0)]))
    return quaternion * sign[:, None]


def _check_steps(poses: RecordedPoses, knots_ns: I8, quaternion: F8, max_gap_s: float) -> None:
    """Refuse poses with too long a time or too great a turn between them."""
    _refuse(poses, np.diff(knots_ns) / S_NS, max_gap_s, "found a gap of {:g} s", f"at most {max_gap_s:g} s")
    turn_deg = np.degrees(2 * acos(np.minimum((quaternion[1:] * quaternion[:-1]).sum(axis=1), 1.0)))
    expected = f"at most {_MOST_TURN_DEG:g} degrees, beyond which its sense is in doubt"
    _refuse(poses, turn_deg, _MOST_TURN_DEG + 1e-6, "turns by {:.1f} degrees from the pose before", expected)


def check_places(position_m: F8, site: Site, reach_m: float) -> None:
    """Warn of poses (n, 3) in map coordinates, below the ground, or farther above it than the sensor sees."""
    plan_m = position_m[:, :2]
    above_m = position_m[:, 2] - site.height_m(*plan_m.T)
    is_nearer = norm(plan_m - site.origin_m[:2]) < norm(
        plan_m
    )  # to the origin in map coordinates than to (0, 0)
    if is_nearer.all():
        _log.warning(
            "motion: recorded poses begin at (%.1f, %.1f, %.1f) m, as if in map coordinates; "
            "origin_m is not taken off"
            " them: expected motion.x_m = %.10g, y_m = %.10g, z_m = %.10g",
            *(*position_m[0], *(-value for value in site.origin_m)),
        )
    elif above_m.min() < 0 or above_m.min() > reach_m:
        _log.warning(
            "motion: recorded poses lie from %.1f to %.1f m above the ground; "
            "expected above it and in sight of it"
            " (motion.z_m moves them)",
            *(above_m.min(), above_m.max()),
        )


def _to_world(recorded: Recorded, position_m: F8, quaternion: F8) -> tuple[F8, F8]:
    """Return positions (n, 3) and quaternions (n, 4) in world axes, relative to the recording's origin."""
    if recorded.axes == "camera":
        # Forward is the camera's z, left its -x, up its -y, in the recording's frame and in the body's:
        # the same turn before and after, which for a quaternion permutes its vector part.
        position_m = position_m[:, [2, 0, 1]] * [1.0, -1.0, -1.0]
        quaternion = quaternion[:, [2, 0, 1, 3]] * [1.0, -1.0, -1.0, 1.0]
    yaw_rad = math.radians(recorded.yaw_deg)
    cosine, sine = cos(yaw_rad), sin(yaw_rad)
    x, y, z = position_m.T
    position_m = np.column_stack([cosine * x - sine * y, sine * x + cosine * y, z])
    position_m += [recorded.x_m, recorded.y_m, recorded.z_m]
    cosine, sine = cos(yaw_rad / 2), sin(yaw_rad / 2)
    x, y, z, w = quaternion.T
    return position_m, np.column_stack(
        [cosine * x - sine * y, cosine * y + sine * x, cosine * z + sine * w, cosine * w - sine * z]
    )
