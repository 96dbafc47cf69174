"""The validator of VLP-16 traffic: whether a real sensor could have sent it."""

from vlp16emu.extras.verify.frames import Finding, Rule
from vlp16emu.extras.verify.run import Verification, verify, verify_units

__all__ = ["Finding", "Rule", "Verification", "verify", "verify_units"]
