"""Pulses to detect, and the detector of a perfect unit."""

import numpy as np

from vlp16emu.returns import Detector, Noise, Weather
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.sensor.beams import BEAM_TABLES
from vlp16emu.types import SURFACE, Firings, Hits, ReturnMode, SensorModel

LASERS = 16
ELEVATION_DEG = BEAM_TABLES[SensorModel.VLP_16].elevation_deg
DETECTOR = Detector.model_fields.keys()


def detector(noise=None, *, seed=1, mode=ReturnMode.DUAL, min_range_m=0.5, max_range_m=100.0, **own):
    """Detector of a perfect unit in dual return, but for what is given."""
    return UnitDetector.of_unit(
        Detector(**{key: own.pop(key) for key in DETECTOR & own.keys()}),
        noise if isinstance(noise, Noise) else Noise(**{"preset": "ideal", **(noise or {})}),
        Weather(**own),
        seed=seed,
        mode=mode,
        min_range_m=min_range_m,
        max_range_m=max_range_m,
        elevation_deg=ELEVATION_DEG,
        power_up_ns=0,
    )


def firings(k, index=0, t_ns=0):
    """Firing sequences of which only number and time matter."""
    zeros, times = np.zeros((k, LASERS, 3)), np.full((k, LASERS), t_ns, np.int64)
    return Firings(index, times, np.zeros(k, np.int64), zeros[..., 0], np.zeros(k), zeros, zeros, None)


def pulses(k, range_m, surface=None, cosine=1.0):
    """Hits of k * 16 pulses that all have the same sub-rays, each met by a surface of its own if none is
    given."""
    s, n = len(range_m), k * LASERS
    return Hits(
        np.full((k, LASERS), s, np.uint16),
        np.tile(np.asarray(range_m, np.float32), n),
        np.tile(np.arange(s) if surface is None else np.asarray(surface), n).astype(np.uint32),
        np.full(n * s, cosine, np.float32),
    )


def table(*reflectance):
    surfaces = np.zeros(len(reflectance), SURFACE)
    surfaces["reflectance"] = reflectance
    return surfaces
