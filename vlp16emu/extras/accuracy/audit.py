"""Comparison of a few pulses of a run with their converged answer while the run goes on.

In each block of firing sequences, eight consecutive sequences of two lasers are drawn: 0.05 % of a VLP-16's
pulses. The audit judges the hits of the run itself, so only the answers are cast. The seed and the block
determine the drawn pulses, so threads and order do not matter, and the run does not change. Errors are summed
as integers by cluster, so the sums do not depend on order or number of threads.
"""

import math
import threading
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Job, Unit
from vlp16emu.engine.windows import Batching
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry
from vlp16emu.returns.detect import detect
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.returns.settings import Detector
from vlp16emu.scenario import Scenario
from vlp16emu.types import F4, F8, I8, U1, Firings, Hits

FEWEST_CLUSTERS = 8  # clusters with errors; with fewer no interval is given
_STRONGEST = 0
_LAST = 1
_CONFIDENCE = 0.95
_UM = 1e-6
_HALF_LIGHT_M_PER_NS = 0.299792458 / 2.0


class Detections(NamedTuple):
    """Detections of n pulses; columns as in `Returns`."""

    distance_m: F4  # (n, 3), 0 if there is no such return
    reflectivity: U1  # (n, 3)


class Comparison(NamedTuple):
    """Comparison of pulses with the answer, by their strongest return unless noted."""

    pulses: int
    returns: int  # pulses with a return in the answer
    lost: int  # pulses with a return in the answer, but no detection
    invented: int  # pulses with a detection, but no return in the answer
    wrong_strongest: int  # pulses with another echo as the strongest
    wrong_last: int  # pulses with another echo as the last
    error_m: F8  # (k,) range errors of the matched pulses
    reflectivity_error: F8  # (k,) their reflectivity errors, in counts


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors over many pulses. Shares are relative to the answer's returns; a mean of no values is NaN."""

    pulses: int
    returns: int  # pulses with a return in the answer
    range_rmse_m: float
    """RMSE of strongest returns that match the answer's, like the next fields up to `range_p95_m`."""
    range_bias_m: float
    range_p95_m: float  # 95th percentile of absolute errors
    mean_error_m: float
    """Mean absolute error of all strongest returns; a lost or wrong return counts as the detector's
    resolution."""
    lost: float
    invented: float
    wrong_strongest: float
    wrong_last: float
    reflectivity_rmse: float  # in counts


def apart_m(detector: Detector) -> float:
    """Return the least range between two separate echoes: the resolution, or a pulse's width if greater."""
    return max(detector.resolution_m, _HALF_LIGHT_M_PER_NS * detector.pulse_ns)


def answer_beam(beam: Footprint, rays: int, seed: int, number: int = 0) -> Footprint:
    """Return the beam of an answer.

    Its sub-rays must differ from the judged ones, so each number has a seed of its own.
    """
    answer_seed = int(generator(seed, Purpose.AUDIT, number).integers(2**63))
    return replace(beam.with_settings(model="fixed", rays=rays), seed=answer_seed)


def detections_of(
    firings: Firings, hits: Hits, surfaces: NDArray[np.void], exact: UnitDetector
) -> Detections:
    """Detect all echoes of some pulses with a detector without noise, sorted by sequence, then by laser."""
    returns = detect(firings, hits, surfaces, exact, truth=False)
    return Detections(returns.distance_m.reshape(-1, 3), returns.reflectivity.reshape(-1, 3))


def compare(answer: Detections, detected: Detections, resolution_m: float) -> Comparison:
    """Compare the detections of n pulses with the answer.

    Ranges more than half a resolution apart belong to different echoes.
    """
    is_true = answer.distance_m[:, _STRONGEST] > 0
    is_detected = detected.distance_m[:, _STRONGEST] > 0
    off_m = detected.distance_m.astype(np.float64) - answer.distance_m
    is_other = (is_true & is_detected)[:, None] & (np.abs(off_m) > resolution_m / 2)
    matched = is_true & is_detected & ~is_other[:, _STRONGEST]
    counts = detected.reflectivity[:, _STRONGEST].astype(np.float64) - answer.reflectivity[:, _STRONGEST]
    return Comparison(
        pulses=len(is_true),
        returns=int(is_true.sum()),
        lost=int((is_true & ~is_detected).sum()),
        invented=int((is_detected & ~is_true).sum()),
        wrong_strongest=int(is_other[:, _STRONGEST].sum()),
        wrong_last=int(is_other[:, _LAST].sum()),
        error_m=off_m[matched, _STRONGEST],
        reflectivity_error=counts[matched],
    )


