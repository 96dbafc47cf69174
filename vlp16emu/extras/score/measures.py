"""Measures of point clouds and of trees: distances, density, stem maps, labels, instances and boxes."""

import math
from collections.abc import Sequence

import numpy as np

from vlp16emu.extras.score.files import Stem
from vlp16emu.random import Purpose, uniform
from vlp16emu.types import F8, I8

_DISKS = 9000  # of PU-Net
_SHARE = 0.01  # of the area, that each disk has
_SEED = 1  # of the places of the disks
_COCO = tuple(np.arange(50, 100, 5) / 100)
"""Thresholds of intersection over union whose average precision is averaged (COCO, detection evaluation)."""


def cloud_distances(found: F8, true: F8, within_m: tuple[float, ...]) -> dict[str, float]:
    """Compare two clouds (n, 3) and (m, 3), in metres, by the distances of nearest points.

    Returns
    -------
    `accuracy_m`: mean from found to true points; `completeness_m`: mean from true to found points;
    `chamfer_m`: their sum (Fan, Su and Guibas, CVPR 2017, with distances instead of their squares, so that
    its unit is metres); `precision_Ncm` and `completeness_Ncm`: shares of points nearer than N cm (Knapitsch
    et al., Tanks and Temples, 2017)
    """
    from scipy.spatial import KDTree

    to_true_m = np.asarray(KDTree(true).query(found)[0])
    to_found_m = np.asarray(KDTree(found).query(true)[0])
    scores = {"accuracy_m": float(to_true_m.mean()), "completeness_m": float(to_found_m.mean())}
    scores["chamfer_m"] = sum(scores.values())
    for limit_m in within_m:
        name = f"{round(limit_m * 100)}cm"
        scores[f"precision_{name}"] = float((to_true_m <= limit_m).mean())
        scores[f"completeness_{name}"] = float((to_found_m <= limit_m).mean())
    return scores


def density_per_m2(xy_m: F8, centre_m: F8, radius_m: float) -> float:
    """Return points (n, 2) per square metre of plan within a circle, an indicator of a sensor's placement.

    Source: Cai et al., Analyzing Infrastructure LiDAR Placement, arXiv 2211.15975, which counts points of a
    region of interest; here the region is a circle around the viewpoint.
    """
    inside = ((xy_m - centre_m) ** 2).sum(axis=1) <= radius_m**2
    return float(inside.sum() / (math.pi * radius_m**2))


def uniformity(xy_m: F8, centre_m: F8, radius_m: float) -> float:
    """Return the normalised uniformity coefficient of points (n, 2) in a circle: 0 is perfectly even.

    NUC of PU-Net (Yu et al., CVPR 2018, section 4.2): disk i of `_DISKS` holds n_i of N points and the share
    p of the area, `_SHARE`, in the paper 0.002 to 0.012; the coefficient is the standard deviation of n_i /
    (N p) over the disks. The paper's disks are on surfaces of objects; here they are horizontal, wholly
    within the circle. NaN without points in the circle.
    """
    from scipy.spatial import KDTree

    inside = xy_m[((xy_m - centre_m) ** 2).sum(axis=1) <= radius_m**2]
    if not len(inside):
        return math.nan
    disk_m = radius_m * math.sqrt(_SHARE)
    turn = 2 * np.pi * uniform(_SEED, Purpose.SCORE_DISK, 0, _DISKS, 1)
    away_m = (radius_m - disk_m) * np.sqrt(uniform(_SEED, Purpose.SCORE_DISK, 0, _DISKS, 0))
    disks = centre_m + away_m[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    counts = KDTree(inside).query_ball_point(disks, disk_m, return_length=True)
    return float(np.std(counts / (len(inside) * _SHARE)))


def match_stems(found: Sequence[Stem], true: Sequence[Stem], radius_m: float) -> list[tuple[int, int]]:
    """Pair stems, each once and within a radius: as many pairs as possible, with the least sum of distances.

    Returns indices into `found` and `true`.
    """
    from scipy.optimize import linear_sum_assignment

    found_m = np.array([(stem.x_m, stem.y_m) for stem in found]).reshape(-1, 2)
    true_m = np.array([(stem.x_m, stem.y_m) for stem in true]).reshape(-1, 2)
    apart_m = np.linalg.norm(found_m[:, None] - true_m, axis=-1)
    # A pair beyond the radius costs more than all possible pairs within it.
    cost = np.where(apart_m <= radius_m, apart_m, (radius_m + 1) * (min(apart_m.shape) + 1))
    rows, columns = linear_sum_assignment(cost)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if apart_m[i, j] <= radius_m]


def stem_scores(
    found: Sequence[Stem], true: Sequence[Stem], pairs: Sequence[tuple[int, int]]
) -> dict[str, float]:
    """Return precision, recall and F1 of a stem map, and its errors.

    Errors are of position (RMSE, m) and of DBH (mean and RMSE, m).
    """
    scores = _shares("stem", len(pairs), len(found) - len(pairs), len(true) - len(pairs))
    off_m = [math.hypot(found[i].x_m - true[j].x_m, found[i].y_m - true[j].y_m) for i, j in pairs]
    scores["stem_position_m"] = _rms(off_m)
    errors_m = [found[i].dbh_m - true[j].dbh_m for i, j in pairs]
    errors_m = [error_m for error_m in errors_m if math.isfinite(error_m)]
    scores["dbh_bias_m"] = float(np.mean(errors_m)) if errors_m else math.nan
    scores["dbh_m"] = _rms(errors_m)
    return scores


