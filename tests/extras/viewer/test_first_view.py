"""The camera of the page begins where trees do not hide the sensor."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from vlp16emu.extras.viewer.page import _FREE_M, _filled, _look_from, _room_m
from vlp16emu.extras.viewer.stand import BEHIND_M, _with_camera

PLACE_M, AHEAD_M = np.array([3.0, 4.0, 2.0]), np.array([2.0, 0.0, 0.1])


def stand_of(*trees, base_m=9.0):
    """Stems at places (x, y) with a DBH, all with crowns 4 m wide from `base_m` on."""
    fields = ("x_m", "y_m", "z_m", "dbh_m", "crown_base_m", "crown_width_m")
    near = np.zeros(len(trees), [(name, "f8") for name in fields])
    for row, (x_m, y_m, dbh_m) in zip(near, trees, strict=True):
        row["x_m"], row["y_m"], row["dbh_m"] = x_m, y_m, dbh_m
        row["crown_base_m"], row["crown_width_m"] = base_m, 4.0
    return SimpleNamespace(near=near)


def first_view(stand):
    """Place of the camera."""
    server = SimpleNamespace(initial_camera=SimpleNamespace())
    _look_from(server, PLACE_M, AHEAD_M, stand)
    return np.array(server.initial_camera.position)


def test_the_camera_is_straight_behind_the_sensor_without_trees():
    """It looks ahead from 6 m behind the sensor."""
    camera_m = first_view(stand_of())
    assert camera_m[:2] == pytest.approx([3.0 - BEHIND_M, 4.0])


@pytest.mark.parametrize("waits", [0, 3])
def test_distances_count_from_the_first_camera(waits):
    """The path of distances begins straight behind the first step of a walk, also of one that waits first; a
    walk that stays in place has no behind."""
    start_m = np.array([[3.0, 4.0]])
    walk_m = np.vstack([np.repeat(start_m, 1 + waits, axis=0), [[3.0, 5.0], [8.0, 5.0]]])
    assert _with_camera(walk_m)[0] == pytest.approx([3.0, 4.0 - BEHIND_M])
    assert np.array_equal(_with_camera(walk_m)[1:], walk_m)
    assert np.array_equal(_with_camera(start_m), start_m)


def test_a_stem_before_the_sensor_moves_the_camera():
    """A stem on the line from the camera to the sensor turns the camera until there is room."""
    stand = stand_of((0.0, 4.0, 0.6))
    camera_m = first_view(stand)
    assert math.hypot(*(camera_m - PLACE_M)[:2]) == pytest.approx(BEHIND_M)
    assert _room_m(camera_m, PLACE_M, stand) >= _FREE_M


def test_a_stem_close_to_the_camera_does_not_fill_the_view():
    """From straight behind, a stem of 50 cm stands 1.5 m before the camera, 1 m beside the line of sight. The
    camera takes a place from which it is less than half as wide, or out of sight."""
    stand = stand_of((-1.5, 5.0, 0.5))
    straight_m = np.array([3.0 - BEHIND_M, 4.0, 4.5])
    look_at_m = PLACE_M + [BEHIND_M, 0.0, 0.0]
    before = _filled(straight_m, look_at_m, stand)
    assert before == pytest.approx(0.25 / 1.5, rel=0.01)
    assert _room_m(straight_m, PLACE_M, stand) > _FREE_M
    assert _filled(first_view(stand), look_at_m, stand) < before / 2


def test_a_sapling_about_the_sensor_leaves_the_choice_to_the_stems():
    """The camera takes a place from which the stem is not in sight, if a low crown around the sensor leaves
    it no room."""
    sapling, stem = stand_of((3.0, 4.1, 0.02), base_m=0.2).near, stand_of((-1.5, 5.0, 0.5)).near
    stand = SimpleNamespace(near=np.concatenate([sapling, stem]))
    camera_m = first_view(stand)
    assert _room_m(camera_m, PLACE_M, stand) < -1.5
    assert _filled(camera_m, PLACE_M + [BEHIND_M, 0.0, 0.0], SimpleNamespace(near=stem)) == 0.0
