"""Statistics of captures that distinguish one unit from another, and the settings they imply."""

from vlp16emu.extras.compare.fit import fitted
from vlp16emu.extras.compare.sequences import Sequences, read_sequences
from vlp16emu.extras.compare.statistics import statistics_of
from vlp16emu.extras.compare.table import REAL, Compared, Known, compared

__all__ = ["REAL", "Compared", "Known", "Sequences", "compared", "fitted", "read_sequences", "statistics_of"]
