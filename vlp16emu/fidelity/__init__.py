"""A run held against the converged answer of the same scene: a sample of it, or a few pulses beside the run."""

from vlp16emu.fidelity.accuracy import measure_accuracy
from vlp16emu.fidelity.audit import Audit

__all__ = ["Audit", "measure_accuracy"]
