"""Errors of what was detected against the answer, summed up in whole numbers by cluster, so that neither order nor number matters.

And how sure they are.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FEWEST_CLUSTERS = 8
"""With errors in them; of fewer nothing is said."""
MISTAKES = ("lost", "invented", "wrong_strongest")
"""Of pulses, in `Comparison`, `Errors` and `Tally`."""
_STRONGEST, _LAST = 0, 1
_CONFIDENCE = 0.95
_UM = 1e-6


@dataclass(frozen=True, slots=True)
class Detections:
    """What a detector reports of n pulses; columns as in `Returns`."""

    distance_m: NDArray[np.float32]
    """(n, 3), 0 where there is no such return."""
    reflectivity: NDArray[np.uint8]
    """(n, 3)."""

    def __len__(self) -> int:
        return len(self.distance_m)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Pulse by pulse, (n,) each."""

    seen: NDArray[np.bool_]
    """Whether the answer has a return."""
    error_m: NDArray[np.float64]
    """Of the strongest return's range where it is the answer's, else NaN."""
    reflectivity_error: NDArray[np.float64]
    """Likewise, in counts."""
    lost: NDArray[np.bool_]
    """Whether the answer has a return and nothing was detected."""
    invented: NDArray[np.bool_]
    """Whether something was detected where the answer has nothing."""
    wrong_strongest: NDArray[np.bool_]
    """Whether another echo was taken for the strongest."""
    wrong_last: NDArray[np.bool_]
    """Whether another echo was taken for the last."""

    @property
    def matched(self) -> NDArray[np.bool_]:
        """Whether both mean the same echo by the strongest."""
        return self.seen & ~self.lost & ~self.wrong_strongest


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors over many pulses. Shares are of the answer's returns; NaN where there is nothing to take a mean of."""

    pulses: int
    returns: int
    """Pulses that have a return in the answer."""
    range_rmse_m: float
    """Of strongest returns that are the answer's, as all that follow up to `range_p95_m`."""
    range_bias_m: float
    range_p95_m: float
    """95 % of absolute errors are smaller."""
    mean_error_m: float
    """Mean absolute error of all strongest returns, a lost or wrong one counting as the detector's resolution."""
    lost: float
    invented: float
    wrong_strongest: float
    wrong_last: float
    reflectivity_rmse: float
    """In counts."""


def compare(answer: Detections, detected: Detections, resolution_m: float) -> Comparison:
    """Compare the detections of n pulses with the answer; ranges half a resolution apart are those of different echoes."""
    seen, got = answer.distance_m[:, _STRONGEST] > 0, detected.distance_m[:, _STRONGEST] > 0
    both = seen & got
    off_m = detected.distance_m.astype(np.float64) - answer.distance_m
    other = np.abs(off_m) > resolution_m / 2
    right = both & ~other[:, _STRONGEST]
    counts = detected.reflectivity[:, _STRONGEST].astype(np.float64) - answer.reflectivity[:, _STRONGEST]
    return Comparison(
        seen=seen,
        error_m=np.where(right, off_m[:, _STRONGEST], np.nan),
        reflectivity_error=np.where(right, counts, np.nan),
        lost=seen & ~got,
        invented=got & ~seen,
        wrong_strongest=both & other[:, _STRONGEST],
        wrong_last=both & other[:, _LAST],
    )


def errors_of(compared: Comparison, resolution_m: float) -> Errors:
    """Sum up a comparison; `resolution_m` is what it was made with."""
    error_m, counts = compared.error_m[compared.matched], compared.reflectivity_error[compared.matched]
    returns = int(compared.seen.sum())

    def share(of: NDArray[np.bool_]) -> float:
        return float(of.sum() / returns) if returns else np.nan

    lost_m = (returns - len(error_m)) * resolution_m
    return Errors(
        pulses=len(compared.seen),
        returns=returns,
        range_rmse_m=_rms(error_m),
        range_bias_m=float(error_m.mean()) if len(error_m) else np.nan,
        range_p95_m=float(np.quantile(np.abs(error_m), 0.95)) if len(error_m) else np.nan,
        mean_error_m=(float(np.abs(error_m).sum()) + lost_m) / returns if returns else np.nan,
        reflectivity_rmse=_rms(counts),
        **{name: share(getattr(compared, name)) for name in (*MISTAKES, "wrong_last")},
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


class Interval(NamedTuple):
    """Where a quantity lies with 95 % confidence."""

    low: float
    high: float


@dataclass(slots=True)
class Tally:
    """What was seen of clusters of pulses so far; shares and ranges are defined as in `Errors`."""

    clusters: int = 0
    with_errors: int = 0
    """Clusters whose ranges are wrong at all."""
    pulses: int = 0
    returns: int = 0
    """Pulses that have a return in the answer."""
    lost: int = 0
    invented: int = 0
    wrong_strongest: int = 0
    matched: int = 0
    matched_2: int = 0
    """Sum over clusters of the square of their number."""
    squares_um2: int = 0
    """Sum of squares of errors of range."""
    squares_2_um4: int = 0
    """Sum over clusters of the square of their sum, and below of its product with their number of matched."""
    squares_matched_um2: int = 0

    def add(self, compared: Comparison) -> None:
        """Add a cluster."""
        error_um = np.rint(compared.error_m[compared.matched] / _UM).astype(np.int64)
        matched, squares_um2 = len(error_um), int(error_um @ error_um)
        self.clusters += 1
        self.with_errors += squares_um2 > 0
        self.pulses += len(compared.seen)
        self.returns += int(compared.seen.sum())
        for name in MISTAKES:
            setattr(self, name, getattr(self, name) + int(getattr(compared, name).sum()))
        self.matched += matched
        self.matched_2 += matched**2
        self.squares_um2 += squares_um2
        self.squares_2_um4 += squares_um2**2
        self.squares_matched_um2 += squares_um2 * matched

    @property
    def range_rmse_m(self) -> float | None:
        """Of strongest returns that are the answer's; None where there are none."""
        return _UM * math.sqrt(self.squares_um2 / self.matched) if self.matched else None

    @property
    def range_rmse_interval_m(self) -> Interval | None:
        """Where that lies in the whole that the clusters are a sample of; None where they are too few.

        The mean square is a ratio of sums over clusters, whose variance is that of the clusters about the ratio
        (Cochran, Sampling Techniques, 3rd ed. 1977, section 6.3). Squares are lopsided, so Student's interval is laid
        on their logarithm, with a quarter of the degrees of freedom of as many clusters alike as carry the sum: of 40 to
        600 clusters with lognormal errors, 91 to 96 % of intervals then hold the truth at sigma 0.5 and 0.8, and 87 to 90 %
        at 1.1, where few clusters carry all; those that miss lie too low.
        """
        if self.with_errors < FEWEST_CLUSTERS or self.range_rmse_m is None:
            return None
        from scipy.special import stdtrit  # here: the first packet need not wait for it

        mean = self.squares_um2 / self.matched
        away = self.squares_2_um4 - 2 * mean * self.squares_matched_um2 + mean**2 * self.matched_2
        # Where all clusters have the same error, rounding may leave a hair less than nothing.
        relative = math.sqrt(max(away, 0.0) * self.clusters / (self.clusters - 1)) / self.squares_um2
        carrying = self.squares_um2**2 / self.squares_2_um4
        reach = relative * float(stdtrit(max(carrying / 4, 1.0), 0.5 + _CONFIDENCE / 2))
        return Interval(self.range_rmse_m * math.exp(-reach / 2), self.range_rmse_m * math.exp(reach / 2))
