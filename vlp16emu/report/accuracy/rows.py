"""Error against run time: what was measured of each setting, and what follows for the choice of one."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from vlp16emu.report.accuracy.distributions import Distributions
from vlp16emu.report.accuracy.errors import Errors

__all__ = ["Accuracy", "Choice", "Fit", "Kind", "Rounding", "Row", "choices", "fitted_order", "front"]

WANTED_M = (0.5, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01)


class Kind(StrEnum):
    """What a setting is about."""

    ONE_RAY = "one ray"
    FIXED = "fixed"
    ADAPTIVE = "adaptive"
    BEAM_ERROR = "beam error"
    POSE = "pose"


@dataclass(frozen=True, slots=True)
class Row:
    """One setting."""

    kind: Kind
    name: str
    """Of light, as `--set` takes it."""
    in_use: bool
    """Whether it is that of the scene."""
    errors: Errors
    us_per_pulse: float
    """Run time on one core: that of casting and detecting, of poses that of posing and aiming."""
    us_spread: float
    """Between the quickest and the slowest repeat."""
    rays_per_pulse: float


@dataclass(frozen=True, slots=True)
class Rounding:
    """What float32 does to ranges: single rays, with the place on the surface that was met found anew in float64."""

    rays: int
    range_rmse_m: float
    range_max_m: float
    """Of rays that are not `elsewhere`, likewise the RMSE."""
    elsewhere: float
    """Share of rays that do not meet that surface within 1 mm of the same range in float64: they graze an edge."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What is known of a scene's errors."""

    scene: str
    seed: int
    answer_rays: int
    """Sub-rays of the answer that all is held against."""
    answer_rmse_m: float
    """Its own error, from two answers with different sub-rays."""
    rows: tuple[Row, ...]
    poses: tuple[Row, ...]
    """Held poses, each against a pose per pulse with the light of the answer; none where nothing moves."""
    rounding: Rounding
    distributions: Distributions | None = None
    """The world with a medium beyond some range against the explicit one; None of a hall."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A power law: mean error = `at_1_us_m` times run time in microseconds per pulse to the power of -`order`."""

    order: float
    at_1_us_m: float


@dataclass(frozen=True, slots=True)
class Choice:
    """The quickest setting whose error is small enough."""

    wanted_m: float
    row: Row


def front(rows: Sequence[Row]) -> list[Row]:
    """Rows of which no other is at once as quick and less wrong, by their mean errors; the quickest first.

    The paper's beam errors do not count: they are there to be compared with, and nobody should choose them.
    """
    best, kept = np.inf, list[Row]()
    for row in sorted(_to_choose(rows), key=lambda row: (row.us_per_pulse, row.errors.mean_error_m)):
        if row.errors.mean_error_m < best:
            best = row.errors.mean_error_m
            kept.append(row)
    return kept


def fitted_order(rows: Sequence[Row], kind: Kind) -> Fit | None:
    """Fit how the mean error of a kind falls; None of fewer than three settings, or where none costs twice another."""
    points = [(row.us_per_pulse, row.errors.mean_error_m) for row in rows if row.kind is kind]
    points = [point for point in points if point[1] > 0]
    if len(points) < 3 or max(points)[0] < 2 * min(points)[0]:
        return None
    us, error_m = np.log(np.array(points)).T
    slope, height = np.polyfit(us, error_m, 1)
    return Fit(order=float(-slope), at_1_us_m=float(np.exp(height)))


def choices(rows: Sequence[Row]) -> list[Choice]:
    """Tell what to take for some wanted mean errors; each setting once, for the least that it is good for."""
    found: dict[str, Choice] = {}
    for wanted_m in WANTED_M:
        good = [row for row in _to_choose(rows) if row.errors.mean_error_m <= wanted_m]
        if good:
            row = min(good, key=lambda row: row.us_per_pulse)
            found[row.name] = Choice(wanted_m, row)
    return list(found.values())


def _to_choose(rows: Sequence[Row]) -> list[Row]:
    """Leave out what is there only to be compared with."""
    return [row for row in rows if row.kind is not Kind.BEAM_ERROR]
