"""From the sections of a scenario to the parts of an emulator. Builds no geometry yet."""

from vlp16emu.chain.parts import Like, Parts, PulseHook, Unit, assemble, beam_of, in_one_world, with_events
from vlp16emu.chain.windows import window_of, windows_of

__all__ = [
    "Like",
    "Parts",
    "PulseHook",
    "Unit",
    "assemble",
    "beam_of",
    "in_one_world",
    "window_of",
    "windows_of",
    "with_events",
]
