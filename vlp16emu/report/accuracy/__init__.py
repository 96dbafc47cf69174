"""How wrong a run is: errors held against an answer, how sure they are, and what they cost."""

from vlp16emu.report.accuracy.distributions import (
    HEIGHTS,
    RETURNS,
    Distributions,
    Statistic,
    Test,
    distributions_of,
)
from vlp16emu.report.accuracy.echoes import FINE_M, Counts, Echoes, counted
from vlp16emu.report.accuracy.errors import Comparison, Errors, Told, compare, errors_of
from vlp16emu.report.accuracy.picture import draw_accuracy
from vlp16emu.report.accuracy.rows import (
    Accuracy,
    Choice,
    Fit,
    Kind,
    Rounding,
    Row,
    choices,
    fitted_order,
    front,
)
from vlp16emu.report.accuracy.tally import FEWEST_CLUSTERS, Interval, Tally

__all__ = [
    "FEWEST_CLUSTERS",
    "FINE_M",
    "HEIGHTS",
    "RETURNS",
    "Accuracy",
    "Choice",
    "Comparison",
    "Counts",
    "Distributions",
    "Echoes",
    "Errors",
    "Fit",
    "Interval",
    "Kind",
    "Rounding",
    "Row",
    "Statistic",
    "Tally",
    "Test",
    "Told",
    "choices",
    "compare",
    "counted",
    "distributions_of",
    "draw_accuracy",
    "errors_of",
    "fitted_order",
    "front",
]
