"""A person who walks with the sensor on the back: its settings by name here, its models in the files of the room."""

from vlp16emu.extras.walk.settings import Gait, Harness, LawnMower, Stop, Walk

__all__ = ["Gait", "Harness", "LawnMower", "Stop", "Walk"]
