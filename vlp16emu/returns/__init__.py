"""What the detector makes of the light that comes back."""

from vlp16emu.returns.detect import detect
from vlp16emu.returns.detector import Detector, make_law, threshold_of
from vlp16emu.returns.noise import Noise

__all__ = ["Detector", "Noise", "detect", "make_law", "threshold_of"]
