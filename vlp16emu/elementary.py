"""Elementary functions of float64 with the same bits on all processors.

They consist of additions, products, quotients and roots, which IEEE 754 rounds exactly.

Libraries choose variants by processor, and these differ in the last bits. Here each operation is defined by
IEEE 754 and runs in the order that is written. The algorithms are from fdlibm (Sun Microsystems, 1993) unless
a function says otherwise, written without branches, so that one source serves numpy arrays and kernels.

Every function takes numbers or arrays, which broadcast, and is called in the same way from Python and from
kernels, there with float64 only. Stated errors, in units in the last place (ulp), are the largest that
`tools/elementary` finds.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, Protocol, cast, overload

import numba.extending
import numpy as np
from llvmlite import ir
from numba import types
from numpy.typing import NDArray

from vlp16emu.kernels.compiler import inner_kernel, kernel, numba

_Floats = NDArray[np.float64]
_Numbers = NDArray[np.floating[Any]]
_Value = Any  # a number or an array in Python, one number in kernels: they have no common base
_WHOLE = 6755399441055744.0  # 1.5 * 2**52: adding it rounds to a whole number, held in the lowest bits
_TINY = 2.0**-1022  # smallest normal number
_HALF_PI = 1.5707963109016418, 1.5893254712295857e-08, 6.123233932053594e-17, 6.36831716351095e-25
"""pi / 2 in three parts of 25 bits, so that products with whole numbers below 2**28 are exact, and the
rest."""
_LARGEST_RAD = 1e12
_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""ln 2: its first 33 bits, so that products with exponents are exact, and the rest."""


class _Elementary(Protocol):
    @overload
    def __call__(self, *x: float) -> float: ...  # type: ignore[overload-overlap]  # numbers are no arrays
    @overload
    def __call__(self, *x: _Numbers | float) -> _Floats: ...


class _Both:
    """Function of float64 for arrays, also compiled for kernels.

    The compiled function keeps its order even if the caller uses `fastmath`, and divides by 0 as numpy does.
    If `inlined`, it becomes part of each kernel that calls it, which loops with four values per step need.
    """

    def __init__(self, function: Callable[..., _Value], *, inlined: bool = False) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self._inlined = inlined

    @functools.cached_property
    def kernel(self) -> Callable[..., object]:
        """Compiled function for kernels; made when the first kernel is compiled."""
        return inner_kernel(self.function, inlined=self._inlined)

    def __call__(self, *numbers: _Value) -> _Value:
        return self.function(*numbers)


class _Broadcast(_Both):
    """Function of float64 that Python calls too, with numbers and arrays that broadcast."""

    def __call__(self, *numbers: _Value) -> _Value:
        arrays = [np.asarray(x, np.float64) for x in numbers]
        if self.function.__name__ in _LOOPS:
            value = np.empty(np.broadcast(*arrays).shape)
            broadcast = (
                x if x.shape == value.shape else np.broadcast_to(x, value.shape).copy() for x in arrays
            )
            flat = [np.ascontiguousarray(x).reshape(-1) for x in broadcast]
            _fill(_LOOPS.index(self.function.__name__), flat[0], flat[-1], value.reshape(-1))
        else:
            with np.errstate(all="ignore"):
                value = self.function(*(x[()] for x in arrays))
        return value if np.ndim(value) else float(value)


@numba.extending.typeof_impl.register(_Both)  # type: ignore[untyped-decorator]
def _type_of(both: _Both, _context: object) -> types.Dispatcher:
    return types.Dispatcher(both.kernel)


def _inline(function: Callable[..., _Value]) -> _Both:
    return _Both(function, inlined=True)


def _elementary(function: Callable[..., _Value]) -> _Elementary:
    return cast("_Elementary", _Broadcast(function))


def _pick(condition: _Value, a: _Value, b: _Value) -> _Value:
    chosen: _Value = np.where(condition, a, b)
    return chosen[()]


def _bits(x: _Value) -> _Value:
    return x.view(np.int64)


def _number(bits: _Value) -> _Value:
    return bits.view(np.float64)


