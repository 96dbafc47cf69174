"""Pieces of motion against scipy: values, rates, and attitudes as angles and as quaternions."""

import numpy as np
import pytest
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation

from vlp16emu.motion.piecewise import POWERS, KnotMotion, Pieces, Piecewise, derivatives

KNOTS_S = np.array([0.0, 0.5, 2.0, 2.25])


def powers(axes):
    """Coefficients of three pieces, drawn at random."""
    return np.random.default_rng(axes).normal(size=(3, axes, POWERS))


def test_values_and_rates_are_scipys():
    """Two derivatives of quintics are those of scipy's PPoly to rounding."""
    at_s = np.linspace(0.0, 2.24, 300)
    piece = np.searchsorted(KNOTS_S, at_s, side="right") - 1
    found = derivatives(powers(6), piece, at_s - KNOTS_S[piece])
    theirs = PPoly(np.moveaxis(powers(6)[..., ::-1], -1, 0), KNOTS_S)
    for order in range(3):
        np.testing.assert_allclose(found[..., order], theirs(at_s, order), rtol=1e-12, atol=1e-12)


class AnglesInMs(Piecewise):
    """Pieces of position and angles by milliseconds, all instants in the last one."""

    per_s = 1000.0

    def pieces_at(self, t_ns):
        scaled = powers(6) / 1000.0 ** np.arange(POWERS)
        return [Pieces(scaled, np.arange(len(t_ns)), np.full(len(t_ns), 2), t_ns / 1e6)]


def quaternions():
    return KnotMotion(0, np.rint(KNOTS_S * 1e9).astype(np.int64), powers(7))


@pytest.mark.parametrize("motion", [AnglesInMs(), quaternions()])
def test_angular_rates_are_those_of_scipys_rotations(motion):
    """Angular rates and accelerations are differences of scipy's rotations, velocities those of positions,
    for roll, pitch and yaw, and for quaternions of any length."""
    t_ns = np.arange(520_000_000, 1_900_000_000, 97_000_003)
    step_ns = 20_000
    step_s = step_ns * 1e-9
    before, here, after = (motion.kinematics_at(t_ns + shift) for shift in (-step_ns, 0, step_ns))
    turn = Rotation.from_matrix(before.world_R_body).inv() * Rotation.from_matrix(after.world_R_body)
    rate = turn.as_rotvec() / (2 * step_s)
    np.testing.assert_allclose(here.body_w_rad_s, rate, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(
        here.body_alpha_rad_s2,
        (after.body_w_rad_s - before.body_w_rad_s) / (2 * step_s),
        rtol=1e-4,
        atol=1e-2,
    )
    moved_m = after.world_p_body_m - before.world_p_body_m
    np.testing.assert_allclose(here.world_v_body_m_s, moved_m / (2 * step_s), rtol=1e-5, atol=1e-4)


def test_beyond_the_knots_a_body_rests():
    """Before the first knot and after the last one the pose is that of the knot, and nothing moves."""
    motion = quaternions()
    beyond = motion.kinematics_at(np.array([-1, 2_250_000_001]))
    ends = motion.poses_at(np.array([0, 2_250_000_000]))
    assert (beyond.world_p_body_m == ends.world_p_body_m).all()
    assert (beyond.world_R_body == ends.world_R_body).all()
    assert not beyond.world_v_body_m_s.any()
    assert not beyond.body_alpha_rad_s2.any()
