"""Range noise by code and by scatter, steps of range, and ranges of faint echoes, for `tools/unit_laws`."""

from itertools import pairwise

import numpy as np
from unmask_rows import SURFACE_LSB, Capture, in_stretches, smooth_stretches
from unmask_windows import Array, turn_later

from vlp16emu.extras.compare.statistics import stretches_of

LEAST = 15
EVEN_CODES = 2, 4, 8, 15, 30, 45, 60, 80, 100, 101
TURN_CODES = 1, 2, 3, 4, 5, 8, 12, 20, 45, 100
TURN_LSB, MM_PER_LSB = 30, 2.0
"""Greatest change of range between neighbours of a smooth surface, and from turn to turn; size of a code."""
LEVELS = (10, 20), (20, 40), (40, 90)
SCATTERS = 0, 0.03, 0.06, 0.1, 0.2, 9
STEP_CODES, STEP_LSB = (31, 60), (11, 16)
"""Codes and lengths of the steps of range by which trees find emulated rooms: 22 to 30 mm."""
FLAT_LSB, STEEP_LSB = 3, 8
"""Mean change of range from pulse to pulse below which a surface is flat, and above which it is steep."""
PERIODS_LSB = 70, 80, 90, 95, 99.93, 105, 110, 120
SAMPLE_LSB = 99.93
"""Periods of samples that are tried; that of 750 MHz, 199.86 mm there and back, in codes of 2 mm."""
FAINT_CODE, LEAST_RUN, LEAST_RUNS, NEAR_SAMPLE_LSB = 7, 3, 3, 1.6
"""Greatest code of faint echoes; least equal ranges of a run, and runs of a laser; and distance within which
a range is that of a sample."""
SILENCE_RECORDS = 1, 3, 8
FAINTEST_CODE = 1


def even_by_code(one: Capture) -> list[Array]:
    """Return for classes of code whether neighbours of that code differ by an even number of 2 mm."""
    apart, code = np.abs(np.diff(one.d, axis=0)), one.r[1:]
    on = (one.d[1:] > 0) & (one.d[:-1] > 0) & (apart < SURFACE_LSB) & (one.r[:-1] == code)
    return [apart[on & (code >= low) & (code < high)] % 2 == 0 for low, high in pairwise(EVEN_CODES)]


def turn_noise_mm(one: Capture) -> Array:
    """Return the noise of ranges by class of code, from one turn to the next, with the beat."""
    later = turn_later(one.sequences)
    first = np.nonzero((later < len(one.d) - 1) & (np.arange(len(one.d)) > 0))[0]
    first = first[first < len(one.d) - 1]
    smooth = one.d > 0
    for side in (-1, 1):
        beside = np.roll(one.d, side, axis=0)
        smooth &= (beside > 0) & (np.abs(beside - one.d) < TURN_LSB)
    a, b = one.d[first], one.d[later[first]]
    on = smooth[first] & smooth[later[first]] & (np.abs(b - a) < TURN_LSB)
    code = one.r[first]
    found = []
    for low, high in pairwise(TURN_CODES):
        change = (b - a)[on & (code >= low) & (code < high)]
        spread = np.sqrt((change**2.0).mean() / 2.0) if len(change) >= LEAST else np.nan
        found.append(MM_PER_LSB * float(spread))
    return np.array(found)


def scatter_noise_mm(one: Capture) -> list[Array]:
    """Return for each class of level the noise of ranges by class of scatter of codes over their level."""
    stretches = stretches_of(one.sequences)
    if stretches is None:
        return []
    level = stretches.level
    scatter = np.sqrt((stretches.code_residual**2).mean(axis=1)) / level.clip(1)
    noise_mm = np.sqrt((stretches.white_mm**2).mean(axis=1))
    out = []
    for low, high in LEVELS:
        at = [(level >= low) & (level < high) & (scatter >= a) & (scatter < b) for a, b in pairwise(SCATTERS)]
        out.append(np.array([np.median(noise_mm[of]) if of.sum() >= LEAST else np.nan for of in at]))
    return out


