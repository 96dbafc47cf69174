"""Points against the pulses they come from."""

from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.extras.clouds.scan import positions_of
from vlp16emu.rotation import rotations
from vlp16emu.sensor.beams import BEAM_TABLES, with_angle_errors
from vlp16emu.sensor.clock import Clock, ClockSpan
from vlp16emu.sensor.head import Head
from vlp16emu.sensor.rotor import Encoder, Rotor, Spin
from vlp16emu.types import Poses, SensorModel

START_NS = 1_780_000_000 * 10**9
SEQUENCE, LASER = (index.ravel() for index in np.indices((8, 16)))
DISTANCE_M = np.linspace(0.5, 100.0, 128).astype(np.float32)


@pytest.fixture
def head():
    rotor = Rotor((Spin(0, 350.0, 600),), Encoder(1))
    return Head(BEAM_TABLES[SensorModel.VLP_16], rotor, Clock((ClockSpan(0),)), START_NS)


def carried(t_ns):
    """Poses that differ from pulse to pulse."""
    yaw_rad = (t_ns - START_NS) * 3e-6
    xyz_m = np.column_stack([(t_ns - START_NS) * 1e-5, 5 + 0 * yaw_rad, 2 - yaw_rad])
    return Poses(t_ns, rotations(yaw_rad, 0.2, -0.1), xyz_m)


def placed(head, poses_at=carried):
    firings = head.aim(0, 8, poses_at)
    return firings, positions_of(
        head.beams, firings, SEQUENCE, LASER, DISTANCE_M, poses_at(firings.t_ns.ravel())
    )


def test_without_errors_a_point_lies_on_its_pulse(head):
    """In the world it is origin + distance * direction of its own pulse."""
    firings, points = placed(head)
    expected_m = firings.origin_m + DISTANCE_M.reshape(8, 16, 1).astype(float) * firings.direction
    np.testing.assert_allclose(points["world_m"], expected_m.reshape(-1, 3), atol=1e-11)


def test_points_are_where_the_sensor_believes(head):
    """Encoder and angle errors move the pulse and not the belief: points stay in the directions of table
    and reading."""
    rotor = replace(head.rotor, encoder=Encoder(1, once=(0.06, 40.0)))
    beams = with_angle_errors(head.beams, elevation_error_deg=0.03, azimuth_error_deg=0.03, seed=1)
    firings, points = placed(replace(head, rotor=rotor, beams=beams))
    x, y, z = points["sensor_m"].T
    believed_deg = np.degrees(np.arctan2(-y, x)) % 360
    turned_deg = (firings.azimuth_deg - firings.azimuth_deg[:, :1]).ravel()
    np.testing.assert_allclose(believed_deg, firings.reading_deg[SEQUENCE] + turned_deg, atol=1e-9)
    np.testing.assert_allclose(points["azimuth_deg"], believed_deg, atol=1e-9)
    elevation_deg = np.degrees(np.arcsin((z - beams.vertical_offset_m[LASER]) / DISTANCE_M))
    np.testing.assert_allclose(elevation_deg, head.beams.elevation_deg[LASER], atol=1e-9)
    np.testing.assert_array_equal(points["elevation_deg"], head.beams.elevation_deg[LASER])


def test_azimuths_stay_in_the_circle(head):
    """Where the rotor passes 0 between two lasers the azimuth goes on from there, never to 360."""
    ahead = replace(head, rotor=replace(head.rotor, spins=(Spin(0, 359.999, 600),)))
    _, points = placed(ahead)
    assert points["azimuth_deg"].max() < 360
    assert points["azimuth_deg"][0] == pytest.approx(359.999)
    assert points["azimuth_deg"][1] == pytest.approx(359.999 + 2_304e-9 * 3600 - 360)


def test_tangents_move_points_aside_at_their_distance(head):
    """Points off their pulses are as far from the sensor, and lie to greater azimuths and upwards by their
    tangents."""
    _, on = placed(head)
    tangents = np.random.default_rng(1).uniform(-0.01, 0.01, (128, 2))
    firings = head.aim(0, 8, carried, beam_axis=True)
    poses = carried(firings.t_ns.ravel())
    off = positions_of(head.beams, firings, SEQUENCE, LASER, DISTANCE_M, poses, tangents)
    origin_m, across = firings.origin_m.reshape(-1, 3), firings.beam_axis.reshape(-1, 3)
    up = np.cross(across, firings.direction.reshape(-1, 3))
    np.testing.assert_allclose(np.linalg.norm(off["world_m"] - origin_m, axis=1), DISTANCE_M, rtol=1e-12)
    moved = (off["world_m"] - on["world_m"]) / DISTANCE_M[:, None]
    np.testing.assert_allclose(
        np.stack([(moved * axis).sum(axis=1) for axis in (across, up)], axis=1), tangents, atol=1e-12
    )
    np.testing.assert_allclose(
        off["world_m"],
        np.einsum("nab,nb->na", poses.world_R_body, off["sensor_m"]) + poses.world_p_body_m,
        atol=1e-11,
    )
