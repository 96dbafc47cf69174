"""What the detector makes of the light that comes back."""

from vlp16emu.returns.detect import detect

__all__ = ["detect"]
