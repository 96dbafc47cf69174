"""Standing and walking."""

import numpy as np
import pytest
from extras.walk.kit import START_NS, STILL, Circle, at, gait, straps, walking

from vlp16emu.extras.walk.motion import _add_pack
from vlp16emu.extras.walk.settings import Harness
from vlp16emu.rotation import rotations

STRAPS = Harness(vertical_hz=2.0, damping_ratio=0.2)
SLACK, STIFF = (straps(hz, 0.1) for hz in (0.5, 30.0))


def test_without_gait_the_sensor_glides_over_the_ground():
    """Amplitude zero gives the bare path, sensor height above the ground, at any time within 1e-9 m."""
    route, t = Circle(), np.sort(np.random.default_rng(1).uniform(0.0, 60.0, 5000))
    poses, (nodes, _) = at(walking(route, STILL), t), route.at(np.rint(t * 1e9) / 1e9)
    np.testing.assert_allclose(poses.world_p_body_m, nodes[:, :3, 0] + [0.0, 0.0, 2.0], atol=1e-9)
    np.testing.assert_allclose(poses.world_R_body, rotations(nodes[:, 5, 0].copy(), 0.0, 0.0), atol=1e-9)


def test_gait_moves_the_pack_about_the_path():
    """Up and down at step rate, to the left of the heading at stride rate, once the person walks."""
    plain = {"second_harmonic_m": 0.0, "heel_strike_m": 0.0, "fore_aft_m": 0.0, "variation": 0.0}
    t = np.arange(3.0, 9.0, 1e-3)
    poses, bare = (at(walking(own_gait=g), t) for g in (gait(**plain), STILL))
    sway = np.einsum("nji,nj->ni", bare.world_R_body, poses.world_p_body_m - bare.world_p_body_m)
    np.testing.assert_allclose(sway[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(sway[:, 2], 0.02 * np.sin(2 * np.pi * 1.85 * t), atol=1e-9)
    np.testing.assert_allclose(sway[:, 1], 0.02 * np.sin(np.pi * 1.85 * t + np.pi / 4), atol=1e-9)


@pytest.mark.parametrize("harness", [None, STIFF])
def test_interpolation_is_exact_to_a_nanometre(monkeypatch, harness):
    """Between the nodes, poses are those of nodes five times as dense within 1e-9 m and rad."""
    since_ns = 5 * 10**9 + np.arange(5000) * 200_000
    poses = walking(harness=harness).poses_at(START_NS + since_ns)
    monkeypatch.setattr("vlp16emu.extras.walk.pack.NODES_PER_KNOT", 25)
    fine = walking(harness=harness)
    nodes, _ = fine._route.at(np.append(since_ns, 6 * 10**9) / 1e9)
    nodes[:, 2, 0] += 2.0
    _add_pack(fine._pack.nodes(5), nodes)
    np.testing.assert_allclose(poses.world_p_body_m, nodes[:-1, :3, 0], atol=1e-9)
    exact = [rotations(q[5:], q[4], q[3])[0] for q in nodes[:-1, :, 0]]
    np.testing.assert_allclose(poses.world_R_body, exact, atol=1e-9)


@pytest.mark.parametrize("harness", [None, STRAPS, SLACK])
def test_poses_do_not_depend_on_their_company(harness):
    """A pose computed alone, by one who never asked before, has the same bits as among others in any
    order."""
    t = np.random.default_rng(2).uniform(-3.0, 70.0, 5003)
    among, alone = at(walking(harness=harness), t), at(walking(harness=harness), t[3777:3778])
    assert (among.world_p_body_m[3777] == alone.world_p_body_m[0]).all()
    assert (among.world_R_body[3777] == alone.world_R_body[0]).all()


def test_only_time_since_the_start_counts():
    """The same walk at the end of a day, over midnight and year, has the same bits."""
    since_ns = np.arange(0, 5 * 10**9, 1_234_567)
    year_end_ns = 1_798_761_600 * 10**9 - 2_500_000_001
    usual, late = (
        walking(harness=STRAPS, start_ns=start).poses_at(start + since_ns)
        for start in (1_780_000_000 * 10**9, year_end_ns)
    )
    assert (usual.world_p_body_m == late.world_p_body_m).all()
    assert (usual.world_R_body == late.world_R_body).all()


@pytest.mark.parametrize("after_s", [0.0, 86_400.0, 7 * 86_400.0 - 100.0])
@pytest.mark.parametrize("centre_m", [(0.0, 0.0, 0.0), (1e5, -1e5, 0.0)])
def test_poses_are_finite_and_continuous(after_s, centre_m):
    """Over seconds, days and 100 km from the origin, a microsecond moves the pack by no more than 3 um and
    1 urad."""
    t = after_s + np.arange(3.999990, 4.000010, 1e-6)
    poses = at(walking(Circle(centre_m), harness=SLACK), t)
    assert np.isfinite(poses.world_p_body_m).all()
    assert np.linalg.norm(np.diff(poses.world_p_body_m, axis=0), axis=1).max() < 3e-6
    assert np.abs(np.diff(poses.world_R_body, axis=0)).max() < 1e-6


def test_angles_turn_as_documented():
    """Yaw is counter-clockwise, positive pitch puts the nose down, positive roll the right side down."""
    yaw, pitch, roll = (rotations(np.array([a]), b, c)[0] for a, b, c in np.eye(3) * 0.1)
    assert (yaw @ [1, 0, 0])[1] > 0.09
    assert (pitch @ [1, 0, 0])[2] < -0.09
    assert (roll @ [0, -1, 0])[2] < -0.09
    for turn in (yaw, pitch, roll):
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(turn) > 0.999
