"""Motions of the carrier at any time; their settings by name here, their models in the files of the room."""

from vlp16emu.motion.settings import Gait, Gps, Harness, LawnMower, MotionSection, Mount, Static, Stop, Walk

__all__ = ["Gait", "Gps", "Harness", "LawnMower", "MotionSection", "Mount", "Static", "Stop", "Walk"]