def errors_of(compared: Comparison, resolution_m: float) -> Errors:
    """Summarise a comparison that was made with `resolution_m`."""
    error_m = compared.error_m
    returns = compared.returns

    def share(count: float) -> float:
        """Return a count relative to the returns; NaN without returns."""
        return float(count / returns) if returns else np.nan

    return Errors(
        pulses=compared.pulses,
        returns=returns,
        range_rmse_m=_rms(error_m),
        range_bias_m=float(error_m.mean()) if len(error_m) else np.nan,
        range_p95_m=float(np.quantile(np.abs(error_m), 0.95)) if len(error_m) else np.nan,
        mean_error_m=share(float(np.abs(error_m).sum()) + (returns - len(error_m)) * resolution_m),
        lost=share(compared.lost),
        invented=share(compared.invented),
        wrong_strongest=share(compared.wrong_strongest),
        wrong_last=share(compared.wrong_last),
        reflectivity_rmse=_rms(compared.reflectivity_error),
    )


def _rms(values: F8) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


@dataclass(slots=True)
class Tally:
    """Sums over clusters of pulses so far; shares and ranges are defined as in `Errors`."""

    clusters: int = 0
    with_errors: int = 0  # clusters with any error of range
    pulses: int = 0
    returns: int = 0  # pulses with a return in the answer
    lost: int = 0
    invented: int = 0
    wrong_strongest: int = 0
    matched: int = 0
    matched_2: int = 0  # sum over clusters of the square of their number
    squares_um2: int = 0  # sum of squares of errors of range
    squares_2_um4: int = 0
    """Sum over clusters of the square of their sum, and below of its product with their number of matched."""
    squares_matched_um2: int = 0

    def add(self, compared: Comparison) -> None:
        """Add a cluster."""
        error_um = np.rint(compared.error_m / _UM).astype(np.int64)
        matched = len(error_um)
        squares_um2 = int(error_um @ error_um)
        self.clusters += 1
        self.with_errors += squares_um2 > 0
        self.pulses += compared.pulses
        self.returns += compared.returns
        self.lost += compared.lost
        self.invented += compared.invented
        self.wrong_strongest += compared.wrong_strongest
        self.matched += matched
        self.matched_2 += matched**2
        self.squares_um2 += squares_um2
        self.squares_2_um4 += squares_um2**2
        self.squares_matched_um2 += squares_um2 * matched

    def share(self, count: int) -> float | None:
        """Return a count as a share of the answer's returns; None without returns."""
        return count / self.returns if self.returns else None

    @property
    def range_rmse_m(self) -> float | None:
        """RMSE of strongest returns that match the answer's; None if there are none."""
        return _UM * math.sqrt(self.squares_um2 / self.matched) if self.matched else None

    @property
    def range_rmse_interval_m(self) -> tuple[float, float] | None:
        """95 % confidence interval of this RMSE over all pulses; None from too few clusters.

        The clusters are a sample. The mean square is a ratio of sums over clusters; its variance is the
        variance of the clusters about the ratio (Cochran, Sampling Techniques, 3rd ed. 1977, section 6.3).
        Squares have a skewed distribution, so Student's interval is on their logarithm, with a quarter of the
        degrees of freedom of the effective number of clusters. With 40 to 600 clusters and lognormal errors,
        91 to 96 % of intervals then contain the truth at sigma 0.5 and 0.8, and 87 to 90 % at 1.1, where few
        clusters dominate; intervals that miss it are too low.
        """
        if self.with_errors < FEWEST_CLUSTERS or self.range_rmse_m is None:
            return None
        from scipy.special import stdtrit  # here: the first packet must not wait for the import

        mean = self.squares_um2 / self.matched
        variation_um4 = self.squares_2_um4 - 2 * mean * self.squares_matched_um2 + mean**2 * self.matched_2
        # If all clusters have the same error, rounding may give a value slightly below zero.
        relative = math.sqrt(max(variation_um4, 0.0) * self.clusters / (self.clusters - 1)) / self.squares_um2
        effective_clusters = self.squares_um2**2 / self.squares_2_um4
        reach = relative * float(stdtrit(max(effective_clusters / 4, 1.0), 0.5 + _CONFIDENCE / 2))
        return self.range_rmse_m * math.exp(-reach / 2), self.range_rmse_m * math.exp(reach / 2)


