"""What stands still: a forest that grows itself around the walk, or a hall of known shapes."""

from vlp16emu.world.forest import Forest
from vlp16emu.world.hall import Box, Hall, Pole, Sphere
from vlp16emu.world.species import BREAST_HEIGHT_M, Species, species_table
from vlp16emu.world.stand import TREE, SpeciesMix
from vlp16emu.world.terrain import Terrain

__all__ = [
    "BREAST_HEIGHT_M",
    "TREE",
    "Box",
    "Forest",
    "Hall",
    "Pole",
    "Species",
    "SpeciesMix",
    "Sphere",
    "Terrain",
    "species_table",
]
