"""Lasers that change the parity of their ranges, and odd ranges of all of them, for `tools/unit_laws`."""

import numpy as np
from unmask_rows import Capture
from unmask_windows import Array

PARITY_CODES, NEIGHBOURS, ROUNDS = (40, 100), 9, 12
"""Codes whose signs are taken; sequences over which these are summed; and rounds of the fit."""
LEAST_WEIGHT, CERTAIN, LEAST_OF_CODE, GAP = 0.5, 0.5, 5, 8
"""Least sum of squared mean signs, least mean sign, least ranges of a code, most sequences of a change."""
ROUND, SLOTS = 16, 5
"""Firing sequences after which a laser may change its parity; slots of the beat of ranges."""
LEAST_CHANGES, SHARP = 12, 4.6
"""Least changes of a laser; and a hundredth of chance that changes keep to a sequence of the round:
-ln(0.01) for the number of changes times the squared mean of their unit vectors."""
LEAST_ROUNDS = 20
LEAST_SIGNS, LEAST_LASERS = 20, 6


def states(one: Capture, laser: int) -> Array:
    """Return the parity (n,) of a laser against that which its codes mostly have: 1, -1, or 0 if unknown.

    Mean sign of each code and state of each sequence are found in turns.
    """
    d, r = one.d[:, laser], one.r[:, laser]
    on = (d > 0) & (r >= PARITY_CODES[0]) & (r < PARITY_CODES[1])
    sign = np.where(on, 1.0 - 2.0 * (d % 2), 0.0)
    state = np.ones(len(d))
    count = np.bincount(r[on], minlength=256)
    around = np.ones(NEIGHBOURS)
    for _ in range(ROUNDS):
        mean = np.bincount(r[on], (sign * state)[on], minlength=256) / count.clip(1)
        of_code = np.where(on & (count > LEAST_OF_CODE)[r], mean[r], 0.0)
        weight = np.convolve(of_code**2, around, "same")
        state = np.convolve(sign * of_code, around, "same") / weight.clip(LEAST_WEIGHT)
        state = np.where(weight > LEAST_WEIGHT, state.clip(-1.0, 1.0), 0.0)
    return np.where(np.abs(state) > CERTAIN, np.sign(state), 0.0)


def changes(state: Array) -> Array:
    """Return the sequences at which a state changes, between known ones that are near each other."""
    known = np.nonzero(state)[0]
    before, after = known[:-1], known[1:]
    at = (state[before] != state[after]) & (after - before < GAP)
    return (before[at] + after[at] + 1) // 2


def place_in_round(one: Capture, laser: int) -> tuple[int, float, float]:
    """Return the number of changes of a laser, their mean place in a round, and by how much they keep to it.

    The last is the number times the squared mean of their unit vectors, which is 1 by chance.
    """
    at = one.sequences.number[changes(states(one, laser))]
    if len(at) < LEAST_CHANGES:
        return len(at), np.nan, np.nan
    mean = np.exp(2j * np.pi * at / ROUND).mean()
    return len(at), float(np.angle(mean) * ROUND / (2.0 * np.pi) % ROUND), float(len(at) * abs(mean) ** 2)


def by_slot(one: Capture, laser: int, place: float) -> tuple[Array, int]:
    """Return the share of changed parity by slot of the beat at the beginning of a round (5,).

    The number of rounds of the laser, which begin at `place`, comes with it.
    """
    state, number = states(one, laser), one.sequences.number
    since = (number - round(place)) % ROUND
    known = (state != 0) & (since >= ROUND // 4) & (since <= 3 * ROUND // 4)
    begin = (number - since)[known]
    rounds, of_round = np.unique(begin, return_inverse=True)
    changed = np.bincount(of_round, state[known] < 0) / np.bincount(of_round)
    slot = (24 * rounds + laser) % SLOTS
    count = np.bincount(slot, minlength=SLOTS)
    return np.bincount(slot, changed, minlength=SLOTS) / np.where(count > 0, count, np.nan), len(rounds)


def odd(one: Capture) -> tuple[float, float, float, float]:
    """Return the share of odd ranges of all lasers, and its deviation from one half by chance.

    Chance has lasers with signs at random. The squared sum of lasers over chance, and that of the lasers at
    one code, come with it.
    """
    on = one.d > 0
    sign = np.where(on, 1.0 - 2.0 * (one.d % 2), 0.0)
    of_lasers = sign.sum(axis=0)
    chance = float(np.sqrt((of_lasers**2).sum()) / on.sum() / 2.0)
    ratios = []
    for code in range(101):
        at = on & (one.r == code)
        enough = at.sum(axis=0) >= LEAST_SIGNS
        sums = np.where(at, sign, 0.0).sum(axis=0)[enough]
        if enough.sum() >= LEAST_LASERS and sums.any():
            ratios.append(sums.sum() ** 2 / (sums**2).sum())
    at_code = float(np.mean(ratios)) if ratios else np.nan
    return (
        float((sign < 0).sum() / on.sum()),
        chance,
        float(of_lasers.sum() ** 2 / (of_lasers**2).sum()),
        at_code,
    )
