"""The lint for VLP-16 traffic: whether a real sensor could have sent it."""

from vlp16emu.report.verify.rules import Finding, Rule
from vlp16emu.report.verify.run import Verification, verify, verify_capture

__all__ = ["Finding", "Rule", "Verification", "verify", "verify_capture"]
