"""What stands still: a forest that grows itself around the walk, or a hall of known shapes."""

from vlp16emu.world.dem import Dem
from vlp16emu.world.floor import Grass, Logs, Stones, Stumps, stones_per_ha
from vlp16emu.world.forest import Forest
from vlp16emu.world.furnished import Furnished, Furniture, Look, Place, looks_of
from vlp16emu.world.given_stand import GivenStand
from vlp16emu.world.hall import Box, Hall, Pole, Sphere
from vlp16emu.world.placed import Layer
from vlp16emu.world.points import Clusters, HardCore, Pattern, Rows, Scattered
from vlp16emu.world.polyline import Polyline
from vlp16emu.world.species import BREAST_HEIGHT_M, Flora, Species, flora, species_table
from vlp16emu.world.stand import REGENERATION, TREE, SpeciesMix, Stand, Storey, density_per_ha
from vlp16emu.world.stem_list import read_stem_list
from vlp16emu.world.terrain import Terrain
from vlp16emu.world.understorey import Saplings, Shrubs
from vlp16emu.world.user_mesh import load_mesh
from vlp16emu.world.wind import Wind

__all__ = [
    "BREAST_HEIGHT_M",
    "REGENERATION",
    "TREE",
    "Box",
    "Clusters",
    "Dem",
    "Flora",
    "Forest",
    "Furnished",
    "Furniture",
    "GivenStand",
    "Grass",
    "Hall",
    "HardCore",
    "Layer",
    "Logs",
    "Look",
    "Pattern",
    "Place",
    "Pole",
    "Polyline",
    "Rows",
    "Saplings",
    "Scattered",
    "Shrubs",
    "Species",
    "SpeciesMix",
    "Sphere",
    "Stand",
    "Stones",
    "Storey",
    "Stumps",
    "Terrain",
    "Wind",
    "density_per_ha",
    "flora",
    "load_mesh",
    "looks_of",
    "read_stem_list",
    "species_table",
    "stones_per_ha",
]
