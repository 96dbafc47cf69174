"""Cosine and sine without a library: additions and products, which round alike everywhere and run four at once.

And a triangular wave, and a zero for kernels that is no literal.
"""

import math
from typing import Any, cast

import numba
import numba.extending
import numpy as np

__all__ = ["ZERO", "around_zero", "cos_sin", "fold", "in_quarter"]

ZERO = cast("int", np.int64(0))
"""What is called with the literal 0 is compiled once more for that type."""

_HALF_PI = 1.57079632673412561417, 6.07710050650619224932e-11
"""Its first 33 bits, so that products with whole numbers below 2**20 are exact, and the rest."""


@numba.extending.register_jitable(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def around_zero(y: Any) -> tuple[Any, Any]:
    """Cosine and sine of angles up to pi / 4, numbers or arrays: fdlibm, k_cos.c and k_sin.c."""
    z = y * y
    high = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    high = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * high)
    s = y + y * z * (-1.66666666666666324348e-01 + z * high)
    high = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)
    high = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * high)
    return 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * high), s


@numba.njit(cache=True, nogil=True, inline="always")
def in_quarter(quarter: float, y: float) -> tuple[float, float]:
    """Cosine and sine of so many right angles, 0 .. 4, and y, up to pi / 4."""
    c, s = around_zero(y)
    odd = (quarter == 1.0) | (quarter == 3.0)
    cosine, sine = s if odd else c, c if odd else s
    cosine = -cosine if (quarter == 1.0) | (quarter == 2.0) else cosine
    return cosine, -sine if (quarter == 2.0) | (quarter == 3.0) else sine


@numba.njit(cache=True, nogil=True, forceinline=True, _nrt=False)
def cos_sin(angle_rad: float) -> tuple[float, float]:
    """Cosine and sine of an angle, within 2e-16, beyond a million radians within its last bit; for use in kernels."""
    quarters = math.floor(angle_rad * (2.0 / math.pi) + 0.5)
    y = (angle_rad - quarters * _HALF_PI[0]) - quarters * _HALF_PI[1]
    return in_quarter(quarters - 4.0 * math.floor(0.25 * quarters), y)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)
def fold(x: float) -> float:
    """Go to and fro between 0 and 1, with a period of 1."""
    return 2.0 * abs(x - math.floor(x) - 0.5)
