"""What travels inside the room: the way over the ground, and the motion of a body with its derivatives."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Kinematics", "Track", "Way"]


@dataclass(frozen=True, slots=True)
class Track:
    """Where the foot point of the path is at n instants: over the ground, before any gait.

    Velocities, accelerations and rates are the exact time derivatives of the same function.
    """

    position_m: NDArray[np.float64]
    """(n, 3) world."""
    velocity_m_s: NDArray[np.float64]
    """(n, 3) world."""
    acceleration_m_s2: NDArray[np.float64]
    """(n, 3) world."""
    yaw_rad: NDArray[np.float64]
    """(n,) heading, counter-clockwise from east; continuous, so it may pass pi."""
    yaw_rate_rad_s: NDArray[np.float64]
    """(n,)."""
    yaw_acceleration_rad_s2: NDArray[np.float64]
    """(n,)."""
    speed_m_s: NDArray[np.float64]
    """(n,) along the path, never negative."""


class Way(Protocol):
    """A path with its timing; twice continuously differentiable in position and heading."""

    @property
    def run_time_s(self) -> float:
        """From the first step to the last rest."""

    def at(self, elapsed_s: NDArray[np.float64]) -> Track:
        """Track at times (n,) since the start; before it and after the run time the person stands."""


@dataclass(frozen=True, slots=True)
class Kinematics:
    """Poses of a body at n instants with the exact derivatives of the same function."""

    t_ns: NDArray[np.int64]
    """(n,) UTC."""
    world_R_body: NDArray[np.float64]
    """(n, 3, 3) rotation, body to world."""
    world_p_body_m: NDArray[np.float64]
    """(n, 3) origin of the body in the world."""
    world_v_body_m_s: NDArray[np.float64]
    """(n, 3) its velocity."""
    world_a_body_m_s2: NDArray[np.float64]
    """(n, 3) its acceleration, without gravity."""
    body_w_rad_s: NDArray[np.float64]
    """(n, 3) angular rate of the body, in body axes."""
    body_alpha_rad_s2: NDArray[np.float64]
    """(n, 3) time derivative of `body_w_rad_s`."""
