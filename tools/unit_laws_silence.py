"""Records without a return: where they are, how walls fade before them, and what recurs.

For `tools/unit_laws`.
"""

import numpy as np
from unmask_rows import Capture
from unmask_windows import UPWARDS, Array, turn_later

RUNS = (1, 2, 4, 6, 11, 31, 101, 10**9)
"""Limits of classes of the length of a run without returns."""
SILENT, BEFORE, CALM = 15, 24, 12
"""Least records of a silence that ends a wall, records before it, and how many of the first of these are the
calm wall."""
WALL_LSB, WALL_CODE, DARK, FADED = 150, 25, 3, 0.16
"""Greatest span of the ranges of a calm wall, and its least code; a dark code; share of the code of the wall
below which a record is the tail of its fall: one sigma of a Gaussian."""
STEP_LSB, STEP_CODES, LEVEL = 75, 0.3, 6
"""Steps of range (0.15 m) and of code, as a share of a code that counts as 6 at least."""


def turns_of(one: Capture) -> float:
    """Return the number of revolutions of a capture."""
    azimuth = one.sequences.azimuth_cdeg
    return float(azimuth[-1] - azimuth[0]) / 36_000.0


def by_elevation(one: Capture) -> Array:
    """Return the share of records without a return of each laser (16,), from the lowest upwards."""
    return (one.d == 0).mean(axis=0)[UPWARDS]


def runs_per_turn(one: Capture) -> Array:
    """Return the number of runs without returns in a revolution, for each class of their length."""
    edge = np.diff(np.pad(one.d == 0, ((1, 1), (0, 0))).astype(int), axis=0).T
    length = np.nonzero(edge == -1)[1] - np.nonzero(edge == 1)[1]
    return np.histogram(length, RUNS)[0] / turns_of(one)


def falls_of(one: Capture) -> tuple[Array, Array]:
    """Return for each wall that ends in silence its last code, and how many of its records have faded."""
    found = []
    for d, r in ((one.d, one.r), (one.d[::-1], one.r[::-1])):
        for laser in range(d.shape[1]):
            found += _falls(d[:, laser].astype(int), r[:, laser].astype(float))
    last, faded = np.reshape(found, (-1, 2)).T
    return last, faded


def _falls(d: Array, r: Array) -> list[tuple[float, float]]:
    """Return last code and number of faded records of each wall of a laser before a silence."""
    out = []
    silent = d == 0
    for end in np.flatnonzero(np.diff(silent.astype(int)) == 1):
        begin = end - BEFORE
        if begin < 0 or end + SILENT >= len(d) or not silent[end + 1 : end + SILENT + 1].all():
            continue
        wall = slice(begin, begin + CALM)
        level = np.median(r[wall])
        if silent[wall].any() or np.ptp(d[wall]) > WALL_LSB or level < WALL_CODE:
            continue
        after = slice(begin + CALM + 1, end + 1)
        faded = (r[after] <= FADED * level) & ~silent[after]
        out.append((r[end], float(faded.sum())))
    return out


def lost_later(one: Capture) -> dict[str, Array]:
    """Return for records that have a return if they have none a turn later, by what is beside them."""
    later = turn_later(one.sequences)
    at = np.arange(3, len(one.d) - 3)
    at = at[(later[at] < len(one.d)) & (later[at] > at)]
    d, r = one.d[at].astype(int), one.r[at].astype(int)
    sides = [(one.d[at + i].astype(int), one.r[at + i].astype(int)) for i in (-1, 1)]
    silent = np.any([own_d == 0 for own_d, _ in sides], axis=0)
    step = np.any([np.abs(own_d - d) > STEP_LSB for own_d, _ in sides], axis=0)
    change = np.any([np.abs(own_r - r) > STEP_CODES * np.maximum(r, LEVEL) for _, own_r in sides], axis=0)
    lost, shown = one.d[later[at]] == 0, d > 0
    places = {
        "calm": shown & ~silent & ~step & ~change,
        "beside a step of range": shown & ~silent & step,
        "of code": shown & ~silent & ~step & change,
        "beside silence": shown & silent,
        "all": shown,
    }
    return {name: lost[where] for name, where in places.items()}
