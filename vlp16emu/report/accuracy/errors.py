"""What is wrong with what was told of pulses, held against the answer."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Comparison", "Errors", "Told", "compare", "errors_of"]

_STRONGEST, _LAST = 0, 1


@dataclass(frozen=True, slots=True)
class Told:
    """What a detector told of n pulses; columns as in `Returns`."""

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
    """Whether the answer has a return and nothing was told."""
    invented: NDArray[np.bool_]
    """Whether something was told where the answer has nothing."""
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
    """Pulses of which the answer has a return."""
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


def compare(answer: Told, told: Told, resolution_m: float) -> Comparison:
    """Hold what was told of n pulses against the answer.

    Parameters
    ----------
    resolution_m : of the detector. Ranges that differ by more than half of it are those of different echoes.
    """
    seen, got = answer.distance_m[:, _STRONGEST] > 0, told.distance_m[:, _STRONGEST] > 0
    both = seen & got
    off_m = told.distance_m.astype(np.float64) - answer.distance_m
    other = np.abs(off_m) > resolution_m / 2
    right = both & ~other[:, _STRONGEST]
    counts = told.reflectivity[:, _STRONGEST].astype(np.float64) - answer.reflectivity[:, _STRONGEST]
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
        """Share of the returns."""
        return float(of.sum() / returns) if returns else np.nan

    return Errors(
        pulses=len(compared.seen),
        returns=returns,
        range_rmse_m=_rms(error_m),
        range_bias_m=float(error_m.mean()) if len(error_m) else np.nan,
        range_p95_m=float(np.quantile(np.abs(error_m), 0.95)) if len(error_m) else np.nan,
        mean_error_m=(
            (float(np.abs(error_m).sum()) + (returns - len(error_m)) * resolution_m) / returns
            if returns
            else np.nan
        ),
        lost=share(compared.lost),
        invented=share(compared.invented),
        wrong_strongest=share(compared.wrong_strongest),
        wrong_last=share(compared.wrong_last),
        reflectivity_rmse=_rms(counts),
    )


def _rms(values: NDArray[np.float64]) -> float:
    """Root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan
