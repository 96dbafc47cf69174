"""Motion by polynomial pieces between knots: what recorded and live poses have in common."""

import numpy as np

from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.pose import Kinematics
from vlp16emu.types import F8, I8, Poses


class Piecewise:
    """Piecewise cubic motion: coefficients (4, n - 1, 7) between knots, highest power first.

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
        """Return poses at UTC instants (n,) with their derivatives, zero while the body is at rest."""
        poses = self.poses_at(t_ns)
        rates = np.empty((4, len(t_ns), 3))
        fill_rates(*self._arrays, t_ns - self._start_ns, rates)
        return Kinematics(t_ns, poses.world_R_body, poses.world_p_body_m, *rates)


@array_kernel
def _piece_at(knots_ns: I8, elapsed_ns: int) -> tuple[int, float]:
    """Return the piece that contains an instant, clipped to the ends, and the seconds since its start."""
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
