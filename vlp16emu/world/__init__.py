"""Surroundings of the sensor: the tables of a hall of known shapes here, its model and the shapes of others in the files of the room."""

from vlp16emu.world.settings import Hall, People, WorldSection

__all__ = ["Hall", "People", "WorldSection"]