def _as_instruction(
    function: Callable[..., object], typed: object, emit: Callable[..., object], *sorts: object
) -> None:
    """Register the LLVM instruction that kernels use for `function`."""
    numba.extending.type_callable(function)(lambda _context: typed)
    numba.extending.lower_builtin(function, *sorts)(
        lambda _context, builder, _typed, values: emit(builder, values)
    )


_as_instruction(
    _pick,
    lambda condition, a, b: types.float64,  # noqa: ARG005  # numba reads the names
    lambda builder, values: builder.select(*values),
    types.boolean,
    types.float64,
    types.float64,
)
_as_instruction(
    _bits,
    lambda x: types.int64,  # noqa: ARG005
    lambda builder, values: builder.bitcast(values[0], ir.IntType(64)),
    types.float64,
)
_as_instruction(
    _number,
    lambda bits: types.float64,  # noqa: ARG005
    lambda builder, values: builder.bitcast(values[0], ir.DoubleType()),
    types.int64,
)


@_inline
def around_zero(y: _Value) -> tuple[_Value, _Value]:
    """Cosine and sine of angles up to pi / 4, numbers or arrays: fdlibm, k_cos.c and k_sin.c."""
    z = y * y
    high = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    high = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * high)
    s = y + y * z * (-1.66666666666666324348e-01 + z * high)
    high = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)
    high = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * high)
    return 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * high), s


@_inline
def _cos_sin(x: _Value) -> tuple[_Value, _Value]:
    """Return cosine and sine from the nearest right angle and the remainder, a sum of two numbers."""
    shifted = _pick(abs(x) <= _LARGEST_RAD, x, math.nan) * (2.0 / math.pi) + _WHOLE
    n = shifted - _WHOLE
    quarter = _bits(shifted)
    y = (x - n * _HALF_PI[0]) - n * _HALF_PI[1]
    third = n * _HALF_PI[2]
    high = y - third
    back = high - y
    rest = (y - (high - back)) - (third + back) - n * _HALF_PI[3]
    left = high + rest
    rest = (high - left) + rest
    c, s = around_zero(left)
    c, s = c - rest * s, s + rest * c
    odd = (quarter & 1) != 0
    cosine, sine = _pick(odd, s, c), _pick(odd, c, s)
    cosine = _pick(((quarter + 1) & 2) != 0, -cosine, cosine)
    return cosine, _pick(abs(x) < 2.0**-27, x, _pick((quarter & 2) != 0, -sine, sine))


@_elementary
def sin(x: _Value) -> _Value:
    """Sine, within 1.6 ulp up to 4.2e8 rad, beyond within the last bit of the angle; NaN from 1e12 rad on."""
    return _cos_sin(x)[1]


@_elementary
def cos(x: _Value) -> _Value:
    """Cosine, within 1.6 ulp up to 4.2e8 rad, beyond within the last bit of the angle.

    It is NaN from 1e12 rad on.
    """
    return _cos_sin(x)[0]


@_elementary
def tan(x: _Value) -> _Value:
    """Tangent, within 3.5 ulp up to 4.2e8 rad, beyond within the last bit of the angle.

    It is NaN from 1e12 rad on.
    """
    return sin(x) / cos(x)


