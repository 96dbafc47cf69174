"""Features of a window that nobody chose: every field, along every axis, by every class.

A field is the range, the code, silence, or the code of a no-return. An axis is the laser (to the next firing
sequence, and the one after), the column (to the next laser by elevation), or the turn (to the same azimuth
one turn later). Differences are counted in classes of powers of two, with their parity; runs of equal values
by length; each for all values and for classes of code and of range.
"""

from collections.abc import Iterator

import numpy as np
from unmask_windows import UPWARDS, Array, Features, Window

CODES = np.array([0, 1, 2, 4, 8, 12, 20, 30, 45, 60, 80, 100, 101, 256])
CODE_CLASSES = np.array([4, 12, 30, 60, 100])
RANGE_CLASSES_LSB = np.array([500, 1000, 2000, 4000, 8000])  # 1, 2, 4, 8 and 16 m
RANGE_STEPS = np.array([0, 1, 2, 3, 4, 5, 6, 8, 11, 16, 23, 32, 64, 256, 1024])
CODE_STEPS = np.array([0, 1, 2, 3, 4, 5, 6, 8, 11, 16, 32, 64])
RUNS = np.array([1, 2, 3, 4, 6, 11, 31])
NO_RETURN_STEPS = np.array([0, 1, 2, 3, 5, 9, 17, 33, 65])
SURFACE_LSB = 20
LEAST = 100
"""Least number of values of a histogram."""


class Axis:
    """Pairs of records, from each to another along one axis."""

    def __init__(self, name: str, first: tuple[Array, ...], second: tuple[Array, ...]) -> None:
        self.name = name
        self.d, self.r = first
        self.other_d, self.other_r = second
        self.returned = (self.d > 0) & (self.other_d > 0)
        self.silent = (self.d == 0) & (self.other_d == 0)


def axes_of(window: Window) -> Iterator[Axis]:
    """Yield the axes of a window; the turn is left out where the capture ends within it."""
    d, r = (v[:, UPWARDS] for v in (window.sequences.distance_lsb, window.sequences.reflectivity))
    for lag in (1, 2):
        yield Axis(f"next_{lag}", (d[:-lag], r[:-lag]), (d[lag:], r[lag:]))
    yield Axis("up", (d[:, :-1], r[:, :-1]), (d[:, 1:], r[:, 1:]))
    inside = window.later < len(window.whole.number)
    later = window.later[inside]
    after = (v[later][:, UPWARDS] for v in (window.whole.distance_lsb, window.whole.reflectivity))
    yield Axis("turn", (d[inside], r[inside]), tuple(after))


def machine_features(window: Window) -> Features:
    """Return the features of a window; the part of a name before its first dot is the field."""
    out = Features()
    d, r = window.sequences.distance_lsb, window.sequences.reflectivity
    for axis in axes_of(window):
        _range_steps(out, axis)
        _code_steps(out, axis)
        _silences(out, axis)
        _no_returns(out, axis)
    _bends(out, d, r)
    _runs(out, d, r)
    _values(out, d, r)
    _readings(out, window)
    return out


def _classed(name: str, code: Array, range_lsb: Array, chosen: Array) -> Iterator[tuple[str, Array]]:
    """Yield name and mask of all chosen records, and of each class of code and of range."""
    yield name, chosen
    by_code, by_range = np.searchsorted(CODE_CLASSES, code), np.searchsorted(RANGE_CLASSES_LSB, range_lsb)
    for which in range(len(CODE_CLASSES) + 1):
        yield f"{name}.code_{which}", chosen & (by_code == which)
    for which in range(len(RANGE_CLASSES_LSB) + 1):
        yield f"{name}.range_{which}", chosen & (by_range == which)


def _shares(out: Features, name: str, of: Array, edges: Array) -> None:
    """Add a histogram of values by the lower ends of its classes; NaN for too few values."""
    counts = np.bincount(np.searchsorted(edges, of, side="right"), minlength=len(edges) + 1)[1:]
    total = counts.sum() if counts.sum() >= LEAST else np.nan
    out.update({f"{name}.{low}": float(count / total) for low, count in zip(edges, counts, strict=True)})


def _share(out: Features, name: str, of: Array) -> None:
    out[name] = float(of.mean()) if of.size >= LEAST else np.nan


def _range_steps(out: Features, axis: Axis) -> None:
    """Add differences of range, with their parity where they are small."""
    step = np.abs(axis.other_d - axis.d)
    for name, chosen in _classed(f"range.{axis.name}", axis.r, axis.d, axis.returned):
        _shares(out, name, step[chosen], RANGE_STEPS)
        near = chosen & (step < SURFACE_LSB)
        _share(out, f"{name}.odd", step[near] % 2 == 1)
        _share(out, f"{name}.odd_at_equal_code", step[near & (axis.r == axis.other_r)] % 2 == 1)


def _code_steps(out: Features, axis: Axis) -> None:
    """Add differences of code, on one surface."""
    on_surface = axis.returned & (np.abs(axis.other_d - axis.d) < SURFACE_LSB)
    step = np.abs(axis.other_r - axis.r)
    for name, chosen in _classed(f"code.{axis.name}", axis.r, axis.d, on_surface):
        _shares(out, name, step[chosen], CODE_STEPS)
        _share(out, f"{name}.odd", step[chosen & (step < 16)] % 2 == 1)


