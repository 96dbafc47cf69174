"""Where the carrier is, at any time."""

from vlp16emu.motion.gait import Gait, step_rate_hz
from vlp16emu.motion.geodesy import Origin, to_geodetic, to_local
from vlp16emu.motion.gnss import GnssErrors, GnssReading, Receiver, Sky
from vlp16emu.motion.harness import Harness
from vlp16emu.motion.imu import Imu, ImuErrors, Inertial
from vlp16emu.motion.mount import Mount, mounted
from vlp16emu.motion.path import Path
from vlp16emu.motion.pattern import lawn_mower
from vlp16emu.motion.pose import rotations
from vlp16emu.motion.profile import Pace, Stop
from vlp16emu.motion.recorded import Recorded
from vlp16emu.motion.route import Route, stops_on
from vlp16emu.motion.sweeps import Sweeps, sweeps_over
from vlp16emu.motion.track import Kinematics, Track, Way
from vlp16emu.motion.trajectory_file import RecordedPoses, read_kitti, read_trajectory_csv, read_tum
from vlp16emu.motion.walk import Motion, Standing, Walking
from vlp16emu.motion.way_points import WayPoints, read_way_points

__all__ = [
    "Gait",
    "GnssErrors",
    "GnssReading",
    "Harness",
    "Imu",
    "ImuErrors",
    "Inertial",
    "Kinematics",
    "Motion",
    "Mount",
    "Origin",
    "Pace",
    "Path",
    "Receiver",
    "Recorded",
    "RecordedPoses",
    "Route",
    "Sky",
    "Standing",
    "Stop",
    "Sweeps",
    "Track",
    "Walking",
    "Way",
    "WayPoints",
    "lawn_mower",
    "mounted",
    "read_kitti",
    "read_trajectory_csv",
    "read_tum",
    "read_way_points",
    "rotations",
    "step_rate_hz",
    "stops_on",
    "sweeps_over",
    "to_geodetic",
    "to_local",
]
