"""Where light meets surfaces: sub-rays of each pulse through what is near and what is far. The only border to float32.

The settings are here by name, the models in the files of the room.
"""

from vlp16emu.raycast.settings import Beam

__all__ = ["Beam"]
