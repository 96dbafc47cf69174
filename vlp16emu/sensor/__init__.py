"""What a VLP-16 is: beams, firing times, rotor and clock."""

from vlp16emu.sensor.beams import BEAM_TABLES, LENS_RADIUS_M, BeamTable
from vlp16emu.sensor.clock import Clock
from vlp16emu.sensor.head import BODY_R_SENSOR, LASER_NS, SEQUENCE_NS, Head
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
    "Rotor",
]
