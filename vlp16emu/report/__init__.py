"""What can be said about a run beforehand, and about a run or a capture afterwards."""

from vlp16emu.report.plan.forecast import Forecast, Spent, forecast

__all__ = ["Forecast", "Spent", "forecast"]
