"""Detector: echoes, their range and reflectivity, noise and weather."""

from vlp16emu.returns.settings import Detector, Noise, Weather

__all__ = ["Detector", "Noise", "Weather"]
