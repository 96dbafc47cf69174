"""What can be said about a run or a capture afterwards."""

from vlp16emu.report.verify import Finding, Rule, Verification, verify_capture

__all__ = ["Finding", "Rule", "Verification", "verify_capture"]
