"""What a VLP-16 is, and what others like it are: beams, firing times, rotor and clock."""

from vlp16emu.sensor.beams import (
    BEAM_TABLES,
    LASER_NS,
    LENS_RADIUS_M,
    SEQUENCE_NS,
    BeamTable,
    free_beams,
    with_angle_errors,
)
from vlp16emu.sensor.clock import Clock
from vlp16emu.sensor.head import BODY_R_SENSOR, Head
from vlp16emu.sensor.place import Placed, place
from vlp16emu.sensor.rotor import Rotor

__all__ = [
    "BEAM_TABLES",
    "BODY_R_SENSOR",
    "LASER_NS",
    "LENS_RADIUS_M",
    "SEQUENCE_NS",
    "BeamTable",
    "Clock",
    "Head",
    "Placed",
    "Rotor",
    "free_beams",
    "place",
    "with_angle_errors",
]
