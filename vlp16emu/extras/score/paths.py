"""Errors of a trajectory, computed by evo."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError
from vlp16emu.extras.clouds.deskew import Trajectory
from vlp16emu.extras.clouds.epochs import ClockOffset, clock_offset
from vlp16emu.extras.recorded.files import RecordedPoses, read_kitti, read_tum
from vlp16emu.libraries import of_extra
from vlp16emu.types import F8, I8
from vlp16emu.units import MS_NS, S_NS, seconds_to_ns

if TYPE_CHECKING:  # it takes 0.1 s to load
    from scipy.spatial.transform import Rotation

RPE_DELTA_M = 1.0  # length of path for relative errors, short enough for short walks
DRIFT_M = (10.0, 100.0)
"""Lengths of path for drift; KITTI's are 100 to 800 m (Geiger et al., CVPR 2012, section 3.2)."""
_MOST_OFFSET_NS = 300 * MS_NS  # three sweeps, and the step of the search
_OFFSET_STEP_NS = 10 * MS_NS
_MOST_LATE_NS = 10 * S_NS  # a program that waits for its initialisation begins so much later (assumption)
_LATE_STEP_NS = 50 * MS_NS  # the step of that search: a tenth of a pace
_LEAST_STEP_NS = 100 * MS_NS
_MOST_STEPS = 500
_MOST_SHOWN = 1000  # greatest number of poses, and of drifts, in a report
_LEAST_POSES = 10
_FLAT_M = 1e-4
"""With fewer poses, or a motion this uniform, the offset of stamps is not determined."""


@dataclass(frozen=True, slots=True)
class PathErrors:
    """Errors along a path, at most `_MOST_SHOWN` values spread evenly over all poses.

    Times count from the first pose.
    """

    time_s: list[float]
    distance_m: list[float]  # along the true path
    true_x_m: list[float]
    true_y_m: list[float]
    true_z_m: list[float]
    found_x_m: list[float]  # of the aligned estimate
    found_y_m: list[float]
    found_z_m: list[float]
    error_m: list[float]  # of the position
    drift_over_m: float  # length of path of the drifts below
    drift_at_m: list[float]  # distance along the true path at the end of such a length
    drift_percent: list[float]  # relative error of the position over it


@dataclass(frozen=True, slots=True)
class PathScores:
    """Scores of a trajectory, and the errors behind them."""

    scores: dict[str, float]
    poses: int
    left_out: int  # poses outside the time of the ground truth
    errors: PathErrors
    clock: ClockOffset | None  # offset subtracted from the stamps; None if none was asked for


def on_truth_clock(
    found: RecordedPoses, true: Trajectory, time_offset_s: float | None
) -> tuple[RecordedPoses, ClockOffset | None]:
    """Return an estimate with its stamps on the truth's clock, and the offset subtracted from them.

    If no offset is given (None), the clock is that of `clock_offset`, moved by the offset within
    `_MOST_LATE_NS` with which the steps of the estimate agree best with the true ones. If the motion is too
    uniform for that, it is that of `clock_offset`.
    """
    if time_offset_s is not None:
        clock = ClockOffset(seconds_to_ns(time_offset_s), "as given")
        return _earlier(found, clock.offset_ns), clock if time_offset_s else None
    clock = clock_offset((int(found.t_ns[0]), int(found.t_ns[-1])), true.span_ns)
    moved = _earlier(found, clock.offset_ns)
    moved = _earlier(moved, -_agreeing_offset_ns(moved, true))
    rest_s = stamp_offset_s(moved, true)
    if math.isnan(rest_s):
        description = f"{clock.clock}; the motion is too uniform for more"
    else:
        moved = _earlier(moved, -seconds_to_ns(rest_s))
        description = f"{clock.clock}, then by steps that agree"
    return moved, ClockOffset(int(found.t_ns[0] - moved.t_ns[0]), description)


def _earlier(found: RecordedPoses, offset_ns: int) -> RecordedPoses:
    """Return poses with stamps that are earlier by an offset."""
    return replace(found, t_ns=found.t_ns - offset_ns)


def _agreeing_offset_ns(found: RecordedPoses, true: Trajectory) -> int:
    """Return the time to add to an estimate's stamps, within `_MOST_LATE_NS`, so that its steps agree best.

    Steps of `_LEAST_STEP_NS` or more are compared, at most `_MOST_STEPS` of them; half or more must be within
    the truth. The result is 0 for too few.
    """
    ends = np.searchsorted(found.t_ns, found.t_ns + _LEAST_STEP_NS)
    begins = np.flatnonzero(ends < len(found.t_ns))
    if len(begins) < _LEAST_POSES:
        return 0
    begins = begins[np.linspace(0, len(begins) - 1, min(len(begins), _MOST_STEPS)).astype(np.int64)]
    offsets_ns = np.arange(-_MOST_LATE_NS, _MOST_LATE_NS + 1, _LATE_STEP_NS)
    least_steps = max(_LEAST_POSES, len(begins) / 2)
    unlike = _unlike_by_offset(found, true, (begins, ends[begins]), offsets_ns, least_steps)
    known = unlike[np.isfinite(unlike)]
    return int(offsets_ns[unlike.argmin()]) if len(known) and np.ptp(known) > _FLAT_M else 0


