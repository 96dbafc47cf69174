"""From the sections of a scenario to the parts of an emulator. Builds no geometry yet."""

from vlp16emu.assembly.parts import Parts, Unit, assemble
from vlp16emu.assembly.windows import windows_of

__all__ = ["Parts", "Unit", "assemble", "windows_of"]
