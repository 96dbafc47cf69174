"""Motion by polynomial pieces over time: what walks, recorded and live poses have in common."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vlp16emu.kernels.compiler import array_kernel, inline_kernel, kernel
from vlp16emu.motion.pose import Kinematics
from vlp16emu.rotation import fill_rotation
from vlp16emu.trig import ZERO, cos_sin
from vlp16emu.types import F8, I8, Poses

POWERS = 6  # of a piece, which is a quintic; those above a cubic's are 0
_ANGLES = 6  # axes of pieces of position, roll, pitch and yaw; with a quaternion there are seven
_TOGETHER = (
    128  # instants whose poses are computed together: intermediate results fit into the first-level cache
)


class Pieces(NamedTuple):
    """Pieces of a motion, and the places of instants (k,) in them."""

    powers: F8
    """(n, 6 or 7, 6) coefficients of x, y, z and roll, pitch, yaw or a quaternion x, y, z, w of any length
    but 0; lowest power first."""
    which: I8  # (k,) indices of the instants
    piece: I8  # (k,) piece of each instant
    since: F8  # (k,) time from the begin of the piece, in the unit of time of the powers


class Piecewise:
    """Motion whose position and attitude are polynomials of time, piece by piece.

    A subclass has `pieces_at`, and `per_s`, the units of time of its powers in a second.
    """

    moves = True
    per_s = 1.0

    def pieces_at(self, t_ns: I8) -> Iterable[Pieces]:
        """Return the pieces with UTC instants (n,), each instant in one of them."""
        raise NotImplementedError

    def poses_at(self, t_ns: I8) -> Poses:
        """Return poses at UTC instants (n,)."""
        return _poses(t_ns, self.pieces_at(t_ns))

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses at UTC instants (n,) with the derivatives of the same function."""
        pieces = list(self.pieces_at(t_ns))
        poses = _poses(t_ns, pieces)
        rates = np.empty((4, len(t_ns), 3))
        for part in pieces:
            fill_rates(*part, self.per_s, rates)
        return Kinematics(t_ns, poses.world_R_body, poses.world_p_body_m, *rates)


