"""A sensor on the back of a person."""

import logging
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from vlp16emu.extras.walk.gait import AXES, Trunk
from vlp16emu.extras.walk.pack import KNOTS_PER_S, NODES_PER_KNOT, Pack
from vlp16emu.extras.walk.route import Route
from vlp16emu.extras.walk.settings import Gait, Mast, Walk
from vlp16emu.kernels.compiler import array_kernel, kernel
from vlp16emu.motion.pose import Kinematics, fill_rotation, rotate
from vlp16emu.trig import ZERO, cos_sin
from vlp16emu.types import F8, I8, Poses
from vlp16emu.units import S_NS

_log = logging.getLogger(__name__)
_NODES_PER_S = KNOTS_PER_S * NODES_PER_KNOT
_NODE_NS = S_NS // _NODES_PER_S
_TOGETHER = (
    128  # instants whose poses are computed together: intermediate results fit into the first-level cache
)
_TABLES_KEPT = 16  # seconds of motion kept, 0.3 MB each: workers of a run are never farther apart


class WalkMotion:
    """A pack on the back of a person who walks along a route.

    Route, gait and harness are evaluated on a grid of 1 ms that begins with the walk. The pose is defined as
    the quintic Hermite interpolant of x, y, z, roll, pitch and yaw on this grid. It is twice continuously
    differentiable, so its derivatives are exact, and it is within a nanometre of the interpolated function.

    At the cruise speed of the route the gait has its full amplitudes; they fade as the person slows down.
    `under` gives the motion that carries the pack and the suspension: by default the trunk and the harness of
    the walk.

    Raises TrajectoryError if the straps would never stop swinging.
    """

    moves = True

    def __init__(
        self,
        walk: Walk,
        route: Route,
        *,
        start_ns: int,
        seed: int,
        under: tuple[Callable[[int, int], F8], Mast] | None = None,
    ) -> None:
        self._walk = walk
        self._seed = seed
        self._route = route
        self._start_ns = start_ns
        self._height_m = walk.sensor_height_m
        self._trunk = Trunk(walk.gait, route.speed_m_s, seed)
        self._pack = Pack(*(under or (self._trunk_samples, walk.harness))) if walk.gait.moves else None
        self._table = lru_cache(_TABLES_KEPT)(self._tabulate)
        self.run_time_s = route.run_time_s

    def poses_at(self, t_ns: I8) -> Poses:
        """Return poses at UTC instants (n,); outside the run time the person rests at the path's ends."""
        poses = Poses(t_ns, np.empty((len(t_ns), 3, 3)), np.empty((len(t_ns), 3)))
        room = np.empty((1 + 2 * AXES, _TOGETHER))
        for second, which in self._seconds(t_ns):
            begin_ns = self._start_ns + second * S_NS
            table = self._table(second)
            _poses(table, t_ns, begin_ns, which, room, poses.world_R_body, poses.world_p_body_m)
        return poses

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses at UTC instants (n,) with the derivatives of the same function."""
        n = len(t_ns)
        out = Kinematics(t_ns, np.empty((n, 3, 3)), *(np.empty((n, 3)) for _ in range(5)))
        for second, which in self._seconds(t_ns):
            begin_ns = self._start_ns + second * S_NS
            pose = (out.world_R_body, out.world_p_body_m)
            rates = out.world_v_body_m_s, out.world_a_body_m_s2, out.body_w_rad_s, out.body_alpha_rad_s2
            _kinematics(self._table(second), t_ns, begin_ns, which, *pose, *rates)
        return out

    def mast_top(self, mast: Mast) -> "WalkMotion":
        """Return the motion of the top of a mast on the pack, which swings as the pack pushes it."""
        if self._pack is None:
            return self
        under = self._pack_samples, mast
        return WalkMotion(self._walk, self._route, start_ns=self._start_ns, seed=self._seed, under=under)

    def _pack_samples(self, first: int, count: int) -> F8:
        """Sample the pack's motion (count, 6) at knots from `first` on."""
        assert self._pack is not None
        seconds = range(first // KNOTS_PER_S, (first + count - 1) // KNOTS_PER_S + 1)
        samples = [self._pack.nodes(second)[:-1:NODES_PER_KNOT, :, 0] for second in seconds]
        begin = first - seconds.start * KNOTS_PER_S
        return np.concatenate(samples)[begin : begin + count]

    def _seconds(self, t_ns: I8) -> list[tuple[int, I8]]:
        """Return the seconds of the walk that contain instants (n,), and the indices of these instants."""
        if (
            len(t_ns)
            and t_ns.max() - self._start_ns < S_NS * (low := int(t_ns.min() - self._start_ns) // S_NS) + S_NS
        ):
            return [(low, np.arange(len(t_ns)))]  # nine blocks in ten
        seconds = (t_ns - self._start_ns) // S_NS
        order = np.argsort(seconds, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(seconds[order])) + 1)
        return [(int(seconds[part[0]]), part) for part in parts if len(part)]

    def _trunk_samples(self, first: int, count: int) -> F8:
        """Sample the trunk's motion (count, 6) as `_pack_samples` does."""
        elapsed_s = np.arange(first, first + count) / KNOTS_PER_S
        share = np.minimum(self._route.at(elapsed_s)[1] / self._route.speed_m_s, 1.0)
        return self._trunk.at(
            elapsed_s, share * share * (3.0 - 2.0 * share)
        )  # smooth: starts and stops jerk no pack

    def _tabulate(self, second: int) -> F8:
        """Coefficients (1000, 6, 6) of x, y, z, roll, pitch, yaw by piece of a second, lowest power first."""
        elapsed_s = np.arange(second * _NODES_PER_S, (second + 1) * _NODES_PER_S + 1) / _NODES_PER_S
        nodes, _ = self._route.at(elapsed_s)
        nodes[:, 2, 0] += self._height_m
        if self._pack is not None:
            _add_pack(self._pack.nodes(second), nodes)
        return _hermite(nodes)


def check_gait(gait: Gait, sensor_height_m: float) -> None:
    """Warn of a gait that lowers the sensor below the ground, where it sees nothing of the world."""
    # The lowest point of a step that is one sigma deeper than others.
    dip_m = (1.0 + gait.variation) * (gait.vertical_m + gait.second_harmonic_m + gait.heel_strike_m)
    if dip_m >= sensor_height_m:
        _log.warning(
            "motion.gait: lowers the sensor by %.2f m, into the ground; "
            "expected less than sensor_height_m = %g m",
            *(dip_m, sensor_height_m),
        )


@array_kernel
def _add_pack(pack: F8, nodes: F8) -> None:
    """Add the pack's displacements (n, 6, 3), in the heading frame, to the route without gait (n, 6, 3)."""
    for n in range(len(nodes)):
        yaw, turn, turn2 = nodes[n, 5]
        ahead, ahead1, ahead2 = pack[n, 0]
        left, left1, left2 = pack[n, 1]
        # Rates in axes that turn with the heading.
        v_ahead = ahead1 - left * turn
        v_left = left1 + ahead * turn
        a_ahead = ahead2 - left1 * turn - left * turn2 - v_left * turn
        a_left = left2 + ahead1 * turn + ahead * turn2 + v_ahead * turn
        c, s = cos_sin(yaw)
        for d, along, across in ((0, ahead, left), (1, v_ahead, v_left), (2, a_ahead, a_left)):
            nodes[n, 0, d] += c * along - s * across
            nodes[n, 1, d] += s * along + c * across
            for axis in range(2, AXES):
                nodes[n, axis, d] += pack[n, axis, d]


def _hermite(nodes: F8) -> F8:
    """Coefficients (n - 1, 6, 6) of the quintics through value, rate and acceleration at nodes (n, 6, 3)."""
    h_s = 1.0 / _NODES_PER_S
    p = nodes[..., 0]
    v = nodes[..., 1] * h_s
    a = nodes[..., 2] * (h_s * h_s)
    rise = p[1:] - p[:-1]
    v0 = v[:-1]
    v1 = v[1:]
    a0 = a[:-1]
    a1 = a[1:]
    cubic = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    quartic = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    quintic = 6.0 * rise - 3.0 * (v0 + v1) - 0.5 * (a0 - a1)
    return np.stack([p[:-1], v0, 0.5 * a0, cubic, quartic, quintic], axis=-1)


@kernel
def _poses(
    table: F8, t_ns: I8, begin_ns: int, which: I8, room: F8, world_R_body: F8, world_p_body_m: F8
) -> None:
    """Fill the poses at the instants `which`, all within the second that begins at `begin_ns`.

    Instants are done in groups that fit into `room` (13, n), so that the compiler vectorizes the loops over
    them.
    """
    x = room[0]
    q = room[1:7]
    cosine = room[7:10]
    sine = room[10:13]
    done = ZERO
    while done < len(which):
        piece = (t_ns[which[done]] - begin_ns) // _NODE_NS
        node_ns = begin_ns + piece * _NODE_NS
        count = ZERO
        while count < min(len(x), len(which) - done):
            since_ns = t_ns[which[done + count]] - node_ns
            if not 0 <= since_ns < _NODE_NS:
                break
            x[count] = since_ns / _NODE_NS
            count += 1
        for axis in range(AXES):
            c0 = table[piece, axis, 0]
            c1 = table[piece, axis, 1]
            c2 = table[piece, axis, 2]
            c3 = table[piece, axis, 3]
            c4 = table[piece, axis, 4]
            c5 = table[piece, axis, 5]
            for n in range(count):
                q[axis, n] = c0 + x[n] * (c1 + x[n] * (c2 + x[n] * (c3 + x[n] * (c4 + x[n] * c5))))
        for angle in range(3):
            for n in range(count):
                cosine[angle, n], sine[angle, n] = cos_sin(q[3 + angle, n])
        for n in range(count):
            i = which[done + n]
            for axis in range(3):
                world_p_body_m[i, axis] = q[axis, n]
            yaw, pitch = (cosine[2, n], sine[2, n]), (cosine[1, n], sine[1, n])
            fill_rotation(*yaw, *pitch, cosine[0, n], sine[0, n], world_R_body[i])
        done += count


@array_kernel
def _kinematics(
    table: F8,
    t_ns: I8,
    begin_ns: int,
    which: I8,
    world_R_body: F8,
    world_p_body_m: F8,
    v_m_s: F8,
    a_m_s2: F8,
    w_rad_s: F8,
    alpha_rad_s2: F8,
) -> None:
    per_s = 1.0e9 / _NODE_NS  # derivatives are by the share of a piece
    q = np.empty((3, AXES))
    for i in which:
        since_ns = t_ns[i] - begin_ns
        piece = since_ns // _NODE_NS
        x = (since_ns - piece * _NODE_NS) / _NODE_NS
        for axis in range(AXES):
            c = table[piece, axis]
            q[0, axis] = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))
            q[1, axis] = c[1] + x * (2 * c[2] + x * (3 * c[3] + x * (4 * c[4] + x * 5 * c[5])))
            q[2, axis] = 2 * c[2] + x * (6 * c[3] + x * (12 * c[4] + x * 20 * c[5]))
        q[1] *= per_s
        q[2] *= per_s * per_s
        world_p_body_m[i] = q[0, :3]
        v_m_s[i] = q[1, :3]
        a_m_s2[i] = q[2, :3]
        rotate(q[0, 5], q[0, 4], q[0, 3], world_R_body[i])
        _body_rate(q[0, 3:], q[1, 3:], q[2, 3:], w_rad_s[i], alpha_rad_s2[i])


@array_kernel
def _body_rate(angle_rad: F8, rate_rad_s: F8, acceleration_rad_s2: F8, w_rad_s: F8, alpha_rad_s2: F8) -> None:
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
