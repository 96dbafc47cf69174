"""A run held against the converged answer of the same scene: a few pulses beside the run, or (`accuracy`) a sample."""

from vlp16emu.accuracy.audit import Audit, AuditFinding

__all__ = ["Audit", "AuditFinding"]
