"""What is around the sensor: a forest that grows itself along the walk, or a hall of known shapes.

Here are the tables of a scene alone, so that one is read without numpy and numba; models are in their own modules.
"""

from vlp16emu.forest.stand.settings import Forest, Plot, Wind, Woods
from vlp16emu.world.settings import Hall

__all__ = ["Forest", "Hall", "Plot", "Wind", "Woods"]
