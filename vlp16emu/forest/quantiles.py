"""Quantiles of the normal distribution."""

import numpy as np

from vlp16emu.elementary import log
from vlp16emu.types import Array

_SQRT_2_PI = 2.50662827463100050242
_TAIL = 0.13533528323661269189  # exp(-2): where the approximation of the tails takes over from that of the middle

_MIDDLE = (
    (-5.99633501014107895267e1, 9.80010754185999661536e1, -5.66762857469070293439e1, 1.39312609387279679503e1, -1.23916583867381258016e0),
    (1.0, 1.95448858338141759834e0, 4.67627912898881538453e0, 8.63602421390890590575e1, -2.25462687854119370527e2, 2.00260212380060660359e2, -8.20372256168333339912e1, 1.59056225126211695515e1, -1.18331621121330003142e0),
)  # fmt: skip
_TAILS = (
    (4.05544892305962419923e0, 3.15251094599893866154e1, 5.71628192246421288162e1, 4.40805073893200834700e1, 1.46849561928858024014e1, 2.18663306850790267539e0, -1.40256079171354495875e-1, -3.50424626827848203418e-2, -8.57456785154685413611e-4),
    (1.0, 1.57799883256466749731e1, 4.53907635128879210584e1, 4.13172038254672030440e1, 1.50425385692907503408e1, 2.50464946208309415979e0, -1.42182922854787788574e-1, -3.80806407691578277194e-2, -9.33259480895457427372e-4),
)  # fmt: skip
"""Numerators and denominators, highest power first (Moshier, Cephes Mathematical Library, ndtri.c)."""


def normal_quantile(probability: Array) -> Array:
    """Return the standard normal quantiles of probabilities (n,) from 1e-13 to 1 - 1e-13, within 1e-15 of their size."""
    off = probability - 0.5
    square = off * off
    middle = (off + off * (square * _ratio(_MIDDLE, square))) * _SQRT_2_PI
    tail = np.minimum(np.minimum(probability, 1.0 - probability), _TAIL)
    far = np.sqrt(-2.0 * log(tail))
    far = far - log(far) / far - _ratio(_TAILS, 1.0 / far) / far
    return np.where(tail < _TAIL, np.copysign(far, off), middle)


def _ratio(fraction: tuple[tuple[float, ...], tuple[float, ...]], x: Array) -> Array:
    above, below = (np.polyval(np.array(coefficients), x) for coefficients in fraction)
    quotient: Array = above / below
    return quotient
