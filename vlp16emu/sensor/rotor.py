"""The spinning head: its true angle as a function of time, and what the encoder reads."""

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, normal
from vlp16emu.units import S_NS

__all__ = ["Rotor"]


@dataclass(frozen=True, slots=True)
class Rotor:
    """A head that turns clockwise, seen from above, at constant speed.

    The true angle is a function of time alone. The encoder adds an error locked to the angle, one
    cycle per revolution, and white noise on each reading: on real units the steps between blocks
    have a lag-1 autocorrelation near -0.5, which is noise of the reading and not of the speed.
    """

    rpm: int
    """Whole turns per minute."""
    start_azimuth_deg: float
    """True angle at time zero."""
    eccentricity_deg: float
    """Amplitude of the angle-locked error; 0 switches it off."""
    eccentricity_phase_deg: float
    """Angle at which that error crosses zero upwards."""
    noise_deg: float
    """One sigma of a reading's white error; 0 switches it off."""
    seed: int

    def angle_deg(self, elapsed_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Turn times since the start, any shape, into true angles in [0, 360), exact after any number of hours."""
        # Only what is past the last whole turn on a whole second counts: no error grows with time.
        per_minute = math.gcd(self.rpm, 60)
        span_ns, turns = 60 // per_minute * S_NS, self.rpm // per_minute
        out = np.empty(elapsed_ns.shape)
        _turn(
            elapsed_ns.reshape(-1), span_ns, turns * 360.0 / span_ns, self.start_azimuth_deg, out.reshape(-1)
        )
        return out

    def reading_deg(self, angle_deg: NDArray[np.float64], first: int) -> NDArray[np.float64]:
        """Read the encoder at (k,) true angles, those of firing sequences first .. first + k - 1."""
        reading = angle_deg
        if self.eccentricity_deg:
            reading = _eccentric(reading, self.eccentricity_deg, self.eccentricity_phase_deg)
        if self.noise_deg:
            reading = reading + self.noise_deg * normal(
                self.seed, Purpose.AZIMUTH_READING, first, len(reading)
            )
        return np.asarray(reading % 360.0)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _turn(
    elapsed_ns: NDArray[np.int64], span_ns: int, deg_per_ns: float, start_deg: float, out: NDArray[np.float64]
) -> None:
    """Fill angles (n,); the remainder is exact, like that of `%`, for whole turns and their differences are."""
    for i in range(out.shape[0]):
        angle_deg = start_deg + (elapsed_ns[i] % span_ns) * deg_per_ns
        angle_deg -= 360.0 * math.floor(angle_deg / 360.0)
        out[i] = angle_deg + 360.0 if angle_deg < 0.0 else angle_deg


@numba.njit(cache=True, nogil=True)
def _eccentric(angle_deg: NDArray[np.float64], amplitude_deg: float, phase_deg: float) -> NDArray[np.float64]:
    """Add the angle-locked error."""
    out = np.empty_like(angle_deg)
    for i in range(angle_deg.size):
        out[i] = angle_deg[i] + amplitude_deg * math.sin(math.radians(angle_deg[i] - phase_deg))
    return out
