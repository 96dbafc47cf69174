"""What SLAM programs read of bags of a VLP-16: ready configurations, and whether a bag is fit for a program."""

from vlp16emu.extras.slam.configure import Rig, chosen, configurations, programs, written_beside
from vlp16emu.extras.slam.fitness import Fitness, Unfit, fitness

__all__ = ["Fitness", "Rig", "Unfit", "chosen", "configurations", "fitness", "programs", "written_beside"]
