"""The spinning head.

Its true angle as a function of time and what the encoder reads; and what the sensor takes the time to be.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, normal
from vlp16emu.units import HOUR_NS, S_NS

__all__ = ["Clock", "Rotor"]


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


@dataclass(frozen=True, slots=True)
class Clock:
    """The sensor's top-of-hour counter.

    Locked to GPS it shows nanoseconds past the UTC hour; without GPS it runs from power-up on its own
    oscillator and rolls over every 3600 s (63-9243 Rev D, appendix G). Before power-up it stands at zero: the stamp of a
    position packet is older than the packet, and so may fall before there is a clock.
    """

    locked: bool
    power_up_ns: int
    """UTC at which the free-running counter stood at zero."""
    error_ppm: float
    """How much the free-running counter is fast."""

    def reading_ns(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Nanoseconds past the counter's hour at UTC instants, any shape."""
        if self.locked:
            return np.asarray(t_ns % HOUR_NS)
        since = np.maximum(t_ns - self.power_up_ns, 0)
        if self.error_ppm:
            since = since + np.rint(since * (self.error_ppm * 1e-6)).astype(np.int64)
        return np.asarray(since % HOUR_NS)
