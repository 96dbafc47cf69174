"""Receiver of a unit, made once per run."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from vlp16emu.elementary import exp
from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.returns.lost import loss_rates, near_rates
from vlp16emu.returns.noise import (
    gain,
    no_return_multiples,
    no_return_reflectivity,
    range_beat_m,
    range_bias_m,
    range_noise_parts,
    sent_codes,
)
from vlp16emu.returns.settings import Detector, DetectorConstants, LossRates, Noise, Weather
from vlp16emu.returns.strength import Strength, strength_of
from vlp16emu.sensor.laws import law, span
from vlp16emu.types import F8, I8, U1, ReturnMode
from vlp16emu.units import INCLUSIVE

_HALF_LIGHT_M_PER_NS = 0.299792458 / 2.0
_FWHM_SIGMAS = 2.3548200450309493  # 2 sqrt(2 ln 2)
_CALIBRATION_REFLECTANCE = 0.1
_WARM_UP_S = 900.0  # time constant (assumption)


@dataclass(frozen=True, slots=True)
class UnitDetector:
    """Receiver of one unit, in the weather of one run; L lasers."""

    constants: DetectorConstants
    range_bias_m: F8  # (L,)
    range_noise_share: F8  # (L,) white range noise of each laser relative to the unit's
    gain: F8  # (L,) factor on reflectivity
    range_beat_m: F8  # (5,) error of the range by (24 sequence + laser) mod 5
    near_lost: F8  # (L,) share of near records that each laser loses
    strength: Strength
    codes: U1  # (L, 101) code that is sent for each code, from `sent_codes`
    no_return: F8 | None
    """(L,) reflectivity of records without a return, truncated to integers when sent; None for 0."""
    multiples: F8
    """(m, L) multiples of `no_return` by azimuth, from `no_return_multiples`; empty for no change."""
    noise: Noise
    power_up_ns: int  # UTC of power-up, at which warm-up begins
    mode: ReturnMode

    @classmethod
    def of_unit(
        cls,
        detector: Detector,
        noise: Noise,
        weather: Weather,
        *,
        seed: int,
        mode: ReturnMode,
        min_range_m: float,
        max_range_m: float,
        elevation_deg: F8,
        power_up_ns: int,
    ) -> Self:
        """Draw the constant errors of a unit, and convert the settings of a run for kernels.

        Parameters
        ----------
        seed : seed of the unit
        mode : return mode; in strongest return mode, other echoes are not searched
        min_range_m, max_range_m : nearer echoes are blanked, farther echoes are lost
        elevation_deg : (L,) nominal elevations of the lasers
        """
        lasers = len(elevation_deg)
        sigma_m = _HALF_LIGHT_M_PER_NS * detector.pulse_ns / _FWHM_SIGMAS
        least, amplitude_noise = threshold_of(detector)
        # Log-normal, so that no error is below 0.
        factors = exp(noise.unit_spread * normal(seed, Purpose.UNIT_NOISE, 0, 2)).tolist()
        least_walk, most_walk = span("range.walk_mm")
        walk_mm = least_walk + (most_walk - least_walk) * float(uniform(seed, Purpose.UNIT_NOISE, 2, 1)[0])
        bright_noise, dark_noise = range_noise_parts(seed, noise)
        air_per_m = clutter = 0.0
        if weather.summary:
            from vlp16emu.returns.weather import air_reflectance, extinction_per_m  # here: not for clear air

            air_per_m = extinction_per_m(weather.visibility_m, weather.rain_mm_h)
            clutter = air_reflectance(air_per_m, sigma_m)
        constants = DetectorConstants(
            seed=seed,
            strongest_only=mode is ReturnMode.STRONGEST,
            min_range_m=min_range_m,
            max_range_m=max_range_m * INCLUSIVE,
            sigma_m=sigma_m,
            resolution_m=detector.resolution_m,
            threshold=least if noise.weak_echoes_lost else 0.0,
            amplitude_noise=amplitude_noise if noise.weak_echoes_lost else 0.0,
            extinction_per_m=air_per_m,
            clutter=clutter,
            least_clutter=least,
            range_noise_m=noise.range_noise_m * factors[0],
            bright_noise=bright_noise,
            dark_noise=dark_noise,
            reflectivity_noise=noise.reflectivity_noise * factors[1],
            reflectivity_noise_share=noise.reflectivity_noise_share * factors[1],
            heavy_tails=noise.is_real,
            range_walk_m=1e-3 * walk_mm * noise.is_real,
            lost=loss_rates(seed, noise),
        )
        no_return = (
            no_return_reflectivity(seed, lasers, noise.no_return_level)
            if noise.no_return_reflectivity
            else None
        )
        multiples = np.zeros((0, lasers))
        if no_return is not None and noise.no_return_wander:
            multiples = no_return_multiples(seed, no_return, noise.no_return_wander)
        return cls(
            constants=constants,
            range_bias_m=range_bias_m(seed, lasers, noise.range_bias_m),
            range_noise_share=exp(
                law("range.laser_noise_spread")
                * noise.is_real
                * normal(seed, Purpose.UNIT_NOISE, 0, lasers, 1)
            ),
            gain=gain(seed, noise.gain_spread, elevation_deg),
            range_beat_m=range_beat_m(seed, noise.range_beat_m, noise.range_beat_phase_deg),
            near_lost=near_rates(seed, lasers, noise),
            strength=strength_of(
                seed,
                lasers,
                far_step=noise.reflectivity_far_step,
                unit_spread=noise.unit_spread,
                gain_spread=noise.gain_by_range,
                has_counts=noise.range_counts,
                is_real=noise.is_real,
            ),
            codes=sent_codes(seed, lasers, noise.reflectivity_step),
            no_return=no_return,
            multiples=multiples,
            noise=noise,
            power_up_ns=power_up_ns,
            mode=mode,
        )

    def for_mode(self, mode: ReturnMode) -> Self:
        """Return a receiver that detects the echoes of a return mode."""
        constants = self.constants._replace(strongest_only=mode is ReturnMode.STRONGEST)
        return replace(self, constants=constants, mode=mode)

    def without_chance(self) -> Self:
        """Return a receiver without randomness and errors that detects all echoes.

        Its threshold and its air are the same.
        """
        errors = "amplitude_noise", "clutter", "range_noise", "range_walk", "reflectivity_"
        lost = LossRates(*[0.0] * len(LossRates._fields))
        given = self.constants._asdict() | {"strongest_only": False, "lost": lost}
        constants = DetectorConstants(
            **given | {name: 0.0 for name in DetectorConstants._fields if name.startswith(errors)}
        )
        return replace(
            self,
            constants=constants,
            range_bias_m=np.zeros_like(self.range_bias_m),
            range_noise_share=np.ones_like(self.range_noise_share),
            gain=np.ones_like(self.gain),
            range_beat_m=np.zeros_like(self.range_beat_m),
            near_lost=np.zeros_like(self.near_lost),
            strength=strength_of(
                0,
                len(self.gain),
                far_step=0.0,
                unit_spread=0.0,
                gain_spread=0.0,
                has_counts=False,
                is_real=False,
            ),
            codes=sent_codes(0, len(self.gain), 0.0),
            no_return=None,
            multiples=self.multiples[:0],
            noise=Noise(preset="ideal"),
        )

    def drift_m(self, t_ns: I8) -> F8:
        """Return the warm-up error of ranges at instants, same shape.

        It decays exponentially after power-up.
        """
        if not self.noise.warm_up_m:
            return np.zeros(t_ns.shape)
        return np.asarray(self.noise.warm_up_m * exp(-1e-9 * (t_ns - self.power_up_ns) / _WARM_UP_S))


def threshold_of(detector: Detector) -> tuple[float, float]:
    """Return the amplitude that is detected with probability one half, and the sigma of its noise, in m-2."""
    range_m = detector.range_at_10_percent_m
    threshold = _CALIBRATION_REFLECTANCE / (range_m * range_m)
    return threshold, threshold / detector.threshold_snr
