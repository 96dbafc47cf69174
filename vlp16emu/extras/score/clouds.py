"""Distances between point clouds, density and uniformity."""

import math

import numpy as np

from vlp16emu.random import Purpose, uniform
from vlp16emu.types import F8

_DISKS = 9000
"""Disks of PU-Net (Yu et al., CVPR 2018, section 4.2)."""


def cloud_distances(found: F8, true: F8, within_m: tuple[float, ...]) -> dict[str, float]:
    """Compare two clouds (n, 3) and (m, 3), in metres, by the distances of nearest points.

    Returns
    -------
    `accuracy_m`: mean from found to true points; `completeness_m`: mean from true to found points; `chamfer_m`: their
    sum (Fan, Su and Guibas, CVPR 2017, with distances instead of their squares, so that its unit is metres);
    `precision_Ncm` and `completeness_Ncm`: shares of points nearer than N cm (Knapitsch et al., Tanks and Temples, 2017)
    """
    from scipy.spatial import KDTree

    to_true, to_found = (np.asarray(KDTree(a).query(b)[0]) for a, b in ((true, found), (found, true)))
    scores = {"accuracy_m": float(to_true.mean()), "completeness_m": float(to_found.mean())}
    scores["chamfer_m"] = sum(scores.values())
    for limit_m in within_m:
        name = f"{round(limit_m * 100)}cm"
        scores[f"precision_{name}"] = float((to_true <= limit_m).mean())
        scores[f"completeness_{name}"] = float((to_found <= limit_m).mean())
    return scores


def density_per_m2(xy_m: F8, centre_m: F8, radius_m: float) -> float:
    """Return points (n, 2) per square metre of plan within a circle, an indicator of a sensor's placement.

    After Cai et al., Analyzing Infrastructure LiDAR Placement, arXiv 2211.15975, which counts points of a region of interest;
    here the region is a circle around the viewpoint.
    """
    inside = ((xy_m - centre_m) ** 2).sum(axis=1) <= radius_m**2
    return float(inside.sum() / (math.pi * radius_m**2))


def uniformity(xy_m: F8, centre_m: F8, radius_m: float, *, share: float = 0.01, seed: int = 1) -> float:
    """Return the normalised uniformity coefficient of points (n, 2) in a circle: 0 is perfectly even.

    NUC of PU-Net (Yu et al., CVPR 2018, section 4.2): disk i of `_DISKS` holds n_i of N points and the `share` p of the area, there
    0.002 to 0.012; the coefficient is the standard deviation of n_i / (N p) over the disks. Theirs are on the surfaces of objects,
    these lie in the plan, wholly within the circle. NaN without points in the circle.
    """
    from scipy.spatial import KDTree

    inside = xy_m[((xy_m - centre_m) ** 2).sum(axis=1) <= radius_m**2]
    if not len(inside):
        return math.nan
    disk_m = radius_m * math.sqrt(share)
    turn = 2 * np.pi * uniform(seed, Purpose.SCORE_DISK, 0, _DISKS, 1)
    away_m = (radius_m - disk_m) * np.sqrt(uniform(seed, Purpose.SCORE_DISK, 0, _DISKS, 0))
    disks = centre_m + away_m[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    counts = KDTree(inside).query_ball_point(disks, disk_m, return_length=True)
    return float(np.std(counts / (len(inside) * share)))
