"""Factors from strengths to codes, and the gains of lasers that follow them, for `tools/unit_laws`."""

import numpy as np
from unmask_rows import LEAST_OF_RINGS, M_LSB, Capture, ring_ratios
from unmask_windows import UPWARDS, Array

EIGHTHS, TOP_CODE = (8, 32), 46
"""Least and greatest factor in eighths of a code, and codes below the calibration table of bright ones."""
NEAREST_LSB, STEP, STEPS = 250, 0.02, 12.5
"""Least range; logarithm of range within which a factor is one; and those of a class, of 0.25 e-folds."""
LEAST_RETURNS, LEAST_CODES, MOST_COUNTED, COVERED = 30, 6, 4, 0.97
"""Least returns and codes of a factor, most returns of a code that count, and share that its codes hold."""
LEAST_CLASSES = 6
FACTORS = np.arange(EIGHTHS[0], EIGHTHS[1] + 1)
SENT = np.array([np.isin(np.arange(TOP_CODE), np.arange(1, TOP_CODE) * of // 8) for of in FACTORS])
"""Codes that each factor sends."""


def factor_of(codes: Array) -> float:
    """Return the greatest factor in eighths whose codes are those (n,) of a laser at one range, or NaN."""
    counts = np.minimum(np.bincount(codes, minlength=TOP_CODE), MOST_COUNTED)
    if len(codes) < LEAST_RETURNS or np.count_nonzero(counts) < LEAST_CODES:
        return np.nan
    return float(FACTORS[(SENT * counts).sum(axis=1) >= COVERED * counts.sum()].max(initial=EIGHTHS[0]))


def factors(one: Capture) -> dict[tuple[int, int], float]:
    """Return the middle factor by laser, upwards, and class of range."""
    found: dict[tuple[int, int], list[float]] = {}
    for ring, laser in enumerate(UPWARDS):
        d, r = one.d[:, laser], one.r[:, laser]
        chosen = (d >= NEAREST_LSB) & (r > 0) & (r < TOP_CODE)
        place = np.floor(np.log(d[chosen] / M_LSB) / STEP).astype(int)
        for which in np.unique(place):
            factor = factor_of(r[chosen][place == which])
            if np.isfinite(factor):
                found.setdefault((ring, int(np.floor(which / STEPS))), []).append(factor)
    return {key: float(np.median(of)) for key, of in found.items()}


def gain_by_factor(one: Capture) -> tuple[int, float, float]:
    """Return how the ratio of codes of neighbouring rings on one plane follows that of their factors.

    These are the number of classes of rings and ranges, and slope and correlation of the logarithms.
    """
    same, range_lsb, ratio = ring_ratios(one)
    place = np.floor(np.log(range_lsb.clip(1) / M_LSB) / STEP / STEPS).astype(int)
    of_rings = factors(one)
    pairs = []
    for ring in range(ratio.shape[1]):
        for which in np.unique(place[same[:, ring], ring]).tolist():
            chosen = same[:, ring] & (place[:, ring] == which)
            both = of_rings.get((ring, which)), of_rings.get((ring + 1, which))
            if chosen.sum() >= LEAST_OF_RINGS and None not in both:
                pairs.append((np.log(both[0] / both[1]), np.median(ratio[chosen, ring])))
    if len(pairs) < LEAST_CLASSES:
        return len(pairs), np.nan, np.nan
    of_factor, of_code = np.array(pairs).T
    slope = float(np.polyfit(of_factor, of_code, 1)[0])
    return len(pairs), slope, float(np.corrcoef(of_factor, of_code)[0, 1])
