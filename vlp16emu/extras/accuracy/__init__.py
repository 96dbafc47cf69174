"""How exact a run is, and what it costs."""

from vlp16emu.extras.accuracy.audit import Audit

__all__ = ["Audit"]
