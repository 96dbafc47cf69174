"""What the detector makes of the light that comes back: echoes, their range and reflectivity, noise and weather.

The settings are here by name, the models in the files of the room.
"""

from vlp16emu.returns.settings import Detector, Noise, Weather

__all__ = ["Detector", "Noise", "Weather"]