@_elementary
def atan2(y: _Value, x: _Value) -> _Value:
    """Angle of (x, y) from the x axis, -pi .. pi, within 1.5 ulp; zeros have signs, as in IEEE 754.

    As in s_atan.c and e_atan2.c, one of four known angles, or none, is subtracted first.
    """
    up = abs(y)
    far = abs(x)
    t = _pick(up == far, _pick(up == 0.0, 0.0, 1.0), up / far)
    a = -1.0
    b = t
    high = 1.57079632679489655800e00
    low = 6.12323399573676603587e-17
    near = t < 2.4375
    a, b = _pick(near, t - 1.5, a), _pick(near, 1.0 + 1.5 * t, b)
    high, low = _pick(near, 9.82793723247329054082e-01, high), _pick(near, 1.39033110312309984516e-17, low)
    near = t < 1.1875
    a, b = _pick(near, t - 1.0, a), _pick(near, t + 1.0, b)
    high, low = _pick(near, 7.85398163397448278999e-01, high), _pick(near, 3.06161699786838301793e-17, low)
    near = t < 0.6875
    a, b = _pick(near, 2.0 * t - 1.0, a), _pick(near, 2.0 + t, b)
    high, low = _pick(near, 4.63647609000806093515e-01, high), _pick(near, 2.26987774529616870924e-17, low)
    near = t < 0.4375
    a = _pick(near, t, a)
    b = _pick(near, 1.0, b)
    high = _pick(near, 0.0, high)
    low = _pick(near, 0.0, low)
    r = a / b
    z = r * r
    w = z * z
    even = 4.97687799461593236017e-02 + w * 1.62858201153657823623e-02
    even = 1.42857142725034663711e-01 + w * (
        9.09088713343650656196e-02 + w * (6.66107313738753120669e-02 + w * even)
    )
    even = z * (3.33333333333329318027e-01 + w * even)
    odd = -5.83357013379057348645e-02 + w * -3.65315727442169155270e-02
    odd = -1.11111104054623557880e-01 + w * (-7.69187620504482999495e-02 + w * odd)
    odd = w * (-1.99999999998764832476e-01 + w * odd)
    angle = high - ((r * (even + odd) - low) - r)
    left = (_bits(x) < 0) & ((x != 0.0) | (y == 0.0))
    angle = _pick(left, math.pi - (angle - 1.2246467991473532e-16), angle)
    return _pick(_bits(y) < 0, -angle, angle)


@_elementary
def asin(x: _Value) -> _Value:
    """Arcsine, within 2.5 ulp, by the sides of the triangle."""
    return atan2(x, np.sqrt((1.0 - x) * (1.0 + x)))


@_elementary
def acos(x: _Value) -> _Value:
    """Arccosine, within 2.5 ulp, by the sides of the triangle."""
    return atan2(np.sqrt((1.0 - x) * (1.0 + x)), x)


@_elementary
def exp(x: _Value) -> _Value:
    """Exponential, within 1 ulp: e_exp.c."""
    x = _pick(x > 720.0, 720.0, _pick(x < -750.0, -750.0, x))
    n = (x * 1.4426950408889634 + _WHOLE) - _WHOLE
    high, low = x - n * _LN2[0], n * _LN2[1]
    r = high - low
    t = r * r
    c = 4.13813679705723846039e-08
    c = 6.61375632143793436117e-05 + t * (-1.65339022054652515390e-06 + t * c)
    c = r - t * (1.66666666666666019037e-01 + t * (-2.77777777770155933842e-03 + t * c))
    y = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    half = 0.5 * n + _WHOLE  # two steps, so that only the last one rounds a subnormal number
    other = (n - (half - _WHOLE)) + _WHOLE
    return y * _number((_bits(half) + 1023) << 52) * _number((_bits(other) + 1023) << 52)


@_elementary
def expm1(x: _Value) -> _Value:
    """Return exp(x) - 1, within 3 ulp.

    Kahan's quotient of two values with equal errors (Higham 2002, section 1.14.1).
    """
    y = exp(x)
    quotient = (y - 1.0) * x / log(y)
    return _pick(abs(x) < 1.0, _pick(y == 1.0, x, quotient), y - 1.0)


@_inline
def log_of_normal(x: _Value) -> _Value:
    """Logarithm of normal numbers above 0, within 1 ulp.

    As in e_log.c; inlined, for loops with four values per step.
    """
    whole = _bits(x) - 0x3FE6A09E667F3BCD >> 52  # so that x / 2**whole is about 1
    f = _number(_bits(x) - (whole << 52)) - 1.0
    e = _number(whole + 0x4338000000000000) - _WHOLE  # as a float
    s = f / (2.0 + f)
    z = s * s
    high = 2.222219843214978396e-01 + z * (
        1.818357216161805012e-01 + z * (1.531383769920937332e-01 + z * 1.479819860511658591e-01)
    )
    rest = z * (
        6.666666666666735130e-01 + z * (3.999999999940941908e-01 + z * (2.857142874366239149e-01 + z * high))
    )
    half = 0.5 * f * f
    return e * _LN2[0] - ((half - (s * (half + rest) + e * _LN2[1])) - f)


