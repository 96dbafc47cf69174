"""Factors of a unit's strengths, from the codes that its lasers send at one range."""

import math

import numpy as np

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.sensor.laws import law, span
from vlp16emu.types import F8

_MM_PER_M = 1000.0
_PER_CODE = 8
_MOST = round(_PER_CODE * law("strength.most_far"))
_TOP = 46  # codes below the calibration table of bright ones
_LEAST_RETURNS = 30  # within a class of range, and different codes among them
_LEAST_CODES = 6
_MOST_COUNTED = 4  # returns of one code
_COVERED = 0.97  # share of them that a factor's codes hold: a few returns have a neighbouring factor
_NEAREST_M = 4.5  # nearer factors say little about those beyond 8 m
_STEP = 0.02  # of the logarithm of range
_LEAST_LASERS = 3

_SENT = np.zeros((_MOST + 1, _TOP), bool)
for _eighths in range(_PER_CODE, _MOST + 1):
    _code = np.arange(_TOP) * _eighths // _PER_CODE
    _SENT[_eighths, _code[_code < _TOP]] = True


def far_factor(sequences: Sequences) -> float | None:
    """Return the median over lasers of the factor from strengths to codes beyond 8 m.

    At each range it is the greatest number of eighths whose codes are all that a laser sends; from 4.5 to 8 m
    it is extrapolated as units have it. None if fewer than three lasers have enough returns there.
    """
    _, coarse_m, far_m = span("strength.ranges_m")
    of_lasers = []
    for range_mm, code in zip(sequences.range_mm.T, sequences.reflectivity.T, strict=True):
        factors = [
            (eighths / _PER_CODE) ** (math.log(far_m / coarse_m) / math.log(min(at_m, far_m) / coarse_m))
            for at_m, eighths in _factors(range_mm, code)
        ]
        if factors:
            of_lasers.append(float(np.median(factors)))
    return float(np.median(of_lasers)) if len(of_lasers) >= _LEAST_LASERS else None


def _factors(range_mm: F8, code: F8) -> list[tuple[float, int]]:
    """Return ranges of a laser in metres, and the eighths of its factor there."""
    chosen = (range_mm >= _NEAREST_M * _MM_PER_M) & (code > 0) & (code < _TOP)
    place = (np.log(range_mm[chosen] / (_NEAREST_M * _MM_PER_M)) / _STEP).astype(np.int64)
    found = []
    for which in np.unique(place):
        codes = code[chosen][place == which]
        counts = np.minimum(np.bincount(codes, minlength=_TOP), _MOST_COUNTED)
        if len(codes) >= _LEAST_RETURNS and np.count_nonzero(counts) >= _LEAST_CODES:
            held = (_SENT * counts).sum(axis=1) >= _COVERED * counts.sum()
            eighths = int(np.nonzero(held)[0].max(initial=_PER_CODE))
            found.append((_NEAREST_M * math.exp(_STEP * (which + 0.5)), eighths))
    return found
