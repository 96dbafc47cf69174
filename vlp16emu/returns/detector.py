"""What a unit's receiver is, made once per run."""

import math
from dataclasses import dataclass, replace
from typing import Self

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.returns.law import Law
from vlp16emu.returns.noise import Noise, gain, no_return_reflectivity, range_bias_m
from vlp16emu.returns.weather import air_reflectance, extinction_per_m
from vlp16emu.types import ReturnMode

__all__ = ["Detector", "make_law", "threshold_of"]

_HALF_LIGHT_M_PER_NS = 0.299792458 / 2.0
_FWHM_SIGMAS = 2.0 * math.sqrt(2.0 * math.log(2.0))
_CALIBRATION_REFLECTANCE = 0.1


@dataclass(frozen=True, slots=True)
class Detector:
    """The receiver of one unit, in the weather of one run; L lasers."""

    law: Law
    range_bias_m: NDArray[np.float64]
    """(L,)."""
    gain: NDArray[np.float64]
    """(L,) factor on reflectivity."""
    no_return: NDArray[np.uint8] | None
    """(L,) reflectivity of records without a return; None where that is 0."""
    power_up_ns: int
    """UTC."""
    warm_up_m: float
    warm_up_s: float

    @classmethod
    def of_unit(cls, law: Law, noise: Noise, *, lasers: int, power_up_ns: int) -> Self:
        """Draw what the unit was born with; the law's seed tells which unit it is.

        Parameters
        ----------
        power_up_ns : UTC, from which warm-up counts
        """
        return cls(
            law=law,
            range_bias_m=range_bias_m(law.seed, lasers, noise.range_bias_m),
            gain=gain(law.seed, lasers, noise.gain_spread),
            no_return=no_return_reflectivity(law.seed, lasers) if noise.no_return_reflectivity else None,
            power_up_ns=power_up_ns,
            warm_up_m=noise.warm_up_m,
            warm_up_s=noise.warm_up_s,
        )

    def without_chance(self) -> Self:
        """Give a receiver of the same threshold in the same air that tells all echoes, draws nothing and errs in nothing."""
        law = self.law._replace(
            strongest_only=False, amplitude_noise=0.0, clutter=0.0, range_noise_m=0.0, reflectivity_noise=0.0
        )
        none, one = np.zeros_like(self.range_bias_m), np.ones_like(self.gain)
        return replace(self, law=law, range_bias_m=none, gain=one, no_return=None, warm_up_m=0.0)

    def drift_m(self, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Warm-up error of ranges at some instants, same shape; fades exponentially from power-up on."""
        out = np.zeros(t_ns.shape)
        if self.warm_up_m:
            _fade(t_ns - self.power_up_ns, self.warm_up_m, self.warm_up_s, out)
        return out


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _fade(since_ns: NDArray[np.int64], from_m: float, in_s: float, out: NDArray[np.float64]) -> None:
    """Fill an exponential (n,)."""
    for i in range(out.shape[0]):
        out[i] = from_m * math.exp(-1e-9 * since_ns[i] / in_s)


def threshold_of(range_at_10_percent_m: float, threshold_snr: float) -> tuple[float, float]:
    """Amplitude that is seen with probability one half, and one sigma of its noise; arguments as in `make_law`."""
    threshold = _CALIBRATION_REFLECTANCE / range_at_10_percent_m**2
    return threshold, threshold / threshold_snr


def make_law(
    *,
    seed: int,
    mode: ReturnMode,
    min_range_m: float,
    max_range_m: float,
    pulse_ns: float,
    resolution_m: float,
    range_at_10_percent_m: float,
    threshold_snr: float,
    visibility_m: float | None,
    rain_mm_h: float,
    noise: Noise,
) -> Law:
    """Put the settings of a run into the form that kernels take.

    Parameters
    ----------
    seed : of the scenario
    mode : in strongest return, only that is looked for
    min_range_m, max_range_m : what is measured nearer is blanked, what is measured farther is lost
    pulse_ns : full width at half maximum
    resolution_m : echoes nearer to each other are one, the stronger of them
    range_at_10_percent_m : where every second pulse sees 10 %, Lambertian, upright and wide, in clear air
    threshold_snr : amplitude at the threshold over its noise
    visibility_m : None without fog
    """
    sigma_m = _HALF_LIGHT_M_PER_NS * pulse_ns / _FWHM_SIGMAS
    threshold, amplitude_noise = threshold_of(range_at_10_percent_m, threshold_snr)
    air_per_m = extinction_per_m(visibility_m, rain_mm_h)
    return Law(
        seed=seed,
        strongest_only=mode is ReturnMode.STRONGEST,
        min_range_m=min_range_m,
        max_range_m=max_range_m,
        sigma_m=sigma_m,
        resolution_m=resolution_m,
        threshold=threshold if noise.weak_echoes_lost else 0.0,
        amplitude_noise=amplitude_noise if noise.weak_echoes_lost else 0.0,
        extinction_per_m=air_per_m,
        clutter=air_reflectance(air_per_m, sigma_m),
        least_clutter=threshold,
        range_noise_m=noise.range_noise_m,
        reflectivity_noise=noise.reflectivity_noise,
    )