def score_path(
    file: Path, times: Path | None, truth: Path, unit: int, alignment: str, time_offset_s: float | None = 0.0
) -> PathScores:
    """Compare a trajectory with the ground truth, which is interpolated to the trajectory's stamps.

    TrajectoryError, InputError if one of them is no trajectory, or they have fewer than three instants in
    common.

    The file is TUM, or KITTI if `times` has a time in seconds for each pose; truth and unit are as in
    `Trajectory`. The time offset is subtracted from the stamps; None finds it as `on_truth_clock` does.

    Scores are `ate_m` RMSE of positions, `ate_max_m`, `rpe_m` and `rpe_deg` RMSE over `RPE_DELTA_M` of path;
    `drift_10m_percent` and `drift_100m_percent`, the mean relative error of positions over such lengths, NaN
    on a shorter path; `stamp_offset_s` to add to the estimate's stamps, NaN if the motion is too uniform to
    determine it.
    """
    with of_extra("score", "scoring a trajectory"):
        from evo.core import metrics
    found = read_tum(file) if times is None else read_kitti(file, times)
    true = Trajectory(truth, unit)
    found, clock = on_truth_clock(found, true, time_offset_s)
    inside = true.has(found.t_ns)
    if inside.sum() < 3:
        begin_s, end_s = true.span_s
        raise InputError(
            str(file),
            f"found poses from {found.t_ns[0] / S_NS:.3f} to {found.t_ns[-1] / S_NS:.3f} s",
            f"at least three within the truth, {begin_s:.3f} to {end_s:.3f} s (see --time-offset)",
        )
    pair = _align(found, inside, true, alignment)
    places = metrics.PoseRelation.translation_part
    turns = metrics.PoseRelation.rotation_angle_deg
    over = {"delta": RPE_DELTA_M, "delta_unit": metrics.Unit.meters, "all_pairs": True}
    ate_m, errors_m = _errors(metrics.APE(places), pair)
    scores = {
        "ate_m": ate_m,
        "ate_max_m": float(errors_m.max()),
        "rpe_m": _errors(metrics.RPE(places, **over), pair)[0],
        "rpe_deg": _errors(metrics.RPE(turns, **over), pair)[0],
    }
    drifts = [metrics.RPE(places, **over | {"delta": length_m}) for length_m in DRIFT_M]
    for drift, length_m in zip(drifts, DRIFT_M, strict=True):
        scores[f"drift_{length_m:g}m_percent"] = 100.0 * float(np.mean(_errors(drift, pair)[1])) / length_m
    scores["stamp_offset_s"] = stamp_offset_s(found, true)
    errors = _path_errors(pair, errors_m, drifts[0])
    return PathScores(scores, int(inside.sum()), int((~inside).sum()), errors, clock)


def _path_errors(pair: Any, error_m: F8, drift: Any) -> PathErrors:
    """Return the errors along the path of a pair of evo's trajectories.

    `drift` is evo's RPE over `DRIFT_M[0]` of path, after `process_data`.
    """
    reference, estimate = pair
    true_m = reference.positions_xyz
    found_m = estimate.positions_xyz
    distance_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true_m, axis=0), axis=1))])
    ends = np.array(getattr(drift, "delta_ids", []), np.int64)
    drift_percent = 100.0 * np.asarray(drift.error if len(ends) else [], np.float64) / DRIFT_M[0]
    return PathErrors(
        time_s=_some(reference.timestamps - reference.timestamps[0]),
        distance_m=_some(distance_m),
        true_x_m=_some(true_m[:, 0]),
        true_y_m=_some(true_m[:, 1]),
        true_z_m=_some(true_m[:, 2]),
        found_x_m=_some(found_m[:, 0]),
        found_y_m=_some(found_m[:, 1]),
        found_z_m=_some(found_m[:, 2]),
        error_m=_some(error_m),
        drift_over_m=DRIFT_M[0],
        drift_at_m=_some(distance_m[ends]),
        drift_percent=_some(drift_percent),
    )


def _some(values: F8) -> list[float]:
    """Return at most `_MOST_SHOWN` values of (n,), evenly spread, rounded to four decimals."""
    rows = np.unique(np.linspace(0, len(values) - 1, min(len(values), _MOST_SHOWN)).astype(np.int64))
    return np.round(values[rows], 4).tolist() if len(values) else []


def _errors(metric: Any, pair: Any) -> tuple[float, F8]:
    """Return RMSE and errors (n,) by a metric of evo, NaN if the pair of trajectories has none."""
    from evo.core.filters import FilterException
    from evo.core.metrics import MetricsException, StatisticsType

    try:
        metric.process_data(pair)
    except (FilterException, MetricsException):
        return math.nan, np.array([math.nan])
    return float(metric.get_statistic(StatisticsType.rmse)), np.asarray(metric.error)


