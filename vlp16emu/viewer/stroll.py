"""A person who walks as keys or a gamepad say: the poses of the pack, gait included."""

import math
import struct
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vlp16emu.device.poses import PoseSender
from vlp16emu.motion.gait import Trunk
from vlp16emu.motion.pose import rotation
from vlp16emu.motion.settings import Gait
from vlp16emu.types import HeightField

KEYS = {
    "faster": ("W", "arrowup"),
    "slower": ("S", "arrowdown"),
    "left": ("A", "arrowleft"),
    "right": ("D", "arrowright"),
    "stop": ("X",),
}
"""What keys want of the walker; the same key again wants more."""

_HEIGHT_M, _SPEED_M_S = 2.0, 1.2
"""Of the pack over the ground, and where the gait is full: as of a walk."""
_FASTER_M_S, _FASTEST_M_S = 0.4, 2.0
_TURN_RAD, _MOST_TURN_RAD = math.radians(15.0), math.radians(90.0)
"""Of a key, and of keys that have not been followed yet."""
_PULL_M_S2 = 1.2
_TURN_PER_S, _FASTEST_RAD_S, _TWIST_RAD_S2 = 3.0, 1.5, 6.0
"""A turn is taken at that part of it per second, and no faster; and its own acceleration."""
_FARTHEST_M = 30.0
"""From where the scene expects the body; beyond 35 m a forest has not been laid out."""
_RATE_HZ = 100.0
_JOYSTICK_EVENT = struct.Struct("<IhBB")
"""Time in ms, value, type and number: `js_event` of linux/joystick.h."""
_BUTTON, _AXIS, _FULL = 1, 2, 32_767
"""Types, the latter two with bit 0x80 in what says how things are at first; and a stick that is pushed all the way."""
_SIDEWAYS, _UPWARDS = 0, 1
"""Axes of the left stick: right and towards the person are positive."""
_AT_REST = 0.12
"""Share of its way by which a stick that nobody holds is off."""


class Stroll:
    """A walker; begins at rest, looking east.

    Parameters
    ----------
    path_xy_m : (n, 2) where the scene expects it; begins at the first, and stays near the rectangle around them
    height_m : ground
    seed : of the gait's variation
    """

    def __init__(self, path_xy_m: NDArray[np.float64], height_m: HeightField, seed: int) -> None:
        self._xy_m, self._height_m = path_xy_m[0].astype(float), height_m
        self._low_m, self._high_m = path_xy_m.min(axis=0) - _FARTHEST_M, path_xy_m.max(axis=0) + _FARTHEST_M
        self._trunk = Trunk(Gait(), _SPEED_M_S, seed)
        self._elapsed_s = self._yaw_rad = self._turn_rad_s = self._speed_m_s = 0.0
        self._wanted_rad = self._wanted_m_s = self._leaned = 0.0

    def press(self, what: str) -> None:
        """Follow a key of `KEYS` from now on."""
        if what == "stop":
            self._wanted_m_s = 0.0
        elif what in ("faster", "slower"):
            by_m_s = _FASTER_M_S if what == "faster" else -_FASTER_M_S
            self._wanted_m_s = min(max(self._wanted_m_s + by_m_s, 0.0), _FASTEST_M_S)
        else:
            left_rad = self._wanted_rad - self._yaw_rad + (_TURN_RAD if what == "left" else -_TURN_RAD)
            self._wanted_rad = self._yaw_rad + min(max(left_rad, -_MOST_TURN_RAD), _MOST_TURN_RAD)

    def push(self, ahead: float, left: float) -> None:
        """Follow a stick from now on, which is pushed ahead and to the left by shares of its way, -1 to 1."""
        ahead, left = (0.0 if abs(share) < _AT_REST else share for share in (ahead, left))
        self._wanted_m_s = max(ahead, 0.0) * _FASTEST_M_S
        if left or self._leaned:  # or what keys want stays
            self._wanted_rad = self._yaw_rad
        self._leaned = left

    def step(self, step_s: float) -> None:
        """Walk on for a moment."""
        if self._leaned:
            self._wanted_rad = self._yaw_rad + self._leaned * _FASTEST_RAD_S / _TURN_PER_S
        turn_rad_s = _within(_TURN_PER_S * (self._wanted_rad - self._yaw_rad), _FASTEST_RAD_S)
        self._turn_rad_s += _within(turn_rad_s - self._turn_rad_s, _TWIST_RAD_S2 * step_s)
        self._speed_m_s += _within(self._wanted_m_s - self._speed_m_s, _PULL_M_S2 * step_s)
        self._yaw_rad += self._turn_rad_s * step_s
        ahead = np.array([math.cos(self._yaw_rad), math.sin(self._yaw_rad)])
        self._xy_m = np.clip(self._xy_m + self._speed_m_s * step_s * ahead, self._low_m, self._high_m)
        self._elapsed_s += step_s

    def pose(self) -> tuple[list[float], list[float]]:
        """Position (3,) and quaternion (4,) x, y, z, w of the pack, with the trunk's sway."""
        share = min(self._speed_m_s / _SPEED_M_S, 1.0)
        effort = share * share * (3.0 - 2.0 * share)  # as of a walk
        sway = self._trunk.at(np.array([self._elapsed_s]), np.array([effort]))[0]
        ahead, left, up, roll, pitch, yaw = sway.tolist()
        c, s = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        ground_m = float(self._height_m(self._xy_m[:1], self._xy_m[1:])[0])
        x_m, y_m = self._xy_m.tolist()
        turn = rotation(*(math.degrees(angle) for angle in (self._yaw_rad + yaw, pitch, roll)))
        place_m = [x_m + c * ahead - s * left, y_m + s * ahead + c * left, ground_m + _HEIGHT_M + up]
        return place_m, Rotation.from_matrix(turn).as_quat().tolist()

    @property
    def summary(self) -> str:
        """How it walks, in words."""
        return f"{self._speed_m_s:.1f} m/s to {math.degrees(self._yaw_rad) % 360:.0f} degrees from east"


def stroll_on(stroll: Stroll, sender: PoseSender, begin: threading.Event) -> None:
    """Send the poses of a walker at a steady rate, for ever, once it may begin; takes the thread."""
    begin.wait()
    before_s = time.monotonic()
    while True:
        time.sleep(1.0 / _RATE_HZ)
        now_s = time.monotonic()
        stroll.step(now_s - before_s)
        before_s = now_s
        sender.send(*stroll.pose(), round(now_s * 1e9))


def gamepad_on(stroll: Stroll, device: Path) -> None:
    """Let a gamepad lead a walker: its left stick sets speed and turn, any button stops; takes the thread.

    Parameters
    ----------
    device : joystick of Linux, as /dev/input/js0; where it goes away the walker stops
    """
    pushed = {_SIDEWAYS: 0.0, _UPWARDS: 0.0}
    with suppress(OSError), device.open("rb", buffering=0) as file:
        while len(event := file.read(_JOYSTICK_EVENT.size) or b"") == _JOYSTICK_EVENT.size:
            _, value, kind, number = _JOYSTICK_EVENT.unpack(event)
            if kind & 0x7F == _AXIS and number in pushed:
                pushed[number] = value / _FULL
                stroll.push(-pushed[_UPWARDS], -pushed[_SIDEWAYS])
            elif kind == _BUTTON and value:
                stroll.press("stop")
    stroll.push(0.0, 0.0)


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
