"""Statistics of captures that distinguish one unit from another, and the settings that they imply."""

from vlp16emu.extras.compare.fit import fitted
from vlp16emu.extras.compare.histograms import Histogram, histograms_of
from vlp16emu.extras.compare.sequences import Sequences, read_sequences
from vlp16emu.extras.compare.statistics import statistics_of
from vlp16emu.extras.compare.table import Compared, compared

__all__ = [
    "Compared",
    "Histogram",
    "Sequences",
    "compared",
    "fitted",
    "histograms_of",
    "read_sequences",
    "statistics_of",
]
