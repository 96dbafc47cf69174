"""Ranges from the nearest to the farthest, from head-on to grazing, and their steps on the wire."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stability_cases.lab import PULSES, beam, cast, decoded_m, detected, opened, pulses, quads
from stability_cases.row import Row
from vlp16emu.packets import DISTANCE_LSB_M, LASERS, data_fields, data_payloads
from vlp16emu.types import Firings, ReturnMode, Returns, SensorModel

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


def _returns(distance_m: NDArray[np.float32], reading_deg: Array) -> Returns:
    """Make returns of given distances (k, 16) and readings (k,)."""
    shape = (len(reading_deg), LASERS)
    zero = np.zeros((*shape, 3))
    firings = Firings(
        0, np.zeros(shape, np.int64), np.zeros(shape[0], np.int64), zero[..., 0], reading_deg, zero, zero, None
    )
    three_m = np.repeat(distance_m[..., None], 3, axis=2)
    return Returns(firings, three_m, np.zeros((*shape, 3), np.uint8), None, None)


def _packed(distance_m: NDArray[np.float32], reading_deg: Array) -> NDArray[np.void]:
    returns = _returns(distance_m, reading_deg)
    return data_fields(data_payloads(returns, ReturnMode.STRONGEST, SensorModel.VLP_16))


def distance_steps() -> Iterator[Row]:
    """Pack distances on, just below and just above each half step of 2 mm, against whole numbers.

    500 times a float32 is exact in float64, so `rint` of it is the code rounded half to even, whatever code divides by.
    """
    half = ((np.arange(250, 65_535) + 0.5) * DISTANCE_LSB_M).astype(np.float32)
    around = np.concatenate([np.nextafter(half, np.float32(0)), half, np.nextafter(half, np.float32(200))])
    distance_m = np.resize(around, (-(-len(around) // PULSES) * 24, LASERS))
    fields = _packed(distance_m, np.zeros(len(distance_m)))
    expected = np.rint(distance_m.astype(np.float64) * 500).ravel()
    wrong = int((fields["blocks"]["records"]["distance_lsb"].ravel() != expected).sum())
    ties = int((half.astype(np.float64) * 500 % 1 == 0.5).sum())
    yield Row(f"distances about each half step, {ties} on it", "codes not half to even", wrong, 0)


def azimuth_steps() -> Iterator[Row]:
    """Pack readings on each hundredth of a degree, a millionth of a degree below the next, and at the very wrap."""
    code = np.arange(36_000)
    wrap = np.nextafter(360.0, 0.0)
    reading_deg = np.concatenate([code / 100, (code + 1) / 100 - 1e-6, np.full(24, wrap)])
    expected = np.concatenate([code, code, np.zeros(24, np.int64)])
    fields = _packed(np.ones((2 * len(reading_deg), LASERS), np.float32), np.repeat(reading_deg, 2))
    wrong = int((fields["blocks"]["azimuth_cdeg"].ravel() != expected).sum())
    yield Row("readings on and below each 0.01 deg, and at 360", "codes not rounded down", wrong, 0)