class KnotMotion(Piecewise):
    """Motion between knots at any times; before the first and after the last the body is at rest.

    Parameters
    ----------
    start_ns : UTC of the first knot
    knots_ns : (n,) times of the knots since the first one
    powers : (n - 1 or more, 7, 6) powers of seconds, as in `Pieces`
    """

    def __init__(self, start_ns: int, knots_ns: I8, powers: F8) -> None:
        self._start_ns = start_ns
        self._arrays = (knots_ns, powers)

    def pieces_at(self, t_ns: I8) -> list[Pieces]:
        """Return the pieces at UTC instants (n,), clipped to the ends."""
        knots_ns, powers = self._arrays
        at_ns = np.clip(t_ns - self._start_ns, 0, knots_ns[-1])
        piece = np.minimum(np.searchsorted(knots_ns, at_ns, side="right") - 1, len(knots_ns) - 2)
        since_s = (at_ns - knots_ns[piece]).astype(np.float64) * 1e-9
        return [Pieces(powers, np.arange(len(t_ns)), piece, since_s)]

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses at UTC instants (n,) with their derivatives, zero while the body is at rest."""
        known = super().kinematics_at(t_ns)
        elapsed_ns = t_ns - self._start_ns
        rests = (elapsed_ns < 0) | (elapsed_ns > self._arrays[0][-1])
        for rate in (
            known.world_v_body_m_s,
            known.world_a_body_m_s2,
            known.body_w_rad_s,
            known.body_alpha_rad_s2,
        ):
            rate[rests] = 0.0
        return known


def _poses(t_ns: I8, pieces: Iterable[Pieces]) -> Poses:
    poses = Poses(t_ns, np.empty((len(t_ns), 3, 3)), np.empty((len(t_ns), 3)))
    room = np.empty((7 + 2 * 3, _TOGETHER))
    for part in pieces:
        fill_poses(*part, room, poses.world_R_body, poses.world_p_body_m)
    return poses


@kernel
def fill_poses(
    powers: F8, which: I8, piece: I8, since: F8, room: F8, world_R_body: F8, world_p_body_m: F8
) -> None:
    """Fill the poses at the instants `which`.

    Instants of one piece are done in groups that fit into `room` (13, n), so that the compiler vectorizes the
    loops over them.
    """
    q = room[:7]
    cosine = room[7:10]
    sine = room[10:13]
    done = ZERO
    while done < len(which):
        here = piece[done]
        count = ZERO
        while count < min(room.shape[1], len(which) - done) and piece[done + count] == here:
            count += 1
        for axis in range(powers.shape[1]):
            c0 = powers[here, axis, 0]
            c1 = powers[here, axis, 1]
            c2 = powers[here, axis, 2]
            c3 = powers[here, axis, 3]
            c4 = powers[here, axis, 4]
            c5 = powers[here, axis, 5]
            for n in range(count):
                x = since[done + n]
                q[axis, n] = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))))
        if powers.shape[1] == _ANGLES:
            for angle in range(3):
                for n in range(count):
                    cosine[angle, n], sine[angle, n] = cos_sin(q[3 + angle, n])
        for n in range(np.uint64(count)):  # signed indices might count from the end
            i = np.uint64(which[np.uint64(done) + n])
            for axis in range(3):
                world_p_body_m[i, axis] = q[axis, n]
            if powers.shape[1] == _ANGLES:
                yaw, pitch = (cosine[2, n], sine[2, n]), (cosine[1, n], sine[1, n])
                fill_rotation(*yaw, *pitch, cosine[0, n], sine[0, n], world_R_body[i])
            else:
                _fill_quaternion(q[3, n], q[4, n], q[5, n], q[6, n], world_R_body[i])
        done += count


@inline_kernel
def _fill_quaternion(x: float, y: float, z: float, w: float, out: F8) -> None:
    """Fill the rotation (3, 3) of a quaternion of any length."""
    two = 2.0 / (x * x + y * y + z * z + w * w)
    out[0, 0] = 1.0 - two * (y * y + z * z)
    out[1, 1] = 1.0 - two * (x * x + z * z)
    out[2, 2] = 1.0 - two * (x * x + y * y)
    out[0, 1] = two * (x * y - z * w)
    out[1, 0] = two * (x * y + z * w)
    out[0, 2] = two * (x * z + y * w)
    out[2, 0] = two * (x * z - y * w)
    out[1, 2] = two * (y * z - x * w)
    out[2, 1] = two * (y * z + x * w)


@array_kernel
def derivatives(powers: F8, piece: I8, since: F8) -> F8:
    """Return value and two derivatives (k, axes, 3) of quintics, by the unit of time of the powers.

    Parameters
    ----------
    powers : (n, axes, 6) lowest first
    piece, since : (k,) piece of each instant, and time from its begin
    """
    out = np.empty((len(piece), powers.shape[1], 3))
    for n in range(len(piece)):
        x = since[n]
        for axis in range(powers.shape[1]):
            c = powers[piece[n], axis]
            out[n, axis, 0] = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))
            out[n, axis, 1] = c[1] + x * (2 * c[2] + x * (3 * c[3] + x * (4 * c[4] + x * 5 * c[5])))
            out[n, axis, 2] = 2 * c[2] + x * (6 * c[3] + x * (12 * c[4] + x * 20 * c[5]))
    return out


@array_kernel
def fill_rates(powers: F8, which: I8, piece: I8, since: F8, per_s: float, rates: F8) -> None:
    """Fill (4, n, 3): velocity, acceleration, and angular rate and acceleration in body axes."""
    q = derivatives(powers, piece, since)
    q[:, :, 1] *= per_s
    q[:, :, 2] *= per_s * per_s
    for n in range(len(which)):
        i = which[n]
        rates[0, i] = q[n, :3, 1]
        rates[1, i] = q[n, :3, 2]
        attitude = q[n, 3:].T
        if len(powers[0]) == _ANGLES:
            _angle_rates(attitude[0], attitude[1], attitude[2], rates[2, i], rates[3, i])
        else:
            _quaternion_rates(attitude[0], attitude[1], attitude[2], rates[2, i], rates[3, i])


@array_kernel
def _angle_rates(
    angle_rad: F8, rate_rad_s: F8, acceleration_rad_s2: F8, w_rad_s: F8, alpha_rad_s2: F8
) -> None:
    """Fill angular rate and acceleration (3,), in body axes, from roll, pitch, yaw and derivatives.

    Source: the z-y-x Euler kinematic equations, for instance Diebel, "Representing Attitude", 2006, section
    5.
    """
    cr, sr = cos_sin(angle_rad[0])
    cp, sp = cos_sin(angle_rad[1])
    roll, pitch, yaw = rate_rad_s
    roll2, pitch2, yaw2 = acceleration_rad_s2
    w_rad_s[0] = roll - sp * yaw
    w_rad_s[1] = cr * pitch + sr * cp * yaw
    w_rad_s[2] = -sr * pitch + cr * cp * yaw
    alpha_rad_s2[0] = roll2 - sp * yaw2 - cp * pitch * yaw
    across = cp * yaw2 - sp * pitch * yaw
    alpha_rad_s2[1] = cr * pitch2 + sr * across + roll * w_rad_s[2]
    alpha_rad_s2[2] = -sr * pitch2 + cr * across - roll * w_rad_s[1]


@array_kernel
def _quaternion_rates(q: F8, q1: F8, q2: F8, w_rad_s: F8, alpha_rad_s2: F8) -> None:
    """Fill angular rate and acceleration (3,), in body axes, from a quaternion of any length and derivatives.

    With N = |Q|^2, the rate is w = 2 vec(Q* Q') / N, and as Q'* Q' has no vector part, its derivative is
    2 vec(Q* Q'') / N - (N' / N) w.
    """
    norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    fading = 2.0 * (q[0] * q1[0] + q[1] * q1[1] + q[2] * q1[2] + q[3] * q1[3]) / norm2
    for a in range(3):
        j, k = (a + 1) % 3, (a + 2) % 3
        w = 2.0 * (q[3] * q1[a] - q[a] * q1[3] - q[j] * q1[k] + q[k] * q1[j]) / norm2
        alpha = 2.0 * (q[3] * q2[a] - q[a] * q2[3] - q[j] * q2[k] + q[k] * q2[j]) / norm2
        w_rad_s[a] = w
        alpha_rad_s2[a] = alpha - fading * w
