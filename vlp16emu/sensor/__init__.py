"""What a VLP-16 is, and what others like it are: beams, firing times, rotor and clock.

The settings are here by name, the models in the files of the room.
"""

from vlp16emu.sensor.settings import AnySensor, FreeSensor, Lidar, Sensor, on_the_wire

__all__ = ["AnySensor", "FreeSensor", "Lidar", "Sensor", "on_the_wire"]
