"""The damped oscillator y'' + 2 z w y' + w^2 y = f for a cubic f, without cancellation from soft to stiff."""

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["decay_per_s", "response"]

_SLOW = 4.0
"""Up to this argument a power series loses less than two digits to its alternating signs."""
_POWERS = 4
"""Coefficients of a cubic."""


def decay_per_s(frequency_hz: float, damping_ratio: float) -> float:
    """Rate at which the slowest part of a free swing dies away."""
    omega, z = 2.0 * math.pi * frequency_hz, damping_ratio
    return z * omega if z < 1.0 else omega / (z + math.sqrt((z - 1.0) * (z + 1.0)))


def response(frequency_hz: float, damping_ratio: float, s: float) -> NDArray[np.float64]:
    """Linear map (2, 6) from (y, y', f0, f1, f2, f3) at 0 to (y, y') after s seconds, f = sum of fi t^i.

    The homogeneous part is the matrix exponential; column 2 + i of the first row is the integral of
    G(s - t) t^i with the impulse response G; by parts, its derivative is i times the column before.
    """
    omega = 2.0 * math.pi * frequency_hz
    still, impulse, impulse_rate = _free(omega, damping_ratio, s)
    # Three ways to the same integrals, each where it keeps its digits.
    if max(1.0, 2.0 * damping_ratio) * omega * s <= _SLOW:
        forced = _forced_by_series(omega, damping_ratio, s)
    elif damping_ratio < 1.5:
        forced = _forced_by_polynomial(omega, damping_ratio, s)
    else:
        forced = _forced_by_rates(omega, damping_ratio, s)
    rates = [impulse, *(i * forced[i - 1] for i in range(1, _POWERS))]
    return np.array([[still, impulse, *forced], [-omega * omega * impulse, impulse_rate, *rates]])


def _free(omega: float, z: float, s: float) -> tuple[float, float, float]:
    """Answer to an initial stretch, to an initial rate (the impulse response), and the latter's derivative."""
    spread2 = (1.0 - z) * (1.0 + z) * omega * omega
    if spread2 >= 0.0:
        turn = math.sqrt(spread2)
        fade = math.exp(-z * omega * s)
        sine = fade * (math.sin(turn * s) / turn if turn else s)
        cosine = fade * math.cos(turn * s)
        return cosine + z * omega * sine, sine, cosine - z * omega * sine
    slow, fast, gap = _rates(omega, z)
    late, early = math.exp(slow * s), math.exp(fast * s)
    impulse = late * -math.expm1(-gap * s) / gap
    return (slow * early - fast * late) / gap, impulse, (slow * late - fast * early) / gap


def _rates(omega: float, z: float) -> tuple[float, float, float]:
    """Two real decay rates of an overdamped oscillator, both negative, and the gap between them."""
    root = math.sqrt((z - 1.0) * (z + 1.0))
    return -omega / (z + root), -omega * (z + root), 2.0 * omega * root


def _forced_by_series(omega: float, z: float, s: float) -> list[float]:
    """By the power series of the impulse response: for oscillators slow against s."""
    forced = [0.0] * _POWERS
    before, term = 0.0, 1.0  # coefficients of t^(n - 1) and t^n in G
    for n in range(1, 60):
        for i in range(_POWERS):
            forced[i] += (
                term * math.factorial(i) * math.factorial(n) / math.factorial(n + i + 1) * s ** (n + i + 1)
            )
        before, term = term, (-2.0 * z * omega * n * term - omega * omega * before) / (n * (n + 1))
    return forced


def _forced_by_polynomial(omega: float, z: float, s: float) -> list[float]:
    """By the polynomial that solves the equation, less the free swing from its start: for quick oscillators."""
    still, impulse, _ = _free(omega, z, s)
    forced = []
    for i in range(_POWERS):
        p = np.zeros(_POWERS + 2)
        for k in range(i, -1, -1):
            wanted = float(k == i)
            p[k] = (
                wanted / omega - 2.0 * z * (k + 1) * p[k + 1] - (k + 2) * (k + 1) * p[k + 2] / omega
            ) / omega
        forced.append(float(np.polynomial.polynomial.polyval(s, p)) - still * p[0] - impulse * p[1])
    return forced


def _forced_by_rates(omega: float, z: float, s: float) -> list[float]:
    """By the two real exponentials of an overdamped oscillator, quick against slow."""
    slow, fast, gap = _rates(omega, z)
    late, early = _phi(slow * s), _phi(fast * s)
    return [math.factorial(i) * s ** (i + 1) * (late[i] - early[i]) / gap for i in range(_POWERS)]


def _phi(x: float) -> list[float]:
    """Functions phi_1 .. phi_4 of exponential integrators (Hochbruck and Ostermann, Acta Numerica 19, 2010)."""
    if abs(x) < _SLOW:
        return [sum(x**n / math.factorial(n + k) for n in range(60)) for k in range(1, _POWERS + 1)]
    phi = [math.exp(x)]
    for k in range(_POWERS):
        phi.append((phi[-1] - 1.0 / math.factorial(k)) / x)
    return phi[1:]