def steps(one: Capture) -> list[Array]:
    """Return whether neighbours differ by 22 to 30 mm: all of them, those of smooth stretches, of flat ones.

    Whether the smooth stretches are steep comes last.
    """
    low, high = STEP_CODES
    step = np.abs(np.diff(one.d, axis=0))
    on = (one.d[1:] > 0) & (one.d[:-1] > 0) & (one.r[:-1] >= low) & (one.r[:-1] <= high)
    d, r = in_stretches(one)
    within = np.abs(np.diff(d, axis=1))
    slope = np.broadcast_to((np.abs(d[:, -1] - d[:, 0]) / (d.shape[1] - 1))[:, None], within.shape)
    smooth = smooth_stretches(d)[:, None] & (r[:, :-1] >= low) & (r[:, :-1] <= high)
    flat = smooth & (slope < FLAT_LSB)
    found = [step[on], within[smooth], within[flat]]
    return [*[(of >= STEP_LSB[0]) & (of < STEP_LSB[1]) for of in found], slope[smooth] > STEEP_LSB]


def runs_of_equal(one: Capture) -> list[Array]:
    """Return for each laser the ranges at which it has runs of equal ranges of faint echoes."""
    equal = (one.d[1:] == one.d[:-1]) & (one.d[1:] > 0) & (np.maximum(one.r[1:], one.r[:-1]) <= FAINT_CODE)
    edge = np.diff(np.pad(equal, ((1, 1), (0, 0))).astype(int), axis=0)
    found = []
    for laser in range(equal.shape[1]):
        start, stop = np.nonzero(edge[:, laser] == 1)[0], np.nonzero(edge[:, laser] == -1)[0]
        found.append(one.d[start[stop - start + 1 >= LEAST_RUN], laser])
    return [ranges if len(ranges) >= LEAST_RUNS else ranges[:0] for ranges in found]


def off_sample(range_lsb: Array, place_lsb: float, period_lsb: float) -> Array:
    """Return the distances of ranges from the nearest sample of a laser."""
    half = period_lsb / 2.0
    return np.abs((range_lsb - place_lsb + half) % period_lsb - half)


def place_of(range_lsb: Array, period_lsb: float) -> float:
    """Return the place of samples, within their period, that most ranges (n,) have."""
    places = np.arange(0.0, period_lsb, 0.5)
    off = off_sample(range_lsb[:, None], places, period_lsb)
    return float(places[(off <= NEAR_SAMPLE_LSB).sum(axis=0).argmax()])


def on_samples(one: Capture) -> list[Array]:
    """Return for each period whether runs are at the places of samples that most runs of their laser have."""
    runs = [ranges for ranges in runs_of_equal(one) if len(ranges)]
    found = []
    for period in PERIODS_LSB:
        on = [off_sample(of, place_of(of, period), period) <= NEAR_SAMPLE_LSB for of in runs]
        found.append(np.concatenate([np.zeros(0, bool), *on]))
    return found


def samples_near_silence(one: Capture) -> list[Array]:
    """Return whether the faintest echoes are at samples of their laser, by distance from silence."""
    found: list[list[Array]] = [[] for _ in range(len(SILENCE_RECORDS) + 1)]
    for laser, runs in enumerate(runs_of_equal(one)):
        if not len(runs):
            continue
        d, silent = one.d[:, laser], one.d[:, laser] == 0
        far = np.zeros(len(d), int)
        for records in SILENCE_RECORDS:
            near = np.convolve(silent, np.ones(2 * records + 1), "same") > 0
            far += ~near
        faint = (d > 0) & (one.r[:, laser] <= FAINTEST_CODE)
        on = off_sample(d, place_of(runs, SAMPLE_LSB), SAMPLE_LSB) <= NEAR_SAMPLE_LSB
        for which, of in enumerate(found):
            of.append(on[faint & (far == which)])
    return [np.concatenate([np.zeros(0, bool), *of]) for of in found]
