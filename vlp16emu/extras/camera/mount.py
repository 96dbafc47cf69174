"""Mount of the camera of a scene, and the axes of its images."""

import numpy as np

from vlp16emu.extras.camera.settings import Camera
from vlp16emu.motion.mount import true_mount
from vlp16emu.motion.settings import Mount
from vlp16emu.scenario import Scenario
from vlp16emu.types import F8

AXES = "x right, y down, z forward"  # of a camera (REP 103, suffix `_optical`)
_DEVICE = 1001  # device number of its mount, above all sensors and the inertial unit


def camera_of(scenario: Scenario) -> Camera:
    """Return the camera of a scene, or the default one."""
    return scenario.camera if isinstance(scenario.camera, Camera) else Camera()


def camera_mount(scenario: Scenario) -> Mount:
    """Return the true mount of a scene's camera."""
    return true_mount(camera_of(scenario).mount, scenario.sensor_seed, _DEVICE)


def optical(R: F8) -> F8:
    """Return rotations (..., 3, 3) of `AXES` for rotations of x forward, y left, z up."""
    forward = R[..., 0]
    left = R[..., 1]
    up = R[..., 2]
    return np.stack([-left, -up, forward], axis=-1) + 0.0  # no -0.0
