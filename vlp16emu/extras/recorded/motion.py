"""Motion of a body along recorded poses."""

import logging
import math

import numpy as np

from vlp16emu.elementary import acos, cos, norm, sin
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.recorded.files import RecordedPoses
from vlp16emu.extras.recorded.settings import Recorded
from vlp16emu.extras.splines import interpolant
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.pose import Kinematics
from vlp16emu.types import F8, I8, Poses
from vlp16emu.units import S_NS
from vlp16emu.world.settings import Site

_log = logging.getLogger(__name__)

_MOST_TURN_DEG = (
    90.0  # between one pose and the next: half the angle at which the sense of the turn is undefined
)
_LEAST_NORM = 0.5
"""Least norm of the quaternion spline: it is 1 at each pose; the lower it is between poses, the more it
distorts the turn."""
_LOOKS = 8  # samples of this norm between two poses


class Pieces:
    """Piecewise cubic motion: coefficients (4, n - 1, 7) of position and quaternion between knots, highest power first.

    Before its first knot and after its last one the body is at rest.
    """

    moves = True

    def __init__(self, start_ns: int, knots_ns: I8, powers: F8) -> None:
        self._start_ns = start_ns
        self._arrays = (knots_ns, powers)

    def poses_at(self, t_ns: I8) -> Poses:
        """Return poses at UTC instants (n,)."""
        position_m = np.empty((len(t_ns), 3))
        turn = np.empty((len(t_ns), 3, 3))
        fill_poses(*self._arrays, t_ns - self._start_ns, position_m, turn)
        return Poses(t_ns, turn, position_m)

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses at UTC instants (n,) with their derivatives, which are zero while the body is at rest."""
        poses = self.poses_at(t_ns)
        rates = np.empty((4, len(t_ns), 3))
        fill_rates(*self._arrays, t_ns - self._start_ns, rates)
        return Kinematics(t_ns, poses.world_R_body, poses.world_p_body_m, *rates)


class RecordedMotion(Pieces):
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
        position_m, quaternion = _placed(recorded, poses.position_m, quaternion)
        powers = interpolant(knots_ns / S_NS, np.column_stack([position_m, quaternion])).powers[::-1]
        powers = np.concatenate([np.zeros((4 - len(powers), *powers.shape[1:])), powers])
        super().__init__(start_ns, knots_ns, powers)
        self._check_norm(poses)
        self.position_m = np.ascontiguousarray(
            powers[3, :, :3]
        )  # (n - 1, 3) of all poses but the last, in the world

    def _check_norm(self, poses: RecordedPoses) -> None:
        (knots_ns, powers) = self._arrays
        found = "no smooth turn leads here from the pose before: times are too uneven"
        steps_s = np.diff(knots_ns) / S_NS
        c = powers[:, :, 3:]
        for look in range(1, _LOOKS):
            d = (look / _LOOKS * steps_s)[:, None]
            off = np.abs(norm(((c[0] * d + c[1]) * d + c[2]) * d + c[3]) - 1.0)
            _refuse(poses, off, 1.0 - _LEAST_NORM, found, "poses at more even times")


def _refuse(poses: RecordedPoses, values: F8, most: float, found: str, expected: str) -> None:
    """Raise TrajectoryError for the first step (n - 1,) between poses whose value is above `most`; `found` formats it."""
    if (values > most).any():
        i = int((values > most).argmax())
        raise TrajectoryError(poses.where[i + 1], found.format(values[i]), expected)


def _sign_continuous(quaternion: F8) -> F8:
    """Return the same rotations (n, 4), each with the sign that is nearer to the one before."""
    flips = (quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0
    sign = np.cumprod(np.concatenate([[1.0], np.where(flips, -1.0, 1.0)]))
    return quaternion * sign[:, None]


def _check_steps(poses: RecordedPoses, knots_ns: I8, quaternion: F8, max_gap_s: float) -> None:
    _refuse(poses, np.diff(knots_ns) / S_NS, max_gap_s, "found a gap of {:g} s", f"at most {max_gap_s:g} s")
    turn_deg = np.degrees(2 * acos(np.minimum((quaternion[1:] * quaternion[:-1]).sum(axis=1), 1.0)))
    expected = f"at most {_MOST_TURN_DEG:g} degrees, beyond which its sense is in doubt"
    _refuse(poses, turn_deg, _MOST_TURN_DEG + 1e-6, "turns by {:.1f} degrees from the pose before", expected)


def check_places(position_m: F8, site: Site, reach_m: float) -> None:
    """Warn of poses (n, 3) in map coordinates, below the ground, or farther above it than the sensor sees."""
    plan_m = position_m[:, :2]
    above_m = position_m[:, 2] - site.height_m(*plan_m.T)
    if (
        norm(plan_m - site.origin_m[:2]) < norm(plan_m)
    ).all():  # the origin in map coordinates is nearer than (0, 0)
        _log.warning(
            "motion: recorded poses begin at (%.1f, %.1f, %.1f) m, as if in map coordinates; origin_m is not taken off"
            " them: expected motion.x_m = %.10g, y_m = %.10g, z_m = %.10g",
            *(*position_m[0], *(-value for value in site.origin_m)),
        )
    elif above_m.min() < 0 or above_m.min() > reach_m:
        _log.warning(
            "motion: recorded poses lie from %.1f to %.1f m above the ground; expected above it and in sight of it"
            " (motion.z_m moves them)",
            *(above_m.min(), above_m.max()),
        )


def _placed(recorded: Recorded, position_m: F8, quaternion: F8) -> tuple[F8, F8]:
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


@array_kernel
def _piece_at(knots_ns: I8, elapsed_ns: int) -> tuple[int, float]:
    """Return the piece that contains an instant, and the seconds since its start; instants beyond an end count as the end."""
    t = min(max(elapsed_ns, 0), knots_ns[-1])
    piece = min(np.searchsorted(knots_ns, t, side="right") - 1, knots_ns.size - 2)
    return piece, (t - knots_ns[piece]) * 1e-9


@array_kernel
def fill_poses(knots_ns: I8, coefficients: F8, elapsed_ns: I8, position_m: F8, turn: F8) -> None:
    """Evaluate the pieces, each instant on its own."""
    value = np.empty(7)
    for i in range(elapsed_ns.size):
        piece, d = _piece_at(knots_ns, elapsed_ns[i])
        for a in range(7):
            c0 = coefficients[0, piece, a]
            c1 = coefficients[1, piece, a]
            value[a] = ((c0 * d + c1) * d + coefficients[2, piece, a]) * d + coefficients[3, piece, a]
        for a in range(3):
            position_m[i, a] = value[a]
        x, y, z, w = value[3], value[4], value[5], value[6]
        # The rotation of a quaternion of any length.
        two = 2.0 / (x * x + y * y + z * z + w * w)
        turn[i, 0, 0] = 1.0 - two * (y * y + z * z)
        turn[i, 1, 1] = 1.0 - two * (x * x + z * z)
        turn[i, 2, 2] = 1.0 - two * (x * x + y * y)
        turn[i, 0, 1] = two * (x * y - z * w)
        turn[i, 1, 0] = two * (x * y + z * w)
        turn[i, 0, 2] = two * (x * z + y * w)
        turn[i, 2, 0] = two * (x * z - y * w)
        turn[i, 1, 2] = two * (y * z - x * w)
        turn[i, 2, 1] = two * (y * z + x * w)


@array_kernel
def fill_rates(knots_ns: I8, coefficients: F8, elapsed_ns: I8, rates: F8) -> None:
    """Fill (4, n, 3): velocity, acceleration, angular rate and angular acceleration, the latter in body axes.

    With Q of any length and N = |Q|^2, the rate is w = 2 vec(Q* Q') / N, and as Q'* Q' has no vector part,
    its derivative is 2 vec(Q* Q'') / N - (N' / N) w.
    """
    q = np.empty(4)
    q1 = np.empty(4)
    q2 = np.empty(4)
    for i in range(elapsed_ns.size):
        if elapsed_ns[i] < 0 or elapsed_ns[i] > knots_ns[-1]:
            rates[:, i] = 0.0
            continue
        piece, d = _piece_at(knots_ns, elapsed_ns[i])
        for a in range(7):
            c = coefficients[:, piece, a]
            first = (3.0 * c[0] * d + 2.0 * c[1]) * d + c[2]
            second = 6.0 * c[0] * d + 2.0 * c[1]
            if a < 3:
                rates[0, i, a] = first
                rates[1, i, a] = second
            else:
                q[a - 3] = ((c[0] * d + c[1]) * d + c[2]) * d + c[3]
                q1[a - 3] = first
                q2[a - 3] = second
        norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
        fading = 2.0 * (q[0] * q1[0] + q[1] * q1[1] + q[2] * q1[2] + q[3] * q1[3]) / norm2
        for a in range(3):
            j, k = (a + 1) % 3, (a + 2) % 3
            w = 2.0 * (q[3] * q1[a] - q[a] * q1[3] - q[j] * q1[k] + q[k] * q1[j]) / norm2
            alpha = 2.0 * (q[3] * q2[a] - q[a] * q2[3] - q[j] * q2[k] + q[k] * q2[j]) / norm2
            rates[2, i, a] = w
            rates[3, i, a] = alpha - fading * w
