"""Ranges from the nearest to the farthest, from head-on to grazing, and their steps on the wire."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stability_cases.lab import PULSES, beam, cast, decoded_m, detected, opened, pulses, quads
from stability_cases.row import Row
from vlp16emu.packets import DISTANCE_LSB_M
from vlp16emu.types import Firings

Array = NDArray[np.float64]

_STRIP_M = 0.25
_FLOOR_M = 150.0
_FLOAT32 = 2.0**-23


def _strips(range_m: Array) -> tuple[Array, Firings]:
    """Upright strips side by side, one at each range, and a pulse head-on to each."""
    y_m = _STRIP_M * (np.arange(len(range_m)) - len(range_m) / 2)
    low, high = y_m, y_m + _STRIP_M
    side = np.ones(len(range_m))
    corners = [(range_m, low, -side), (range_m, high, -side), (range_m, high, side), (range_m, low, side)]
    origin_m = np.column_stack([0 * y_m, y_m + _STRIP_M / 2, 0 * y_m])
    ahead = np.tile([1.0, 0.0, 0.0], (len(range_m), 1))
    return np.stack([np.column_stack(corner) for corner in corners], axis=1), pulses(origin_m, ahead)


def every_range() -> Iterator[Row]:
    """Meet walls from 0.4 to 133 m, packed and decoded."""
    range_m = np.linspace(0.4, 133.0, 8 * PULSES)
    corners, firings = _strips(range_m)
    got_m = decoded_m(detected(opened([quads(corners)]), firings))
    seen = (range_m >= 0.5) & (range_m <= 131.07)
    error_m = np.abs(got_m - range_m)[seen].max()
    bound_m = DISTANCE_LSB_M / 2 + 131.07 * _FLOAT32
    yield Row("wall at 0.5 to 131.07 m, decoded", "largest error, m", float(error_m), bound_m)
    yield Row("wall at 0.4 to 0.5 m", "not blanked", float(got_m[range_m < 0.5].any()), 0)
    yield Row("wall beyond 131.07 m", "not lost", float(got_m[range_m > 131.07].any()), 0)


def grazing() -> Iterator[Row]:
    """Meet a floor at up to 89.99 degrees from its normal, 10 to 100 m away."""
    floor = [(-_FLOOR_M, -_FLOOR_M, 0), (_FLOOR_M, -_FLOOR_M, 0), (_FLOOR_M, _FLOOR_M, 0), (-_FLOOR_M, _FLOOR_M, 0)]
    scene = opened([quads(np.array([floor]))])
    for incidence_deg in (80.0, 89.0, 89.9, 89.99):
        cosine = np.cos(np.radians(incidence_deg))
        level = np.sqrt(1 - cosine**2)
        range_m = np.linspace(10.0, 100.0, PULSES)
        turned = np.linspace(0.0, 2 * np.pi, PULSES)
        origin_m = np.column_stack([0 * turned, 0 * turned, range_m * cosine])
        direction = np.column_stack([level * np.cos(turned), level * np.sin(turned), np.full(PULSES, -cosine)])
        firings = pulses(origin_m, direction)
        hits = cast(scene, firings)
        error_m = float(np.abs(hits.range_m - range_m).max())
        yield Row(f"floor at {incidence_deg:g} deg", "largest error, m", error_m, 4 * 100 * _FLOAT32)
        wide = detected(scene, firings, beam("adaptive"))
        fit = np.isfinite(wide.distance_m) & (wide.distance_m >= 0) & (wide.distance_m <= 131.07)
        yield Row(f"floor at {incidence_deg:g} deg, wide beam", "returns out of limits", float((~fit).sum()), 0)
