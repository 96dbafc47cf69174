"""Error of a trajectory, by evo."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError, MissingExtraError
from vlp16emu.extras.clouds.deskew import Trajectory
from vlp16emu.extras.options import TrajectoryErrors
from vlp16emu.extras.recorded.files import RecordedPoses, read_kitti, read_tum
from vlp16emu.types import F8
from vlp16emu.units import S_NS

RPE_DELTA_M = 1.0
"""Length of path for relative errors, which short walks have too."""


@dataclass(frozen=True, slots=True)
class PathScore:
    """Errors of an estimated trajectory."""

    scores: dict[str, float]
    """`ate_m` RMSE of positions, `ate_max_m`, `rpe_m` and `rpe_deg` RMSE over `RPE_DELTA_M` of path."""
    poses: int
    left_out: int
    """Estimated poses outside the time of the truth."""
    true_m: F8
    """(n, 3)."""
    found_m: F8
    """(n, 3), aligned."""
    errors_m: F8
    """(n,)."""


def score_path(file: Path, times: Path | None, truth: Path, unit: int, alignment: str) -> PathScore:
    """Compare a trajectory with the truth at its own stamps, between which the truth is interpolated.

    TrajectoryError, InputError if one is no trajectory, or they have fewer than three instants in common.

    The file is TUM, or KITTI if `times` has a time in seconds for each pose; truth and unit are as in `Trajectory`.
    """
    try:
        from evo.core import metrics
        from evo.core.filters import FilterException
    except ImportError:
        raise MissingExtraError("evo", "score", "scoring a trajectory") from None
    found = read_tum(file) if times is None else read_kitti(file, times)
    true = Trajectory(truth, unit, TrajectoryErrors())
    inside = true.has(found.t_ns)
    if inside.sum() < 3:
        spans = [f"{a:.3f} to {b:.3f} s" for a, b in ((found.t_ns[0] / S_NS, found.t_ns[-1] / S_NS), true.span_s)]
        raise InputError(str(file), f"found poses from {spans[0]}", f"at least three within the truth, {spans[1]}")
    pair = _aligned(found, inside, true, alignment)

    def score(metric: metrics.PE) -> tuple[float, F8]:
        try:
            metric.process_data(pair)
        except (FilterException, metrics.MetricsException):
            return math.nan, np.array([math.nan])
        return float(metric.get_statistic(metrics.StatisticsType.rmse)), np.asarray(metric.error)

    over = {"delta": RPE_DELTA_M, "delta_unit": metrics.Unit.meters, "all_pairs": True}
    ate_m, errors_m = score(metrics.APE(metrics.PoseRelation.translation_part))
    scores = {
        "ate_m": ate_m,
        "ate_max_m": float(errors_m.max()),
        "rpe_m": score(metrics.RPE(metrics.PoseRelation.translation_part, **over))[0],
        "rpe_deg": score(metrics.RPE(metrics.PoseRelation.rotation_angle_deg, **over))[0],
    }
    left_out = int((~inside).sum())
    return PathScore(scores, int(inside.sum()), left_out, pair[0].positions_xyz, pair[1].positions_xyz, errors_m)


def _aligned(found: RecordedPoses, inside: NDArray[np.bool_], true: Trajectory, alignment: str):  # type: ignore[no-untyped-def]  # noqa: ANN202 - of evo, which has no types
    """Return trajectories of evo, true and found, at the same instants."""
    from evo.core.geometry import GeometryException, umeyama_alignment
    from evo.core.trajectory import PoseTrajectory3D
    from scipy.spatial.transform import Rotation

    t_ns = found.t_ns[inside]
    turns, places_m = true.poses_at(t_ns)
    t_s = (t_ns - t_ns[0]) / S_NS
    quaternions = Rotation.from_matrix(turns).as_quat()[:, [3, 0, 1, 2]]
    reference = PoseTrajectory3D(places_m, quaternions, t_s)
    estimate = PoseTrajectory3D(found.position_m[inside].copy(), found.quaternion[inside][:, [3, 0, 1, 2]], t_s)
    try:
        if alignment == "se3":
            estimate.align(reference)
        elif alignment == "yaw":
            move = np.eye(4)
            move[:2, :2] = umeyama_alignment(estimate.positions_xyz[:, :2].T, places_m[:, :2].T)[0]
            move[:3, 3] = (places_m - estimate.positions_xyz @ move[:3, :3].T).mean(axis=0)
            estimate.transform(move)
    except GeometryException:
        raise InputError("--align", f"found {alignment}", "none, as the positions lie on a line or a point") from None
    return reference, estimate
