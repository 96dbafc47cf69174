"""What the inner loop is told: against what to cast, what light, and by how many rays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Light", "Target", "Wish"]


class Target(NamedTuple):
    """What is cast against."""

    scene: int
    """Address of a committed RTCScene of instances."""
    window_origin_m: NDArray[np.float64]
    """(3,) taken from the origins in float64, before the step to float32."""
    first_surface: NDArray[np.uint32]
    """(n,) per instance, as in `Window`."""
    normal_matrix: NDArray[np.float32]
    """(n, 3, 3) per instance, as in `placement`."""
    shear: NDArray[np.float32]
    """(knots, n, 2) per instance, as in `embree_sway.Motion`."""
    reflectance: NDArray[np.float32]
    """(m,) of the surfaces."""


class Light(NamedTuple):
    """What is cast: the pulses of a batch, and how wide they are."""

    origin_m: NDArray[np.float64]
    """(k, L, 3), k a multiple of `PACKET`; `direction` and `across` alike."""
    direction: NDArray[np.float64]
    across: NDArray[np.float64]
    time: NDArray[np.float32]
    """(k, L) between the scene's first knot and its last, 0..1."""
    near_m: NDArray[np.float64]
    """(L,) where each laser's light begins."""
    far_m: float
    """Where it is given up."""
    judged_m: float
    """Up to where the rays along the middles were cast; it may lie beyond `far_m`."""
    quarters: NDArray[np.float64]
    """(4,) as in `Footprint`; `seed` alike."""
    seed: int
    first: int
    """Number of the first firing sequence."""
    order: NDArray[np.int64]
    """(k / 8,) first sequence of each packet, in the order of casting."""


class Wish(NamedTuple):
    """How many sub-rays are wanted."""

    first: NDArray[np.uint16]
    """(k, L) after the first round."""
    by_rounds: bool
    """Whether the rays along the middles are the pulses' first, and further rounds may come."""
    most: int
    """Sub-rays with which a pulse must do; after fewer, `adaptive.enough` is asked with the next two."""
    target_m: float
    resolution_m: float
