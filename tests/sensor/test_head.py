"""Instants, directions and origins of pulses, against the manual's formulas written out."""

import math
from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.rotation import rotations
from vlp16emu.sensor.beams import BEAM_TABLES, with_angle_errors
from vlp16emu.sensor.clock import Clock, ClockSpan
from vlp16emu.sensor.head import Head
from vlp16emu.sensor.rotor import Encoder, Rotor, Spin
from vlp16emu.types import Poses, SensorModel

START_NS = 1_780_000_000_123_456_789


@pytest.fixture
def head():
    rotor = Rotor((Spin(0, 10.0, 600),), Encoder(1, once=(0.06, 40.0), noise_deg=0.005))
    return Head(BEAM_TABLES[SensorModel.VLP_16], rotor, Clock((ClockSpan(0),)), START_NS)


def pose(yaw=0.0, pitch=0.0, roll=0.0, at=(0.0, 0.0, 0.0)):
    turn = rotations(np.array([yaw]), pitch, roll)
    return lambda _t_ns: Poses(np.zeros(1, np.int64), turn, np.array([at]))


def test_point_in_the_sensor_frame_is_the_manuals(head):
    """R along a pulse leads to X = R cos w sin a, Y = R cos w cos a, Z = R sin w + correction."""
    firings = head.aim(0, 4, pose())
    R = 12.0
    point = firings.origin_m + R * firings.direction
    for i, j in np.ndindex(4, 16):
        a, w = math.radians(firings.azimuth_deg[i, j]), math.radians(head.beams.elevation_deg[j])
        x, y = R * math.cos(w) * math.sin(a), R * math.cos(w) * math.cos(a)
        z = R * math.sin(w) + head.beams.vertical_offset_m[j]
        # Mounted with azimuth 0 forward: sensor y is body x, sensor x is to the right.
        np.testing.assert_allclose(point[i, j], [y, -x, z], atol=1e-12)


def test_each_pulse_uses_its_own_pose(head):
    """A body that moves from pulse to pulse moves each origin, by exactly as much."""

    def moving(t_ns):
        east_m = (t_ns - START_NS) * 1.2e-9
        turn = np.repeat(np.eye(3)[None], len(t_ns), axis=0)
        return Poses(t_ns, turn, np.column_stack([east_m, 0 * east_m, 0 * east_m]))

    still, moved = head.aim(0, 8, pose()), head.aim(0, 8, moving)
    shift_m = moved.origin_m[..., 0] - still.origin_m[..., 0]
    np.testing.assert_allclose(shift_m, (still.t_ns - START_NS) * 1.2e-9, atol=1e-15)
    assert (moved.direction == still.direction).all()


def test_tilted_body_turns_rays_and_offsets(head):
    """A rotation of the body rotates every ray and every offset about the body's origin."""
    yaw, pitch, roll = 0.4, 0.2, -0.1
    level, tilted = head.aim(0, 8, pose()), head.aim(0, 8, pose(yaw, pitch, roll, at=(5.0, 6.0, 7.0)))
    R = rotations(np.array([yaw]), pitch, roll)[0]
    np.testing.assert_allclose(tilted.direction, level.direction @ R.T, atol=1e-14)
    np.testing.assert_allclose(tilted.origin_m, level.origin_m @ R.T + [5.0, 6.0, 7.0], atol=1e-14)


def test_the_beam_axis_is_where_the_beam_moves(head):
    """It is the direction's derivative by the rotor's angle at unit length, level in the sensor, and left
    out unless wanted."""
    yaw, pitch, roll = 0.4, 0.2, -0.1
    aimed, line = (head.aim(0, 8, pose(yaw, pitch, roll), beam_axis=wide) for wide in (True, False))
    assert line.beam_axis is None
    assert (line.direction == aimed.direction).all()
    later = replace(head, rotor=replace(head.rotor, spins=(Spin(0, 10.0 + 1e-4, 600),)))
    moved = later.aim(0, 8, pose(yaw, pitch, roll)).direction - aimed.direction
    moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
    np.testing.assert_allclose(aimed.beam_axis, moved, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(aimed.beam_axis, axis=-1), 1.0, atol=1e-15)
    np.testing.assert_allclose((aimed.beam_axis * aimed.direction).sum(axis=-1), 0.0, atol=1e-15)
    up = rotations(np.array([yaw]), pitch, roll)[0][:, 2]
    np.testing.assert_allclose(aimed.beam_axis @ up, 0.0, atol=1e-15)


def test_angle_errors_turn_the_beams_and_nothing_else(head):
    """A laser looks by its own errors higher and farther round; rotor, encoder and times know nothing of
    it."""
    unit = replace(
        head, beams=with_angle_errors(head.beams, elevation_error_deg=0.03, azimuth_error_deg=0.05, seed=3)
    )
    reported, true = head.aim(0, 8, pose()), unit.aim(0, 8, pose())
    # Body x is forward at azimuth 0 and y is left, so azimuths count from x to -y.
    azimuth_deg = np.degrees(np.arctan2(-true.direction[..., 1], true.direction[..., 0]))
    elevation_deg = np.degrees(np.arcsin(true.direction[..., 2]))
    np.testing.assert_allclose(
        azimuth_deg - reported.azimuth_deg, np.tile(unit.beams.azimuth_error_deg, (8, 1)), atol=1e-9
    )
    np.testing.assert_allclose(
        elevation_deg - head.beams.elevation_deg, np.tile(unit.beams.elevation_error_deg, (8, 1)), atol=1e-9
    )
    for name in ("t_ns", "clock_ns", "azimuth_deg", "reading_deg", "origin_m"):
        np.testing.assert_array_equal(getattr(true, name), getattr(reported, name))
