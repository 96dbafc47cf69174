"""Where the carrier is, at any time."""

from vlp16emu.motion.gnss import fix_at, geodetic
from vlp16emu.motion.path import Path
from vlp16emu.motion.pose import rotations
from vlp16emu.motion.walk import Gait, Motion, Standing, Walking

__all__ = ["Gait", "Motion", "Path", "Standing", "Walking", "fix_at", "geodetic", "rotations"]
