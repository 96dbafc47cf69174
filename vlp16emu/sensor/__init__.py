"""Beams, firing times, rotor and clock of a VLP-16 and of others like it: settings here by name, models in the files of the room."""

from vlp16emu.sensor.settings import AnySensor, Lidar, Sensor, on_the_wire

__all__ = ["AnySensor", "Lidar", "Sensor", "on_the_wire"]