@_elementary
def log(x: _Value) -> _Value:
    """Logarithm, within 1 ulp; minus infinity of 0, and NaN below."""
    subnormal = x < _TINY
    y = log_of_normal(_pick(subnormal, x * 2.0**54, x)) - _pick(subnormal, 37.42994775023705, 0.0)
    return _pick((x > 0.0) & (x < math.inf), y, _pick(x == 0.0, -math.inf, _pick(x < 0.0, math.nan, x)))


@_elementary
def log1p(x: _Value) -> _Value:
    """Return log(1 + x), within 2 ulp, by a quotient as in `expm1` (Higham 2002, problem 1.5)."""
    y = 1.0 + x
    quotient = log(y) * x / (y - 1.0)
    return _pick(y == 1.0, x, _pick(x < 2.0**53, quotient, log(y)))


@_elementary
def power(base: _Value, exponent: _Value) -> _Value:
    """Power of a base from 0 on, within 1 + 2 * |exponent * log(base)| ulp: not for large exponents."""
    return _pick(exponent == 0.0, 1.0, exp(exponent * log(base)))


@_elementary
def tanh(x: _Value) -> _Value:
    """Hyperbolic tangent, within 4.5 ulp: s_tanh.c."""
    t = expm1(-2.0 * abs(x))
    y = -t / (t + 2.0)
    return _pick(x == 0.0, x, _pick(x < 0.0, -y, y))


@_elementary
def hypot(x: _Value, y: _Value) -> _Value:
    """Root of the sum of squares, within 1 ulp.

    The squares must be neither infinite nor subnormal.
    """
    return np.sqrt(x * x + y * y)


_LOOPS = "cos", "sin", "atan2", "exp", "log", "power"
"""Functions that are also compiled for numbers and arrays, in the order of `_fill`; the others call these."""


@kernel  # numba has no types
def _fill(which: int, x: _Floats, y: _Floats, out: _Floats) -> None:
    """Fill (n,) with the values of one of `_LOOPS`; one kernel for all of them is compiled once."""
    for i in range(out.shape[0]):
        if which == 0:
            out[i] = cos(x[i])
        elif which == 1:
            out[i] = sin(x[i])
        elif which == 2:
            out[i] = atan2(x[i], y[i])
        elif which == 3:
            out[i] = exp(x[i])
        elif which == 4:
            out[i] = log(x[i])
        else:
            out[i] = power(x[i], y[i])


def norm(vectors: _Floats) -> _Value:
    """Return lengths of vectors (..., n); squares are summed from the first component on."""
    total = vectors[..., 0] * vectors[..., 0]
    for i in range(1, vectors.shape[-1]):
        total = total + vectors[..., i] * vectors[..., i]
    return np.sqrt(total)


def matvec(matrix: _Floats, vector: _Floats) -> _Floats:
    """Multiply matrices (..., n, m) by vectors (..., m), summing from the first column on.

    BLAS gives other bits on other processors.
    """
    return matmul(matrix, vector[..., None])[..., 0]


def inverse(pose: _Floats) -> _Floats:
    """Invert rigid transforms (..., 4, 4): LAPACK differs by processor."""
    out = np.zeros_like(pose)
    turn = np.swapaxes(pose[..., :3, :3], -1, -2)
    out[..., :3, :3] = turn
    out[..., :3, 3] = -matvec(turn, pose[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def matmul(a: _Floats, b: _Floats) -> _Floats:
    """Multiply matrices (..., n, m) and (..., m, p), summing from the first column on.

    BLAS gives other bits on other processors.
    """
    out = a[..., :, :1] * b[..., :1, :]
    for i in range(1, a.shape[-1]):
        out = out + a[..., :, i : i + 1] * b[..., i : i + 1, :]
    return out