def leaf_wood_scores(found: I8, true: I8) -> dict[str, float]:
    """Return accuracy and intersection over union of labels (n,), 1 wood and 2 leaf.

    Only points whose true label is 1 or 2 count.
    """
    known = true > 0
    found = found[known]
    true = true[known]
    scores = {"leaf_wood_accuracy": float((found == true).mean()) if known.any() else math.nan}
    for label, name in ((1, "wood_iou"), (2, "leaf_iou")):
        either = ((found == label) | (true == label)).sum()
        scores[name] = float(((found == label) & (true == label)).sum() / either) if either else math.nan
    scores["leaf_wood_miou"] = (scores["wood_iou"] + scores["leaf_iou"]) / 2
    return scores


def instance_scores(found: I8, true: I8) -> dict[str, float]:
    """Return panoptic, segmentation and recognition quality of instances (n,) of points, 0 for none.

    Kirillov et al., Panoptic Segmentation, CVPR 2019: pairs with an intersection over union above 0.5 are
    matches.
    """
    names, rows = np.unique(found, return_inverse=True)
    known, columns = np.unique(true, return_inverse=True)
    both = np.zeros((len(names), len(known)))
    np.add.at(both, (rows, columns), 1)
    either = both.sum(axis=1, keepdims=True) + both.sum(axis=0) - both
    overlap = (both / either)[np.ix_(names > 0, known > 0)]
    matched = overlap[overlap > 0.5]
    n_found, n_true = overlap.shape
    scores = _shares("instance", len(matched), n_found - len(matched), n_true - len(matched))
    rq = scores["instance_f1"]
    sq = float(matched.mean()) if len(matched) else 0.0
    return {"pq": sq * rq, "sq": sq, "rq": rq, **scores}


def boxes_of(xyz_m: F8, instance: I8, least_points: int) -> tuple[F8, I8]:
    """Return axis-aligned boxes (k, 2, 3) around instances, and their numbers of points (k,).

    Instances with too few points have none.
    """
    names, counts = np.unique(instance[instance > 0], return_counts=True)
    names = names[counts >= least_points]
    counts = counts[counts >= least_points]
    points = [xyz_m[instance == name] for name in names]
    boxes = [(points_m.min(axis=0), points_m.max(axis=0)) for points_m in points]
    return np.array(boxes).reshape(-1, 2, 3), counts


def box_scores(found: F8, confidence: I8, true: F8) -> dict[str, float]:
    """Return average precision of boxes (k, 2, 3) against the true ones, by intersection over union in 3D.

    Area under the curve of precision over recall, precision made monotonous (VOC 2010); `box_ap_25` and
    `box_ap_50` at 0.25 and 0.5, `box_map` the mean over 0.50 to 0.95 in steps of 0.05 (COCO). Boxes are
    matched by falling confidence, each true box once.
    """
    overlap = _overlaps(found[np.argsort(-confidence, kind="stable")], true)
    scores = {"box_ap_25": _average_precision(overlap, 0.25), "box_ap_50": _average_precision(overlap, 0.5)}
    return scores | {"box_map": float(np.mean([_average_precision(overlap, limit) for limit in _COCO]))}


def _overlaps(found: F8, true: F8) -> F8:
    """Return the intersection over union (k, m) of found boxes (k, 2, 3) and true ones (m, 2, 3)."""
    low = np.maximum(found[:, None, 0], true[None, :, 0])
    high = np.minimum(found[:, None, 1], true[None, :, 1])
    both = np.prod(np.clip(high - low, 0, None), axis=-1)
    found_m3 = np.prod(found[:, 1] - found[:, 0], axis=-1)
    true_m3 = np.prod(true[:, 1] - true[:, 0], axis=-1)
    either = found_m3[:, None] + true_m3 - both
    return np.asarray(np.divide(both, either, out=np.zeros_like(both), where=either > 0))


def _average_precision(overlap: F8, limit: float) -> float:
    """Return the area under precision over recall of boxes sorted by confidence; NaN without true boxes."""
    n_found, n_true = overlap.shape
    if not n_true:
        return math.nan
    hit = np.zeros(n_found)
    free = np.ones(n_true, bool)
    for i, row in enumerate(overlap):
        best = int(np.argmax(np.where(free, row, -1.0)))
        if free[best] and row[best] >= limit:
            hit[i] = 1
            free[best] = False
    precision = np.cumsum(hit) / np.arange(1, n_found + 1)
    monotonous = np.maximum.accumulate(precision[::-1])[::-1]
    return float((monotonous * hit).sum() / n_true)


def _shares(name: str, hits: int, false: int, missed: int) -> dict[str, float]:
    """Return precision, recall and F1 by name; NaN where there is nothing to count."""
    shares = {"precision": (hits, hits + false), "recall": (hits, hits + missed)}
    shares["f1"] = 2 * hits, 2 * hits + false + missed
    return {f"{name}_{key}": part / total if total else math.nan for key, (part, total) in shares.items()}


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else math.nan
