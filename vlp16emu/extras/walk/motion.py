"""A sensor on the back of a person."""

import logging
from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np

from vlp16emu.extras.walk.gait import AXES, Trunk
from vlp16emu.extras.walk.pack import KNOTS_PER_S, NODES_PER_KNOT, Pack
from vlp16emu.extras.walk.route import Route
from vlp16emu.extras.walk.settings import Gait, Mast, Walk
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.piecewise import Pieces, Piecewise
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8, I8
from vlp16emu.units import S_NS

_log = logging.getLogger(__name__)
_NODES_PER_S = KNOTS_PER_S * NODES_PER_KNOT
_NODE_NS = S_NS // _NODES_PER_S
_TABLES_KEPT = 16  # seconds of motion kept, 0.3 MB each: workers of a run are never farther apart


class WalkMotion(Piecewise):
    """A pack on the back of a person who walks along a route.

    Route, gait and harness are evaluated on a grid of 1 ms that begins with the walk. The pose is defined as
    the quintic Hermite interpolant of x, y, z, roll, pitch and yaw on this grid. It is twice continuously
    differentiable, so its derivatives are exact, and it is within a nanometre of the interpolated function.

    At the cruise speed of the route the gait has its full amplitudes; they fade as the person slows down.
    `under` gives the motion that carries the pack and the suspension: by default the trunk and the harness of
    the walk.

    Raises TrajectoryError if the straps would never stop swinging.
    """

    per_s = 1e9 / _NODE_NS

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

    def pieces_at(self, t_ns: I8) -> Iterator[Pieces]:
        """Yield the pieces with UTC instants (n,); outside the run time the person rests at an end."""
        for second, which in self._seconds(t_ns):
            since_ns = t_ns[which] - (self._start_ns + second * S_NS)
            piece = since_ns // _NODE_NS
            yield Pieces(self._table(second), which, piece, (since_ns - piece * _NODE_NS) / _NODE_NS)

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
        if not len(t_ns):
            return []
        first = int(t_ns.min() - self._start_ns) // S_NS
        last = int(t_ns.max() - self._start_ns) // S_NS
        if first == last:  # nine blocks in ten
            return [(first, np.arange(len(t_ns)))]
        seconds = (t_ns - self._start_ns) // S_NS
        order = np.argsort(seconds, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(seconds[order])) + 1)
        return [(int(seconds[part[0]]), part) for part in parts]

    def _trunk_samples(self, first: int, count: int) -> F8:
        """Sample the trunk's motion (count, 6) as `_pack_samples` does."""
        elapsed_s = np.arange(first, first + count) / KNOTS_PER_S
        share = np.minimum(self._route.at(elapsed_s)[1] / self._route.speed_m_s, 1.0)
        effort = share * share * (3.0 - 2.0 * share)  # smooth: starts and stops jerk no pack
        return self._trunk.at(elapsed_s, effort)

    def _tabulate(self, second: int) -> F8:
        """Return the pieces (1000, 6, 6) of a second, powers of the share of a step as in `Pieces`."""
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
    """Return quintics (n - 1, 6, 6) through value, rate and acceleration at nodes (n, 6, 3)."""
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
