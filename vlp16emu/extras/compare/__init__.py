"""Statistics of captures that distinguish one unit from another, and the settings that they imply."""

from vlp16emu.extras.compare.fit import fit_settings
from vlp16emu.extras.compare.histograms import Histogram, histograms_of
from vlp16emu.extras.compare.sequences import Sequences, read_sequences
from vlp16emu.extras.compare.statistics import statistics_of
from vlp16emu.extras.compare.table import Compared, compare_statistics

__all__ = [
    "Compared",
    "Histogram",
    "Sequences",
    "compare_statistics",
    "fit_settings",
    "histograms_of",
    "read_sequences",
    "statistics_of",
]
