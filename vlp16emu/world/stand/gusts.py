"""Gusts over a stand, and how trees that swing about their foot answer them: sums of lines, at any time by itself.

A gust is a sum of cosines of time whose energies are those of Kaimal's spectrum. It is carried downwind with the
mean speed (Taylor's frozen turbulence), and each line waves aside as well, by a random number of waves per metre:
drawn from a Cauchy distribution, they make Davenport's exponential coherence across the wind. A damped oscillator
answers a cosine with a cosine, so its state at any time is a sum too and nothing is stepped.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, generator
from vlp16emu.world.stand.settings import Wind

__all__ = ["ACROSS", "ALONG", "Lines", "Trees", "gust_lines", "swings"]

Array = NDArray[np.float64]

ALONG, ACROSS = 0, 1
"""Components of the gusts' speed: with the mean wind, and level to the left of it."""

_LINES = 256
_SLOWEST = 0.003
"""Frequency times gust length over wind speed under which one line stands for all: 1.2 % of the energy."""
_FASTEST_HZ = 5.0
"""Frequency over which one line stands for all: no tree follows it."""

_DEVIATION = (1.0, 0.8)
_LENGTH = (1.0, 2.7 / 8.1)
"""Of the gusts' components, over those along the wind (IEC 61400-1 ed. 3, table B.1)."""

_DECAY = 10.0
"""Of the coherence exp(-decay * frequency * distance / speed) across the wind; 8 to 16 have been measured
(Davenport, Q J R Meteorol Soc 87, 1961; Simiu and Scanlan, Wind Effects on Structures)."""


class Lines(NamedTuple):
    """Gusts of one component."""

    omega_rad_s: Array
    """(n,)."""
    speed_m_s: Array
    """(n,) amplitude."""
    phase_rad: Array
    """(n,) at the origin of the world when the run begins."""
    aside_rad_m: Array
    """(n,) increase of the phase to the left of the wind."""


class Trees(NamedTuple):
    """Oscillators."""

    omega_rad_s: Array
    """(m,) undamped natural frequencies."""
    damping_ratio: float
    """Share of critical damping."""
    downwind_m: Array
    """(m,) places along the wind."""
    aside_m: Array
    """(m,) places to the left of it."""


def gust_lines(section: Wind, seed: int, component: int) -> Lines:
    """Lines of a component; the squares of their amplitudes add up to twice the variance of the spectrum.

    Kaimal's spectrum with integral length L at mean speed U: f S / sigma^2 = 4 n / (1 + 6 n)^(5/3), n = f L / U
    (IEC 61400-1 ed. 3, equation B.14; Kaimal et al., Q J R Meteorol Soc 98, 1972); up to n the share
    1 - (1 + 6 n)^(-2/3) of its energy.
    """
    rng = generator(seed, Purpose.WIND, component)
    per_n_hz = section.speed_m_s / (section.gust_length_m * _LENGTH[component])
    edges_hz = np.geomspace(_SLOWEST * per_n_hz, max(_FASTEST_HZ, 10.0 * per_n_hz), _LINES)
    share = 1.0 - (1.0 + 6.0 * edges_hz / per_n_hz) ** (-2.0 / 3.0)
    energy = np.diff(np.concatenate([[0.0], share[:-1], [1.0]]))
    # Not evenly spaced, or all would come again after a while.
    between = np.append(0.0, rng.uniform(size=_LINES - 1))
    hz = edges_hz * np.append(1.0, edges_hz[:-1] / edges_hz[1:]) ** between
    sigma_m_s = section.turbulence_intensity * _DEVIATION[component] * section.speed_m_s
    waves = np.tan(np.pi * (rng.uniform(size=_LINES) - 0.5))
    return Lines(
        2.0 * np.pi * hz,
        sigma_m_s * np.sqrt(2.0 * energy),
        rng.uniform(0.0, 2.0 * np.pi, _LINES),
        _DECAY * hz / section.speed_m_s * waves,
    )


def swings(lines: Lines, speed_m_s: float, trees: Trees, t_s: Array) -> Array:
    """Gusts as oscillators follow them: (k, m) in m/s at times (k,) since the run began.

    Each is the y of y'' + 2 z w y' + w^2 y = w^2 u with the gusts u at its place, swung in.
    """
    cosine, sine = np.empty((2, len(lines.omega_rad_s), len(t_s)))
    _waves(lines.omega_rad_s, t_s, cosine, sine)
    out = np.zeros((len(trees.omega_rad_s), len(t_s)))
    _follow(lines, 1.0 / speed_m_s, trees, cosine, sine, out)
    return out.T


@numba.njit(cache=True, nogil=True)
def _waves(omega_rad_s: Array, t_s: Array, cosine: Array, sine: Array) -> None:
    """Fill the waves (n, k) of all lines."""
    for line in range(len(omega_rad_s)):
        for k in range(len(t_s)):
            turned = omega_rad_s[line] * t_s[k]
            cosine[line, k], sine[line, k] = math.cos(turned), math.sin(turned)


@numba.njit(cache=True, nogil=True)
def _follow(lines: Lines, s_per_m: float, trees: Trees, cosine: Array, sine: Array, out: Array) -> None:
    """Fill (m, k), line after line, so that neither other trees nor other times can matter."""
    for tree in range(len(out)):
        now = out[tree]
        for line in range(len(lines.omega_rad_s)):
            omega = lines.omega_rad_s[line]
            ratio = omega / trees.omega_rad_s[tree]
            still, lag = 1.0 - ratio * ratio, 2.0 * trees.damping_ratio * ratio
            amplitude = lines.speed_m_s[line] / math.hypot(still, lag)
            phase = (
                lines.phase_rad[line]
                - omega * s_per_m * trees.downwind_m[tree]
                + lines.aside_rad_m[line] * trees.aside_m[tree]
                - math.atan2(lag, still)
            )
            a, b = amplitude * math.cos(phase), amplitude * math.sin(phase)
            for k in range(len(now)):
                now[k] += a * cosine[line, k] - b * sine[line, k]
