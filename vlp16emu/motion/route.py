"""A path with its timing: where a person is on it, at any time."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion.path import Path
from vlp16emu.motion.profile import Pace, Profile, Stop
from vlp16emu.motion.track import Track

__all__ = ["Route", "stops_on"]

Array = NDArray[np.float64]


def stops_on(path: Path, pause_s: Array) -> list[Stop]:
    """Give the stops at the way points of a path: those where the pauses (n,) are above 0."""
    return [
        Stop(float(at_m), float(for_s))
        for at_m, for_s in zip(path.way_points_at_m, pause_s, strict=True)
        if for_s > 0.0
    ]


class Route:
    """The way of a person along a path, `laps` times round where it is closed.

    Parameters
    ----------
    path : over the ground
    laps : 1 or more; more than 1 on a closed path only
    pace : limits, and the stops of each lap
    speed_m_s, run_time_s : cruise speed, or the time to which it is adapted; the other is None

    Raises
    ------
    TrajectoryError
        where an open path is to be walked more than once, a stop is not on the path, or the time is too short
    """

    def __init__(
        self, path: Path, *, laps: int, pace: Pace, speed_m_s: float | None, run_time_s: float | None
    ) -> None:
        if laps > 1 and not path.closed:
            raise TrajectoryError(
                "laps", f"found {laps} on an open path", "1, or a last way point on the first"
            )
        self._path = path
        self.length_m = laps * path.length_m
        """Of the whole way."""
        stops = [
            # So that the end of one lap and the start of the next are one to the last bit.
            Stop((lap + stop.at_m / path.length_m) * path.length_m, stop.pause_s)
            for lap in range(laps)
            for stop in pace.stops
        ]
        self._profile = Profile(
            self.length_m,
            lambda s_m: path.derivatives_at(s_m)[1][:, 1],
            Pace(pace.acceleration_m_s2, pace.yaw_rate_rad_s, stops),
            speed_m_s=speed_m_s,
            run_time_s=run_time_s,
        )
        self.run_time_s = self._profile.run_time_s
        """From the first motion to the last."""
        self.speed_m_s = self._profile.speed_m_s
        """Cruise speed."""

    def at(self, elapsed_s: Array) -> Track:
        """Track at times (n,) since the start; before it and after the run time the person stands."""
        along_m, speed_m_s, acceleration_m_s2 = self._profile.at(elapsed_s)
        point_m, heading_rad = self._path.derivatives_at(along_m)
        speed2 = speed_m_s * speed_m_s
        return Track(
            position_m=np.ascontiguousarray(point_m[:, 0]),
            velocity_m_s=point_m[:, 1] * speed_m_s[:, None],
            acceleration_m_s2=point_m[:, 2] * speed2[:, None] + point_m[:, 1] * acceleration_m_s2[:, None],
            yaw_rad=np.ascontiguousarray(heading_rad[:, 0]),
            yaw_rate_rad_s=heading_rad[:, 1] * speed_m_s,
            yaw_acceleration_rad_s2=heading_rad[:, 2] * speed2 + heading_rad[:, 1] * acceleration_m_s2,
            speed_m_s=speed_m_s,
        )
