"""Elementary functions: exact to some ulp, at the edges too, and the same bits from arrays, numbers and
kernels."""

import math
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from vlp16emu import elementary

Floats = NDArray[np.float64]

ULPS = {
    "sin": 1.6,
    "cos": 1.6,
    "tan": 3.5,
    "asin": 2.5,
    "acos": 2.5,
    "exp": 1.0,
    "expm1": 3.0,
    "log": 1.0,
    "log1p": 2.5,
    "tanh": 4.5,
    "atan2": 1.5,
    "hypot": 1.0,
    "power": 1.0,
}
"""Largest errors in units in the last place; of a power over 1 + 2 |exponent log(base)|."""
BINARY = ("atan2", "hypot", "power")


@pytest.mark.parametrize("name", ULPS)
def test_within_ulps_of_the_library(tool_named: Any, name: str) -> None:
    """Values are within the stated ulps, and the library's half, of those of the C library, of both signs
    and all sizes."""
    off, where = tool_named("elementary").worst(name, 12_000, math)
    assert off <= ULPS[name] + 1.0, where


@pytest.mark.parametrize("function", [elementary.sin, elementary.cos])
def test_multiples_of_pi(function: Any) -> None:
    """Near multiples of pi, where all leading bits cancel, sine and cosine keep their relative exactness."""
    n = np.concatenate([np.arange(-2000.0, 2000.0), 2.0 ** np.arange(10, 27)])
    for offset in (0.0, 0.5 * math.pi, 0.25 * math.pi):
        x = n * math.pi + offset
        true = np.array([getattr(math, function.__name__)(a) for a in x.tolist()])
        assert (np.abs(function(x) - true) <= 2.5 * np.abs(np.spacing(true))).all()


_INF, _NAN = math.inf, math.nan
# fmt: off
_EDGES: dict[str, list[tuple[tuple[float, ...], float]]] = {
    "sin": [((0.0,), 0.0), ((-0.0,), -0.0), ((5e-324,), 5e-324), ((_INF,), _NAN), ((1.1e12,), _NAN)],
    "cos": [((-0.0,), 1.0), ((-_INF,), _NAN)],
    "tan": [((-0.0,), -0.0), ((_NAN,), _NAN)],
    "asin": [((1.0,), math.pi / 2), ((-0.0,), -0.0), ((1.0000000000000002,), _NAN)],
    "acos": [((1.0,), 0.0), ((-1.0,), math.pi)],
    "exp": [((0.0,), 1.0), ((-0.0,), 1.0), ((709.782712893384,), 1.7976931348622732e308),
        ((709.782712893385,), _INF), ((-745.1332191019411,), 5e-324), ((-746.0,), 0.0), ((-_INF,), 0.0),
        ((_INF,), _INF), ((_NAN,), _NAN)],
    "expm1": [((-0.0,), -0.0), ((1e-300,), 1e-300), ((-_INF,), -1.0), ((_INF,), _INF)],
    "log": [((1.0,), 0.0), ((0.0,), -_INF), ((-0.0,), -_INF), ((-1.0,), _NAN),
        ((5e-324,), -744.4400719213812), ((_INF,), _INF), ((_NAN,), _NAN)],
    "log1p": [((-0.0,), -0.0), ((-1.0,), -_INF), ((-2.0,), _NAN), ((_INF,), _INF)],
    "tanh": [((-0.0,), -0.0), ((-_INF,), -1.0), ((1e-310,), 1e-310)],
    "atan2": [((0.0, 0.0), 0.0), ((-0.0, 0.0), -0.0), ((0.0, -0.0), math.pi), ((-0.0, -1.0), -math.pi),
        ((1.0, 0.0), math.pi / 2), ((-1.0, -0.0), -math.pi / 2), ((_INF, _INF), math.pi / 4),
        ((_INF, -_INF), 3 * math.pi / 4), ((1.0, -_INF), math.pi), ((_NAN, 1.0), _NAN)],
    "power": [((0.0, 0.5), 0.0), ((0.0, 0.0), 1.0), ((0.0, -1.0), _INF), ((-1.0, 0.5), _NAN),
        ((1.0, 1e308), 1.0)],
    "hypot": [((3.0, 4.0), 5.0), ((-0.0, _INF), _INF)],
}
# fmt: on


