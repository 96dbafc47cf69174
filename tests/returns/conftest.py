"""Pulses to detect, and the detector of a perfect unit."""

import numpy as np
import pytest

from vlp16emu.returns import Detector, Noise, Weather
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.types import SURFACE, Firings, Hits, ReturnMode

LASERS = 16
DETECTOR = Detector.model_fields.keys()


@pytest.fixture(scope="session")
def detector():
    """Detector of a perfect unit in dual return, but for what is given."""

    def make(noise=None, *, seed=1, mode=ReturnMode.DUAL, min_range_m=0.5, max_range_m=100.0, **own):
        return UnitDetector.of_unit(
            Detector(**{key: own.pop(key) for key in DETECTOR & own.keys()}),
            noise if isinstance(noise, Noise) else Noise(**{"preset": "ideal", **(noise or {})}),
            Weather(**own),
            seed=seed,
            mode=mode,
            min_range_m=min_range_m,
            max_range_m=max_range_m,
            lasers=LASERS,
            power_up_ns=0,
        )

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
