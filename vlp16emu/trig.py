"""Cosine and sine from additions and products, which round equally on all processors and vectorize.

The module also has a triangular wave, and a non-literal zero for kernels. Without `fastmath=False` numba
would compile the functions with the options of the first kernel that calls them.
"""

import math
from typing import cast

import numpy as np

from vlp16emu.elementary import around_zero
from vlp16emu.kernels.compiler import inline_kernel

ZERO = cast("int", np.int64(0))  # not a literal: numba compiles a function again for the literal 0

_HALF_PI = 1.57079632673412561417, 6.07710050650619224932e-11
"""pi / 2: its first 33 bits, so that products with whole numbers below 2**20 are exact, and the rest."""


@inline_kernel
def in_quarter(quarter: float, y: float) -> tuple[float, float]:
    """Return cosine and sine of `quarter` right angles, 0 .. 4, plus y, up to pi / 4."""
    c, s = around_zero(y)
    odd = (quarter == 1.0) | (quarter == 3.0)
    cosine, sine = s if odd else c, c if odd else s
    cosine = -cosine if (quarter == 1.0) | (quarter == 2.0) else cosine
    return cosine, -sine if (quarter == 2.0) | (quarter == 3.0) else sine


@inline_kernel
def cos_sin(angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine of an angle, within 2e-16.

    Beyond a million radians, the error is within the angle's last bit. For kernels.
    """
    quarters = math.floor(angle_rad * (2.0 / math.pi) + 0.5)
    y = (angle_rad - quarters * _HALF_PI[0]) - quarters * _HALF_PI[1]
    return in_quarter(quarters - 4.0 * math.floor(0.25 * quarters), y)


@inline_kernel
def fold(x: float) -> float:
    """Return a triangular wave between 0 and 1 with a period of 1."""
    return 2.0 * abs(x - np.floor(x) - 0.5)
