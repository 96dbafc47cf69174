"""Pulses to detect, and the detector of a perfect unit."""

import numpy as np
import pytest

from vlp16emu.returns import Detector, Noise, make_law
from vlp16emu.types import SURFACE, Firings, Hits, ReturnMode

LASERS = 16
IDEAL = {
    "range_noise_m": 0.0,
    "range_bias_m": 0.0,
    "warm_up_m": 0.0,
    "warm_up_s": 900.0,
    "reflectivity_noise": 0.0,
    "gain_spread": 0.0,
    "weak_echoes_lost": False,
    "no_return_reflectivity": False,
}


@pytest.fixture(scope="session")
def detector():
    """Detector of a perfect unit in dual return, but for what is given."""

    def make(noise=None, **own):
        settings = {
            "seed": 1,
            "mode": ReturnMode.DUAL,
            "min_range_m": 0.5,
            "max_range_m": 100.0,
            "pulse_ns": 6.0,
            "resolution_m": 1.0,
            "range_at_10_percent_m": 40.0,
            "threshold_snr": 6.0,
            "visibility_m": None,
            "rain_mm_h": 0.0,
        }
        errors = Noise(**{**IDEAL, **(noise or {})})
        law = make_law(**{**settings, **own}, noise=errors)
        return Detector.of_unit(law, errors, lasers=LASERS, power_up_ns=0)

    return make


@pytest.fixture(scope="session")
def firings():
    """Firing sequences of which only number and time matter."""

    def make(k, index=0, t_ns=0):
        zeros = np.zeros((k, LASERS, 3))
        times = np.full((k, LASERS), t_ns, np.int64)
        return Firings(index, times, np.zeros(k, np.int64), zeros[..., 0], np.zeros(k), zeros, zeros, None)

    return make


@pytest.fixture(scope="session")
def pulses():
    """Hits of k * 16 pulses that all have the same sub-rays, each met at right angles by a surface of its own."""

    def make(k, range_m, surface=None, cosine=1.0):
        s = len(range_m)
        n = k * LASERS
        return Hits(
            np.full((k, LASERS), s, np.uint16),
            np.tile(np.asarray(range_m, np.float32), n),
            np.tile(np.arange(s) if surface is None else np.asarray(surface), n).astype(np.uint32),
            np.full(n * s, cosine, np.float32),
        )

    return make


@pytest.fixture(scope="session")
def table():
    """Surfaces of given reflectances."""

    def make(*reflectance):
        surfaces = np.zeros(len(reflectance), SURFACE)
        surfaces["reflectance"] = reflectance
        return surfaces

    return make
