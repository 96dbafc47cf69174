"""A sensor that stands, and a sensor that is carried."""

import math
from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.motion.path import Path
from vlp16emu.motion.pose import rotations
from vlp16emu.types import Poses
from vlp16emu.units import S_NS

__all__ = ["Gait", "Motion", "Standing", "Walking"]


class Motion(Protocol):
    """Where the body is at any time."""

    @property
    def run_time_s(self) -> float:
        """For how long there is a pose; infinite where the motion never ends."""

    @property
    def moves(self) -> bool:
        """Whether poses differ from one instant to another."""

    def poses_at(self, t_ns: NDArray[np.int64]) -> Poses:
        """Poses at UTC instants (n,); a single one where nothing moves."""


class Standing:
    """A sensor on a tripod: one pose, computed once.

    Parameters
    ----------
    position_m : (3,) world
    yaw_deg, pitch_deg, roll_deg : as in `motion.pose.rotations`
    """

    run_time_s = math.inf
    moves = False

    def __init__(
        self, position_m: NDArray[np.float64], yaw_deg: float, pitch_deg: float, roll_deg: float
    ) -> None:
        turn = rotations(np.array([math.radians(yaw_deg)]), math.radians(pitch_deg), math.radians(roll_deg))
        self._poses = Poses(np.zeros(1, np.int64), turn, position_m[None])

    def poses_at(self, t_ns: NDArray[np.int64]) -> Poses:  # noqa: ARG002  # it stands at all times
        """Return the one pose."""
        return self._poses


@dataclass(frozen=True, slots=True)
class Gait:
    """Human movement as two sines (Lu et al., LiDAR-Forest, human-movement module)."""

    step_hz: float
    vertical_m: float
    """Amplitude of rise and fall, once per step."""
    sideways_m: float
    """Amplitude of sway, once per two steps."""


class Walking:
    """A person who walks along a path at constant speed with the sensor on the back.

    Parameters
    ----------
    path : over the ground
    start_ns : UTC at which the walk begins
    speed_m_s : along the path
    sensor_height_m : of the sensor's centre over the ground under it
    pitch_deg, roll_deg : mounting, as in `motion.pose.rotations`
    gait : sway about the path
    """

    moves = True

    def __init__(
        self,
        path: Path,
        *,
        start_ns: int,
        speed_m_s: float,
        sensor_height_m: float,
        pitch_deg: float,
        roll_deg: float,
        gait: Gait,
    ) -> None:
        self._path, self._start_ns, self._speed_m_s, self._gait = path, start_ns, speed_m_s, gait
        self._height_m = sensor_height_m
        self._pitch_rad, self._roll_rad = math.radians(pitch_deg), math.radians(roll_deg)
        self.run_time_s = path.length_m / speed_m_s

    def poses_at(self, t_ns: NDArray[np.int64]) -> Poses:
        """Poses at UTC instants (n,); before the start and after the end the person is at the path's ends."""
        # Whole seconds and their rest apart: float64 keeps nanoseconds even after days.
        elapsed_ns = t_ns - self._start_ns
        elapsed_s = elapsed_ns // S_NS + (elapsed_ns % S_NS) / S_NS
        position_m, heading_rad = self._path.at(elapsed_s * self._speed_m_s)
        gait = self._gait
        _sway(
            elapsed_s, heading_rad, self._height_m, gait.step_hz, gait.vertical_m, gait.sideways_m, position_m
        )
        return Poses(t_ns, rotations(heading_rad, self._pitch_rad, self._roll_rad), position_m)


@numba.njit(cache=True, nogil=True)
def _sway(
    elapsed_s: NDArray[np.float64],
    heading_rad: NDArray[np.float64],
    height_m: float,
    step_hz: float,
    vertical_m: float,
    sideways_m: float,
    position_m: NDArray[np.float64],
) -> None:
    """Lift ground points to the sensor and let them sway; positive sideways is to the left."""
    for i in range(elapsed_s.size):
        phase = 2.0 * math.pi * step_hz * elapsed_s[i]
        left_m = sideways_m * math.sin(0.5 * phase)
        position_m[i, 0] -= left_m * math.sin(heading_rad[i])
        position_m[i, 1] += left_m * math.cos(heading_rad[i])
        position_m[i, 2] += height_m + vertical_m * math.sin(phase)
