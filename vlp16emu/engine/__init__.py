"""A scenario set up and run in order: units, blocks, windows, timeline, merge."""

from vlp16emu.engine.build import Like, Parts, Unit, assemble, beam_of, in_one_world
from vlp16emu.engine.engine import Engine, Job, Tap, scan
from vlp16emu.engine.windows import Batching, window_of, workers

__all__ = [
    "Batching",
    "Engine",
    "Job",
    "Like",
    "Parts",
    "Tap",
    "Unit",
    "assemble",
    "beam_of",
    "in_one_world",
    "scan",
    "window_of",
    "workers",
]
