"""Echoes at the limits: of resolution, of pulse width, of light, and of the number of sub-rays."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stability_cases.lab import PULSES, beam, decoded_m, detected, ideal_unit, opened, pulses, unit_of, wall
from stability_cases.row import Row, refused
from vlp16emu.packets import LASERS
from vlp16emu.returns.detect import detect
from vlp16emu.returns.settings import Detector
from vlp16emu.scenario import load
from vlp16emu.types import SURFACE, Firings, Hits

Array = NDArray[np.float64]

_FIRST_M = 40.0
_DUAL = "sensor.return_mode=dual"


def _level(n: int) -> Firings:
    return pulses(np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0], (n, 1)))


def _two_echoes_m(step_m: NDArray[np.floating[Any]], reflectance: tuple[float, float], *settings: str) -> Array:
    """Detect pulses of which each half meets a plate, the second one a step behind the first: returns (n, 3)."""
    n = len(step_m)
    range_m = np.stack([np.full(n, _FIRST_M), _FIRST_M + step_m], axis=1).astype(np.float32)
    hits = Hits(
        np.full((n // LASERS, LASERS), 2, np.uint16),
        range_m.ravel(),
        np.tile(np.array([0, 1], np.uint32), n),
        np.ones(2 * n, np.float32),
    )
    surfaces = np.zeros(2, SURFACE)
    surfaces["reflectance"] = reflectance
    detector = ideal_unit(_DUAL, *settings).detector
    return detect(_level(n), hits, surfaces, detector, truth=False).distance_m.reshape(-1, 3).astype(np.float64)


def _parted(returns_m: Array) -> NDArray[np.bool_]:
    return np.asarray((returns_m[:, 1] != returns_m[:, 0]) | (returns_m[:, 2] > 0))


def merge_limits() -> Iterator[Row]:
    """Draw two plates apart, by tenths of a millimetre about each limit."""
    resolution_m = Detector().resolution_m
    step_m = resolution_m + 1e-4 * (np.arange(8 * PULSES) - 4 * PULSES)
    returns_m = _two_echoes_m(step_m, (0.5, 0.5))
    two = _parted(returns_m)
    yield Row("echoes at the resolution", "changes from one to two, less one", abs(np.diff(two).sum() - 1), 0)
    other_m = np.where(returns_m[:, 2] > 0, returns_m[:, 2], returns_m[:, 1])
    apart_m = np.abs(other_m - returns_m[:, 0])[two].min()
    yield Row(
        "echoes at the resolution", "least distance of two less the resolution, m", abs(apart_m - resolution_m), 1e-3
    )

    sigma_m = ideal_unit().detector.constants.sigma_m
    step_m = 2 * sigma_m + 1e-4 * (np.arange(4 * PULSES) - 2 * PULSES)
    even = 0.5, 0.5 * ((_FIRST_M + 2 * sigma_m) / _FIRST_M) ** 2
    two = _parted(_two_echoes_m(step_m, even, "detector.resolution_m=0"))
    yield Row("echoes of one hump", "changes from one to two, less one", abs(np.diff(two).sum() - 1), 0)
    limit_m = step_m[two].min()
    yield Row("echoes of one hump", "step where it parts, less two sigmas, m", abs(limit_m - 2 * sigma_m), 2e-3)


def dark() -> Iterator[Row]:
    """Light up what sends nothing back: black, edge-on, and into the sky."""
    lights = {"one ray": beam("none"), "64 rays": beam("fixed"), "adaptive": beam("adaptive")}
    typical = unit_of("static_bench", "noise.preset=typical", "noise.range_bias_m=0")
    for name, light in lights.items():
        black = opened([wall(10.0)], reflectance=0.0)
        perfect = detected(black, _level(PULSES), light)
        bright = int(perfect.reflectivity.max())
        error_m = float(np.abs(perfect.distance_m[..., 0] - 10.0).max())
        yield Row(f"black wall, {name}", "reflectivity, perfect unit", bright, 0)
        yield Row(f"black wall, {name}", "error, m, perfect unit", error_m, 1e-3)
        usual = detected(black, _level(PULSES), light, typical)
        yield Row(f"black wall, {name}", "returns, usual unit", int((usual.distance_m > 0).sum()), 0)
        sky = detected(opened([wall(-10.0)]), _level(PULSES), light)
        nothing = (sky.distance_m == 0).all() and (sky.reflectivity == 0).all()
        yield Row(f"open sky, {name}", "not empty", float(not nothing), 0)


def few_rays() -> Iterator[Row]:
    """Try a footprint of one ray, and footprints without width."""
    rng = np.random.default_rng(5)
    direction = np.column_stack([np.ones(PULSES), rng.uniform(-0.3, 0.3, (PULSES, 2))])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    firings, scene = pulses(np.zeros((PULSES, 3)), direction), opened([wall(10.0)])
    line_m = decoded_m(detected(scene, firings))
    for rays in (1, 2, 64):
        for model in ("fixed", "adaptive"):
            moved_m = np.abs(decoded_m(detected(scene, firings, beam(model, rays, has_width=False))) - line_m).max()
            yield Row(f"{model} beam of {rays} without width", "moved from one ray's, m", float(moved_m), 0.002)
    one = detected(scene, firings, beam("fixed", 1))
    true_m = 10.0 / direction[:, 0].reshape(one.firings.t_ns.shape)
    off_m = np.abs(one.distance_m[..., 0] - true_m)
    yield Row("fixed beam of 1, with width", "largest error, m", float(off_m.max()), 0.02)
    yield refused("fixed beam of 1 in a scene", lambda: load("static_bench", ["beam.rays=1"]), "from 2 to")
