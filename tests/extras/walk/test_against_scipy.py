"""Splines, straps and recordings against those of scipy and by what defines them."""

import math
from functools import partial

import numpy as np
import pytest
from extras.walk.kit import straps
from scipy.integrate import solve_ivp
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from vlp16emu.extras.recorded.files import RecordedPoses
from vlp16emu.extras.recorded.motion import RecordedMotion
from vlp16emu.extras.recorded.settings import Recorded
from vlp16emu.extras.splines import interpolant
from vlp16emu.extras.walk.pack import KNOTS_PER_S, NODES_PER_KNOT, Pack, response


def uneven(n, least=0.2):
    """Parameters with steps that differ by up to a factor of ten, and values in the plane."""
    rng = np.random.default_rng(n)
    return np.cumsum(rng.uniform(least, 2.0, n)), rng.normal(size=(n, 2))


SPLINES = [
    (3, "not-a-knot", CubicSpline, (2, 3, 4, 5, 9, 200)),
    (3, "natural", partial(CubicSpline, bc_type="natural"), (2, 3, 4, 5, 9, 200)),
    (3, "periodic", partial(CubicSpline, bc_type="periodic"), (3, 4, 9, 200)),
    (5, "not-a-knot", partial(make_interp_spline, k=5), (6, 7, 12, 200)),
    (5, "periodic", partial(make_interp_spline, k=5, bc_type="periodic"), (40,)),
]
"""Degree, ends, those of scipy, and numbers of points."""


@pytest.mark.parametrize(
    ("degree", "ends", "theirs", "n"), [(*row[:3], n) for row in SPLINES for n in row[3]]
)
def test_splines_are_scipys(degree, ends, theirs, n):
    """Values and two derivatives are those of scipy to rounding, also where a lap is solved along with its
    neighbours, and with few points."""
    at, values = uneven(n, 1.5 if degree == 5 else 0.2)
    values[-1] = values[0] if ends == "periodic" else values[-1]
    found, wanted, x = (
        interpolant(at, values, degree, ends),
        theirs(at, values),
        np.linspace(at[0], at[-1], 500),
    )
    for derivative in range(3):
        np.testing.assert_allclose(found(x, derivative), wanted(x, derivative), rtol=1e-11, atol=1e-11)


SPAN_S = 0.15
NODES_S = np.arange(round(1000 * SPAN_S) + 1) / 1000


def bump(first, count):
    """A swelling sine of 3 Hz, at rest until the first knot."""
    t = np.maximum(np.arange(first, first + count) / KNOTS_PER_S, 0.0)
    return np.repeat((0.02 * t**6 / (t**6 + 1e-6) * np.sin(6 * np.pi * t))[:, None], 6, axis=1)


def trunk():
    """Make the same spline, by scipy."""
    samples = bump(-9, 140)[:, 0]
    control = np.convolve(samples, np.array([13, -112, 438, -112, 13]) / 240, "valid")
    return BSpline((np.arange(len(control) + 6) - 10) / KNOTS_PER_S, control, 5)


@pytest.mark.parametrize("hz", [0.5, 3.0, 40.0, 300.0])
@pytest.mark.parametrize("damping", [0.0, 0.2, 1.0, 10.0])
def test_a_pack_swings_as_a_general_solver_says(hz, damping):
    """From 0.5 to 300 Hz, undamped to overdamped, x'' + 2zw(x' - u') + w2(x - u) = 0 is solved within
    1e-11 m."""
    w, u = 2 * math.pi * hz, trunk()
    rate, matrix = u.derivative(), np.array([[0.0, 1.0], [-w * w, -2 * damping * w]])

    def slope(t, x):
        return [x[1], -2 * damping * w * (x[1] - rate(t)) - w * w * (x[0] - u(t))]

    pack = Pack(bump, straps(hz, damping or 1.0))
    if not damping:  # an undamped pack is refused, so its steps are put in by hand
        pack._steps[:] = [
            response(hz, 0.0, s / NODES_PER_KNOT / KNOTS_PER_S) for s in range(1, NODES_PER_KNOT + 1)
        ]
        pack._drag[:] = 0.0
    exact = {"t_eval": NODES_S, "rtol": 1e-12, "atol": 1e-14, "jac": lambda _t, _x: matrix}
    expected = solve_ivp(slope, (0.0, SPAN_S), [u(0.0), rate(0.0)], "LSODA", **exact).y[0]
    np.testing.assert_allclose(pack.nodes(0)[: len(NODES_S), 0, 0], expected, atol=1e-11)


def test_rotations_and_rates_agree_with_scipy():
    """On a head that swings by 40 degrees, recorded at 20 Hz, both splines agree to 1e-4 rad and 2e-3
    rad/s."""
    t = np.arange(0.0, 6.0, 0.05)
    angles = np.column_stack([0.7 * np.sin(1.3 * t), 0.4 * np.sin(2.1 * t + 1), 0.3 * np.cos(0.9 * t)])
    recorded = Rotation.from_euler("ZYX", angles)
    theirs = RotationSpline(t, recorded)
    poses = RecordedPoses([], np.rint(t * 1e9).astype(np.int64), np.zeros((len(t), 3)), recorded.as_quat())
    section = Recorded(kind="recorded", file="poses.txt", format="tum")
    motion = RecordedMotion(section, poses, start_ns=0)
    ours = motion.kinematics_at(np.arange(500_000_000, 5_400_000_000, 3_333_333))
    at_s = ours.t_ns / 1e9
    difference = (theirs(at_s).inv() * Rotation.from_matrix(ours.world_R_body)).magnitude()
    assert difference.max() < 1e-4
    np.testing.assert_allclose(ours.body_w_rad_s, theirs(at_s, 1), atol=2e-3)
    np.testing.assert_allclose(ours.body_alpha_rad_s2, theirs(at_s, 2), atol=0.1)
