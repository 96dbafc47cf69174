"""What stands in a world: in figures, on a plan, and in a section from the side."""

from vlp16emu.extras.palette import colour_of_kind, colour_of_species, surface_colours
from vlp16emu.extras.sheets.figures import CELL_M, Relief, StandRow, cells_near, clark_evans, relief, stand_rows
from vlp16emu.extras.sheets.plan import PlanView
from vlp16emu.extras.sheets.section import StandSection, draw_section, strip_along
from vlp16emu.extras.sheets.sheet import draw_sheet, section_pixels_per_m

__all__ = [
    "CELL_M",
    "PlanView",
    "Relief",
    "StandRow",
    "StandSection",
    "cells_near",
    "clark_evans",
    "colour_of_kind",
    "colour_of_species",
    "draw_section",
    "draw_sheet",
    "relief",
    "section_pixels_per_m",
    "stand_rows",
    "strip_along",
    "surface_colours",
]
