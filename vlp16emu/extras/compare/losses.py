"""Records without a return: where real units lose one, and what code it carries."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences

_FLAT_LSB, _EQUAL_LSB, _STEPS_LSB = 20, 15, (150, 700)
"""Most change of range on either side of a record, and across it, to be of one surface; least steps that are near and far."""
_CODE_STEP = 20
_LEAST, _LEAST_EDGES = 500, 15
_RAISED = 1.5
"""Code of a no-return over the commonest of its laser, from which on it is raised."""
_DARK, _BRIGHT = (0, 5), (40, 100)
"""Codes of returns beside which raised no-returns are counted."""

Statistics = dict[str, float]
Mask = NDArray[np.bool_]


def lost_records(sequences: Sequences) -> Statistics:
    """Share of records without a return between two pairs of returns of one laser, by what changes across it.

    Two equal ranges; steps of 0.3 to 1.4 m, and of more; 20 codes of reflectivity and more on one surface.
    """
    d, r = sequences.distance_lsb, sequences.reflectivity
    before, a, middle, c, after = (d[i : len(d) - 4 + i] for i in range(5))
    in_row = (sequences.number[4:] - sequences.number[:-4] == 4)[:, None]
    is_edge = in_row & (np.minimum(np.minimum(before, a), np.minimum(c, after)) > 0)
    is_edge &= (np.abs(a - before) < _FLAT_LSB) & (np.abs(c - after) < _FLAT_LSB)
    step_lsb, (near, far) = np.abs(c - a), _STEPS_LSB
    same = is_edge & (step_lsb < _EQUAL_LSB)
    places = {
        "lost.on_a_surface": same,
        "lost.at_steps_below_1.4_m": is_edge & (step_lsb >= near) & (step_lsb < far),
        "lost.at_steps_above_1.4_m": is_edge & (step_lsb >= far),
        "lost.at_code_steps": same & (np.abs(r[3:-1] - r[1:-3]) >= _CODE_STEP),
    }
    return {name: float((middle[at] == 0).mean()) for name, at in places.items() if at.sum() >= _LEAST_EDGES}


def no_returns(sequences: Sequences) -> Statistics:
    """Codes of records without a return: what they carry, and where they are raised above that of their laser."""
    silent, r = sequences.distance_lsb == 0, sequences.reflectivity
    both = silent[1:] & silent[:-1]
    if both.sum() < _LEAST:
        return {}
    out = {
        "no_return.above_0": (r[silent] > 0).mean(),
        "no_return.above_100": (r[silent] > 100).mean(),
        "no_return.equal": (r[1:] == r[:-1])[both].mean(),
        "no_return.mean": r[silent].mean(),
    }
    return out | _raised(silent, r)


def commonest(silent: Mask, r: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the commonest code (16,) of each laser's records without a return, 0 where there are too few."""
    each = [column[of] for column, of in zip(r.T, silent.T, strict=True)]
    return np.array([np.bincount(own).argmax() if len(own) >= _LEAST_EDGES else 0 for own in each])


def _raised(silent: Mask, r: NDArray[np.int64]) -> Statistics:
    """Share of raised codes beside bright returns less that beside dark ones, and of raised runs that are one record long."""
    mode = commonest(silent, r)
    raised = silent & (r > _RAISED * mode) & (mode > 0)
    neighbour = np.maximum(*(np.where(silent[side], -1, r[side]) for side in (slice(None, -2), slice(2, None))))
    shares = []
    for low, high in (_DARK, _BRIGHT):
        at = silent[1:-1] & (neighbour >= low) & (neighbour < high) & (mode > 0)
        shares.append(raised[1:-1][at].mean() if at.sum() >= _LEAST_EDGES else np.nan)
    begins = ~silent[:-2] & raised[1:-1]
    return {
        "no_return.raised_beside_bright": shares[1] - shares[0],
        "no_return.raised_once": (~raised[2:])[begins].mean() if begins.sum() >= _LEAST_EDGES else np.nan,
    }


def dual_returns(sequences: Sequences) -> Statistics:
    """Share of pairs with one return where the other block has none, and of unequal codes in pairs without a return."""
    if sequences.last is None:
        return {}
    (d_last, r_last), d, r = sequences.last, sequences.distance_lsb, sequences.reflectivity
    none = (d == 0) & (d_last == 0)
    unequal = (r != r_last)[none].mean() if none.any() else np.nan
    return {"dual.one_without": ((d == 0) ^ (d_last == 0)).mean(), "dual.unequal_no_returns": unequal}
