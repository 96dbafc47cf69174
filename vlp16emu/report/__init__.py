"""What can be said about a run beforehand, and about a run or a capture afterwards."""

from vlp16emu.report.forecast import Forecast, Spent, forecast
from vlp16emu.report.verify import Finding, Rule, Verification, verify_capture

__all__ = ["Finding", "Forecast", "Rule", "Spent", "Verification", "forecast", "verify_capture"]
