"""Motions of the carrier at any time, and devices on it; their settings by name here, their models in the files of the room."""

from vlp16emu.motion.settings import Gps, MotionSection, Mount, Static

__all__ = ["Gps", "MotionSection", "Mount", "Static"]
