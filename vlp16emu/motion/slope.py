"""Lowering a curve until it is nowhere steeper than allowed."""

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["limit_slope"]


@numba.njit(cache=True, nogil=True)
def limit_slope(values: NDArray[np.float64], step: NDArray[np.float64]) -> None:
    """Lower values (n,) in place, as little as possible, until neighbours i and i + 1 differ by step[i] at most.

    Parameters
    ----------
    step : (n - 1,) not negative
    """
    for i in range(values.size - 1):
        values[i + 1] = min(values[i + 1], values[i] + step[i])
    for i in range(values.size - 2, -1, -1):
        values[i] = min(values[i], values[i + 1] + step[i])