def _silences(out: Features, axis: Axis) -> None:
    """Add the share of records lost beside returns, and of losses that recur."""
    for name, chosen in _classed(f"loss.{axis.name}", axis.r, axis.d, axis.d > 0):
        _share(out, name, axis.other_d[chosen] == 0)
    _share(out, f"loss.{axis.name}.again", axis.other_d[axis.d == 0] == 0)


def _no_returns(out: Features, axis: Axis) -> None:
    """Add differences of the codes of no-returns."""
    step = np.abs(axis.other_r - axis.r)[axis.silent]
    _shares(out, f"no_return.{axis.name}", step, NO_RETURN_STEPS)


def _bends(out: Features, d: Array, r: Array) -> None:
    """Add second differences along a laser on one surface, and losses between two returns."""
    flat = (d[:-2] > 0) & (d[1:-1] > 0) & (d[2:] > 0)
    flat &= (np.abs(d[1:-1] - d[:-2]) < SURFACE_LSB) & (np.abs(d[2:] - d[1:-1]) < SURFACE_LSB)
    range_bend, code_bend = (np.abs(np.diff(v, 2, axis=0)) for v in (d, r))
    for name, chosen in _classed("range.bend", r[1:-1], d[1:-1], flat):
        _shares(out, name, range_bend[chosen], RANGE_STEPS[:12])
    for name, chosen in _classed("code.bend", r[1:-1], d[1:-1], flat):
        _shares(out, name, code_bend[chosen], CODE_STEPS)
    both = (d[:-2] > 0) & (d[2:] > 0)
    step, change = np.abs(d[2:] - d[:-2]), np.abs(r[2:] - r[:-2])
    lost = d[1:-1] == 0
    for name, chosen in _classed("loss.between", r[:-2], d[:-2], both & (step < SURFACE_LSB)):
        _share(out, name, lost[chosen])
        _share(out, f"{name}.even_code", lost[chosen & (change < 5)])
    for low, high in zip(RANGE_STEPS[7:], [*RANGE_STEPS[8:], 65_536], strict=True):
        _share(out, f"loss.between.step_{low}", lost[both & (step >= low) & (step < high)])


def _runs(out: Features, d: Array, r: Array) -> None:
    """Add lengths of runs of silence, of returns, and of equal codes and ranges, along a laser."""
    kinds = {
        "loss.run": (d == 0, None),
        "loss.run_of_returns": (d > 0, None),
        "code.run": (d > 0, r),
        "range.run": (d > 0, d),
        "no_return.run": (d == 0, r),
    }
    for name, (valid, value) in kinds.items():
        lengths = [_lengths(valid[:, i], None if value is None else value[:, i]) for i in range(16)]
        _shares(out, name, np.concatenate(lengths), RUNS)


def _lengths(valid: Array, value: Array | None) -> Array:
    """Return lengths of runs of valid values, equal ones if values are given, without both ends."""
    change = valid[1:] != valid[:-1]
    if value is not None:
        change = change | (valid[1:] & (value[1:] != value[:-1]))
    edge = np.nonzero(change)[0] + 1
    return np.diff(edge)[valid[edge[:-1]]]


def _values(out: Features, d: Array, r: Array) -> None:
    """Add codes by range, residues of codes and ranges, and codes of no-returns."""
    returned, silent = d > 0, d == 0
    for name, chosen in _classed("code.value", r, d, returned):
        if ".code_" not in name:
            _shares(out, name, r[chosen], CODES)
        for modulus in (2, 3, 4):
            _shares(out, f"{name}.mod_{modulus}", r[chosen & (r < 100)] % modulus, np.arange(modulus))
    for name, chosen in _classed("range.value", r, d, returned):
        for modulus in (2, 4, 5):
            _shares(out, f"{name}.mod_{modulus}", d[chosen] % modulus, np.arange(modulus))
    _shares(out, "loss.silent", silent.ravel().astype(int), np.arange(2))
    _shares(out, "no_return.value", r[silent], CODES)
    for modulus in (2, 3):
        _shares(out, f"no_return.value.mod_{modulus}", r[silent] % modulus, np.arange(modulus))
    odd = [(d[:, i][returned[:, i]] % 2).mean() for i in range(16) if returned[:, i].sum() >= LEAST]
    out["range.odd_over_lasers"] = float(np.std(odd)) if len(odd) >= 4 else np.nan


def _readings(out: Features, window: Window) -> None:
    """Add differences of azimuths and stamps, of first and second order, and their residues."""
    azimuth = window.sequences.azimuth_cdeg
    step = np.diff(azimuth)
    middle = int(np.floor(step.mean()))
    for lag in (1, 2, 3, 4):
        over = azimuth[lag:] - azimuth[:-lag] - lag * middle
        _shares(out, f"azimuth.next_{lag}", over.clip(-8, 12), np.arange(-8, 13))
    _shares(out, "azimuth.bend", np.diff(step).clip(-8, 8), np.arange(-8, 9))
    for modulus in (2, 5, 10):
        _shares(out, f"azimuth.mod_{modulus}", azimuth % modulus, np.arange(modulus))
    stamp_us = window.sequences.clock_ns // 1000
    step_us = np.diff(stamp_us)
    for which in (0, 1):
        at = step_us - step_us.min() == which
        out[f"stamp.step_{which}"] = float(at.mean())
    out["stamp.odd"] = float((stamp_us % 2).mean())
    out["stamp.equal_steps"] = float((step_us[1:] == step_us[:-1]).mean())
