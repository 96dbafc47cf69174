"""Where the carrier is, at any time; its settings by name here, its models in the files of the room."""

from vlp16emu.motion.live_settings import Live
from vlp16emu.motion.settings import Gait, Gps, Harness, Imu, LawnMower, MotionSection, Mount, Static, Stop, Walk

__all__ = ["Gait", "Gps", "Harness", "Imu", "LawnMower", "Live", "MotionSection", "Mount", "Static", "Stop", "Walk"]