@pytest.mark.parametrize("name", _EDGES)
def test_edges(name: str) -> None:
    """Zeros keep their signs; subnormal, infinite and impossible arguments give what IEEE 754 recommends."""
    for x, true in _EDGES[name]:
        found = getattr(elementary, name)(*x)
        same = np.float64(found).view(np.int64) == np.float64(true).view(np.int64)
        assert same or (math.isnan(true) and math.isnan(found)), (x, found)


@numba.njit(fastmath=True)  # which must not reach the functions
def _all_in_a_kernel(x: Floats, y: Floats, out: Floats) -> None:
    for i in range(len(x)):
        out[0, i], out[1, i], out[2, i] = elementary.sin(x[i]), elementary.cos(x[i]), elementary.tan(x[i])
        out[3, i], out[4, i], out[5, i] = elementary.asin(x[i]), elementary.acos(x[i]), elementary.exp(x[i])
        out[6, i], out[7, i], out[8, i] = elementary.expm1(x[i]), elementary.log(x[i]), elementary.log1p(x[i])
        out[9, i], out[10, i] = elementary.tanh(x[i]), elementary.atan2(x[i], y[i])
        out[11, i], out[12, i] = elementary.hypot(x[i], y[i]), elementary.power(x[i], y[i])


def test_same_bits_from_arrays_numbers_and_kernels() -> None:
    """An array, longer than one piece, one number at a time and a kernel with fastmath give the same bits."""
    x = np.concatenate(
        [np.random.default_rng(5).normal(scale=3.0, size=9000), [0.0, -0.0, 1e-310, 1.0, math.inf]]
    )
    y, outs = x[::-1].copy(), np.empty((len(ULPS), len(x)))
    _all_in_a_kernel(x, y, outs)
    for name, out in zip(ULPS, outs, strict=True):
        function, given = getattr(elementary, name), (x, y)[: 2 if name in BINARY else 1]
        found = function(*given)
        ones = np.array(
            [function(*one) for one in zip(*(each[::50].tolist() for each in given), strict=True)]
        )
        assert np.array_equal(out.view(np.int64)[~np.isnan(found)], found.view(np.int64)[~np.isnan(found)]), (
            name
        )
        assert np.array_equal(np.isnan(out), np.isnan(found)), name
        assert np.array_equal(ones, found[::50], equal_nan=True), name


def test_shapes() -> None:
    """Operands broadcast, shapes are kept, and numbers give numbers."""
    assert elementary.atan2(np.ones((3, 1)), np.ones(4)).shape == (3, 4)
    assert elementary.exp(np.zeros((0, 3))).shape == (0, 3)
    assert elementary.exp(np.zeros((3, 5000))).shape == (3, 5000)
    assert type(elementary.exp(0.0)) is float


def test_products_sum_in_order() -> None:
    """Products of matrices and vectors are sums from the first column on, for stacks and single ones."""
    rng = np.random.default_rng(6)
    a, b, v = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3))
    turned = [
        [(a[n, i, 0] * v[n, 0] + a[n, i, 1] * v[n, 1]) + a[n, i, 2] * v[n, 2] for i in range(3)]
        for n in range(5)
    ]
    assert np.array_equal(elementary.matvec(a, v), turned)
    assert np.array_equal(elementary.matvec(a[0], v)[2], elementary.matvec(a[0], v[2]))
    product = elementary.matmul(a, b)
    assert np.array_equal(product[..., 1], elementary.matvec(a, b[..., 1]))
    assert np.allclose(product, a @ b, rtol=0.0, atol=1e-14)
