"""The drone of `tools/drone`, steered by a gamepad."""

import argparse
import math
import struct
from itertools import islice

import numpy as np
import pytest


@pytest.fixture(scope="module")
def drone(tool_named):
    return tool_named("drone")


class Device:
    """Device of a gamepad: gives events, and notes the sticks before each."""

    def __init__(self, gamepad, events):
        self.gamepad, self.noted = gamepad, []
        self.data = [struct.pack("<IhBB", 7, *event) for event in events]

    def read(self, _):
        """Give the next event; none once the device is gone."""
        self.noted.append(self.gamepad.axes)
        self.gamepad.axes = dict(self.gamepad.axes)
        return self.data.pop(0) if self.data else b""


def test_sticks_are_read_as_linux_writes_them(drone):
    """Axes 0, 1 and 4 count, from their state at the start on; buttons and a stick almost at rest do not;
    a lost device releases all."""
    gamepad = drone.Gamepad()
    device = Device(
        gamepad, [(0, 0x81, 0), (-32_767, 0x82, 1), (16_384, 2, 0), (9_000, 2, 3), (1, 1, 4), (2_000, 2, 0)]
    )
    gamepad.follow(device)
    ahead = [round(axes[1], 2) for axes in device.noted]
    turn = [round(axes[0], 2) for axes in device.noted]
    assert ahead == [0, 0, -1, -1, -1, -1, -1]
    assert turn == [0, 0, 0, 0.5, 0.5, 0.5, 0]
    assert set(gamepad.axes.values()) == {0.0}


def test_a_drone_follows_its_sticks(drone):
    """It stands at the centre, flies ahead at the speed, turns left at 1 rad/s, and climbs; its quaternion
    is of unit length."""
    given = argparse.Namespace(rate=100.0, speed=3.0)
    gamepad = drone.Gamepad()
    poses = drone.steered(given, [1.0, 2.0, 1.5], gamepad)
    assert next(poses) == (1.0, 2.0, 1.5, 0.0, 0.0, 0.0, 1.0)
    gamepad.axes = {0: 0.0, 1: -1.0, 4: 0.0}
    *_, last = islice(poses, 100)
    np.testing.assert_allclose(last, (4.0, 2.0, 1.5, 0.0, 0.0, 0.0, 1.0))
    gamepad.axes = {0: -1.0, 1: 0.0, 4: -1.0}
    *_, last = islice(poses, 100)
    np.testing.assert_allclose(last, (4.0, 2.0, 3.0, 0.0, 0.0, math.sin(0.5), math.cos(0.5)))


def test_a_device_that_is_not_there_is_one_line(drone, capsys):
    """The tool ends with exit code 2 and the name of the device."""
    with pytest.raises(SystemExit) as end:
        drone.main(["--gamepad", "/dev/input/none", "--duration", "0.1"])
    assert end.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].endswith("/dev/input/none: No such file or directory")
