"""The pulses of a batch, and room for what they meet."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.beam import ROUND
from vlp16emu.types import F4, F8, I8, U4

LANES = ROUND
"""Rays of a row."""
ORIGIN, DIRECTION, RANGE, COSINE, ROW = (LANES * row for row in (0, 3, 6, 7, 8))
"""Offsets of rows of lanes in `Batch.row`, and its length."""


class PulseBatch(NamedTuple):
    """Pulses that are cast, and their width."""

    origin_m: F8
    """(k, L, 3), k a multiple of `PACKET`; `direction` and `beam_axis` alike, the latter empty for light without width."""
    direction: F8
    beam_axis: F8
    time: F4
    """(k, L) between the scene's first knot and its last, 0..1."""
    near_m: F8
    """(L,) range at which each laser's light begins."""
    reach_m: float
    """Range at which what is near ends; `far_m` where it does not."""
    far_m: float
    """Range at which the light is given up."""
    order: I8
    """(k / 8,) first sequence of each packet, in the order of casting."""
    sigmas: F4
    """(4,) as in `Footprint`; `seed` alike."""
    seed: int
    first: int
    """Number of the first firing sequence."""


class MetRays(NamedTuple):
    """Hits of rays: three arrays of one length."""

    range_m: F4
    surface: U4
    cos_incidence: F4


class Batch(NamedTuple):
    """Room for the pulses of eight sequences, those of a laser one after the other."""

    row: F4
    """(n, ROW) rays of a pulse, rows of eight: origins, directions, ranges, cosines; of a light without width only the first."""
    surface: U4
    """(n, 8)."""
    axes: F4
    """(n, 4, 3) of the pulses; the first two make up the middle."""
    axes_row: F4
    """(n, 12) the same numbers."""
    missed: NDArray[np.bool_]
    """(n,) which pulses go on: of some of their rays nothing near is met."""
    todo: I8
    """(n,) numbers of the pulses that are cast."""
    have: I8
    """(n,) how many sub-rays each has."""
    hits: MetRays
    """(n m,) of these, those of a pulse one after the other; m is a multiple of eight."""
    scratch: F8
    """(2, m) to sort in."""


def batch_of(pulses: int, most: int) -> Batch:
    """Make room for so many pulses of up to `most` sub-rays each."""
    most = -(-most // ROUND) * ROUND
    n = pulses * most
    axes_row = np.zeros((pulses, 12), np.float32)
    return Batch(
        np.zeros((pulses, ROW), np.float32),
        np.zeros((pulses, LANES), np.uint32),
        axes_row.reshape(pulses, 4, 3),
        axes_row,
        np.zeros(pulses, np.bool_),
        np.arange(pulses),
        np.zeros(pulses, np.int64),
        MetRays(np.empty(n, np.float32), np.empty(n, np.uint32), np.empty(n, np.float32)),
        np.empty((2, most)),
    )