_SEQUENCES = 8
_LASERS = 2
_RAYS = 512
_TIMES = 4
"""Sub-rays of an answer: at least the first number, and at least the second number times the sub-rays of a
pulse. With 512, the remaining error is a fifth of the error of pulses with 64, and 1/20 of the error of one
ray."""
_SAMPLED = ("fixed", "adaptive")


@dataclass(frozen=True, slots=True)
class AuditFinding:
    """Error of a run, estimated from pulses that are cast again.

    Shares are relative to returns, None if not known.
    """

    exact: bool  # a pulse is one ray, by the scene's own choice
    pulses: int  # pulses cast again
    range_rmse_m: float | None
    range_rmse_low_m: float | None  # lower end of the 95 % confidence interval of the error
    range_rmse_high_m: float | None
    lost: float | None
    invented: float | None
    other_echo: float | None  # share of returns whose strongest echo is another one


class Audit:
    """Audit of a run, called from any number of threads.

    It has no effect if the scene itself has one ray per pulse.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._apart_m = apart_m(scenario.detector)
        self.exact = scenario.beam.model not in _SAMPLED
        self._lock = threading.Lock()
        self.tally = Tally()  # errors so far, of all units

    @property
    def finding(self) -> AuditFinding:
        """Result so far."""
        tally = self.tally
        low_m, high_m = tally.range_rmse_interval_m or (None, None)
        return AuditFinding(
            exact=self.exact,
            pulses=tally.pulses,
            range_rmse_m=tally.range_rmse_m,
            range_rmse_low_m=low_m,
            range_rmse_high_m=high_m,
            lost=tally.share(tally.lost),
            invented=tally.share(tally.invented),
            other_echo=tally.share(tally.wrong_strongest),
        )

    def __call__(self, job: Job, firings: Firings, hits: Hits, geometry: Geometry) -> None:
        """Audit the pulses of whole or partial blocks, in the same geometry."""
        if self.exact:
            return
        unit = job.unit
        block = Batching(firings.t_ns.shape[1], unit.head.beams.sequence_ns).block
        index = firings.index
        for begin in range(index // block * block, index + len(firings.t_ns), block):
            self._audit(unit, firings, hits, geometry, begin, block)

    def _audit(
        self, unit: Unit, firings: Firings, hits: Hits, geometry: Geometry, begin: int, sequences: int
    ) -> None:
        """Audit the drawn pulses of the block that begins with sequence `begin`.

        Pulses that were not cast are left out.
        """
        lasers = firings.t_ns.shape[1]
        draw = generator(unit.seed, Purpose.AUDIT, unit.number, begin)
        first = begin + _SEQUENCES * int(draw.integers(sequences // _SEQUENCES)) - firings.index
        if not 0 <= first < len(firings.t_ns):
            return
        chosen = np.sort(draw.choice(lasers, min(_LASERS, lasers), replace=False))
        rows = slice(first, first + _SEQUENCES)
        part = _some_firings(firings, rows, chosen)
        exact = unit.detector.without_chance()
        beam = answer_beam(unit.beam, max(_RAYS, _TIMES * unit.beam.rays), unit.seed)
        answer = geometry.cast(part, unit.head.beams.near_m[chosen], unit.section.max_range_m, beam)
        found = _some_hits(hits, rows, chosen)
        true = detections_of(part, answer, geometry.surfaces, exact)
        detected = detections_of(part, found, geometry.surfaces, exact)
        compared = compare(true, detected, self._apart_m)
        with self._lock:
            self.tally.add(compared)


def _some_firings(firings: Firings, rows: slice, lasers: I8) -> Firings:
    """Return the firings of some lasers in some firing sequences."""
    arrays = {name: getattr(firings, name)[rows] for name in ("clock_ns", "reading_deg")}
    for name in ("t_ns", "azimuth_deg", "origin_m", "direction", "beam_axis"):
        array = getattr(firings, name)
        arrays[name] = None if array is None else np.ascontiguousarray(array[rows][:, lasers])
    return Firings(index=firings.index + rows.start, **arrays)


def _some_hits(hits: Hits, rows: slice, lasers: I8) -> Hits:
    """Return the hits of the pulses that `_some_firings` returns."""
    counts = hits.count[rows]
    before = int(hits.count[: rows.start].sum())
    stop = before + np.cumsum(counts, dtype=np.int64).reshape(counts.shape)
    count = np.ascontiguousarray(counts[:, lasers])
    last = stop[:, lasers].reshape(-1)
    first = last - count.reshape(-1)
    rays = np.concatenate([np.arange(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True)])
    return Hits(count, hits.range_m[rays], hits.surface[rays], hits.cos_incidence[rays])
