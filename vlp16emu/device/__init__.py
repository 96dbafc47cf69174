"""What is wired to the sensor and set on it."""

from vlp16emu.device.gps import GpsInput

__all__ = ["GpsInput"]