def stamp_offset_s(found: RecordedPoses, true: Trajectory) -> float:
    """Return the offset to add to the estimate's stamps, with which its steps agree best with the true ones.

    Steps between poses need no alignment, and the swing of each pace marks its time. NaN for too few poses or
    too uniform a motion.
    """
    inside = true.has(found.t_ns - _MOST_OFFSET_NS) & true.has(found.t_ns + _MOST_OFFSET_NS)
    if inside.sum() < _LEAST_POSES:
        return math.nan
    offsets_ns = np.arange(-_MOST_OFFSET_NS, _MOST_OFFSET_NS + 1, _OFFSET_STEP_NS)
    rows = np.flatnonzero(inside)
    unlike = _unlike_by_offset(found, true, (rows[:-1], rows[1:]), offsets_ns)
    best = int(unlike.argmin())
    if not 0 < best < len(unlike) - 1 or np.ptp(unlike) < _FLAT_M:
        return math.nan
    before, at, after = unlike[best - 1 : best + 2] ** 2  # a parabola through the minimum
    bend = before - 2.0 * at + after
    return float(offsets_ns[best] + 0.5 * _OFFSET_STEP_NS * (before - after) / bend) / S_NS


def _unlike_by_offset(
    found: RecordedPoses, true: Trajectory, steps: tuple[I8, I8], offsets_ns: I8, least_steps: float = 0
) -> F8:
    """Return how unlike an estimate's steps are to the true ones if an offset is added to its stamps.

    The result (k,) is by offset, as `_unlike`; it is infinite where fewer than `least_steps` of the steps,
    given by the rows (n,) of their first and last poses, are within the truth.
    """
    from scipy.spatial.transform import Rotation

    both = np.concatenate(steps)
    moved_m, turned = _steps(Rotation.from_quat(found.quaternion[both]), found.position_m[both])
    rows, pose = np.unique(both, return_inverse=True)
    unlike = np.full(len(offsets_ns), math.inf)
    for i, offset_ns in enumerate(offsets_ns.tolist()):
        t_ns = found.t_ns[rows] + offset_ns
        inside = np.flatnonzero(true.has(t_ns)[pose].reshape(2, -1).all(axis=0))
        if len(inside) >= least_steps:
            turns, places_m = true.poses_at(t_ns)
            true_m, true_turned = _steps(Rotation.from_matrix(turns[pose]), places_m[pose])
            unlike[i] = _unlike(moved_m[inside], true_m[inside], turned[inside], true_turned[inside])
    return unlike


def _steps(turns: "Rotation", places_m: F8) -> tuple[F8, "Rotation"]:
    """Return steps (n, 3) and turns from the first half of 2 n poses to the second, in axes of the first."""
    n = len(places_m) // 2
    return turns[:n].apply(places_m[n:] - places_m[:n], inverse=True), turns[:n].inv() * turns[n:]


def _unlike(moved_m: F8, true_m: F8, turned: "Rotation", true_turned: "Rotation") -> float:
    """Return the RMS difference of steps (n, 3) in metres, plus that of their turns in radians."""
    off_rad = (turned.inv() * true_turned).magnitude()
    return math.sqrt(((moved_m - true_m) ** 2).sum(axis=1).mean()) + math.sqrt((off_rad**2).mean())


def _align(found: RecordedPoses, inside: NDArray[np.bool_], true: Trajectory, alignment: str) -> Any:
    """Return the true and the found trajectory at the same instants, as evo's classes."""
    from evo.core.geometry import GeometryException, umeyama_alignment
    from evo.core.trajectory import PoseTrajectory3D
    from scipy.spatial.transform import Rotation

    t_ns = found.t_ns[inside]
    turns, places_m = true.poses_at(t_ns)
    t_s = (t_ns - t_ns[0]) / S_NS
    quaternions = Rotation.from_matrix(turns).as_quat()[:, [3, 0, 1, 2]]
    reference = PoseTrajectory3D(places_m, quaternions, t_s)
    estimate = PoseTrajectory3D(
        found.position_m[inside].copy(), found.quaternion[inside][:, [3, 0, 1, 2]], t_s
    )
    try:
        if alignment == "start":
            estimate.align_origin(reference)
        elif alignment == "se3":
            estimate.align(reference)
        elif alignment == "yaw":
            move = np.eye(4)
            move[:2, :2] = umeyama_alignment(estimate.positions_xyz[:, :2].T, places_m[:, :2].T)[0]
            move[:3, 3] = (places_m - estimate.positions_xyz @ move[:3, :3].T).mean(axis=0)
            estimate.transform(move)
    except GeometryException:
        raise InputError(
            "--align", f"found {alignment}", "none, as the positions lie on a line or a point"
        ) from None
    return reference, estimate
