"""Surroundings of the sensor: a hall of known shapes here, forests in a package of their own.

Here are the tables of a scene alone, so that one is read without numpy and numba; models are in their own modules.
"""

from vlp16emu.world.settings import Hall, People, WorldSection

__all__ = ["Hall", "People", "WorldSection"]
