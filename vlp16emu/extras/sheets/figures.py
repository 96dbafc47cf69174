"""Figures of forestry: density, diameter, basal area, volume, pattern, relief."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from vlp16emu.types import F8, HeightField

CELL_M = 0.5
"""Edge of the cells for areas and slopes: about the length of a foot on the slope."""


@dataclass(frozen=True, slots=True)
class StandRow:
    """Figures of one species of a stand, or of all."""

    species: str
    stems: int
    stems_per_ha: float
    dbh_mean_cm: float
    """Quadratic mean."""
    dbh_min_cm: float
    dbh_max_cm: float
    height_mean_m: float
    height_max_m: float
    basal_area_m2_per_ha: float
    stem_m3_per_ha: float
    """Volume of stems over bark."""
    leaf_area_index: float
    """Leaf area of these trees over the area considered."""


@dataclass(frozen=True, slots=True)
class Relief:
    """Ground in the area considered."""

    low_m: float
    high_m: float
    slope_mean_deg: float
    slope_max_deg: float


def stand_rows(inventory: NDArray[np.void], species: Mapping[int, str], ground_m2: float) -> list[StandRow]:
    """Return rows of the species of an inventory (n,), the most frequent first, and a last one of all trees if there are several."""
    numbers, stems = np.unique(inventory["species"], return_counts=True)
    rows = [
        _row(species[int(number)], inventory[inventory["species"] == number], ground_m2)
        for number in numbers[np.argsort(-stems, kind="stable")]
    ]
    return rows if len(rows) < 2 else [*rows, _row("all", inventory, ground_m2)]


def _row(name: str, trees: NDArray[np.void], ground_m2: float) -> StandRow:
    ground_ha = ground_m2 / 10_000
    dbh_m = trees["dbh_m"]
    return StandRow(
        species=name,
        stems=len(trees),
        stems_per_ha=len(trees) / ground_ha,
        dbh_mean_cm=100 * float(np.sqrt(np.mean(dbh_m**2))),
        dbh_min_cm=100 * float(dbh_m.min()),
        dbh_max_cm=100 * float(dbh_m.max()),
        height_mean_m=float(trees["height_m"].mean()),
        height_max_m=float(trees["height_m"].max()),
        basal_area_m2_per_ha=float(np.sum(np.pi / 4 * dbh_m**2)) / ground_ha,
        stem_m3_per_ha=float(trees["stem_m3"].sum()) / ground_ha,
        leaf_area_index=float(trees["leaf_m2"].sum()) / ground_m2,
    )


def clark_evans(xy_m: F8, all_xy_m: F8, ground_m2: float) -> float:
    """Return the index of Clark and Evans (1954): mean distance to the nearest neighbour over its expectation at random.

    It is 1 at random, less in clumps, and up to 2.149 in a regular pattern.

    Parameters
    ----------
    xy_m : (n, 2) points in the area, n >= 2
    all_xy_m : (m, 2) these and those around: neighbours count wherever they stand, so the border needs no correction
    """
    nearest_m = np.asarray(KDTree(all_xy_m).query(xy_m, k=[2])[0])
    return float(nearest_m.mean() * 2 * np.sqrt(len(xy_m) / ground_m2))


def cells_near(way_xy_m: F8, radius_m: float) -> F8:
    """Return the middles (n, 2) of the cells of `CELL_M` within a radius of a dense line of points (m, 2).

    Their number times `CELL_M` squared is the area around the path.
    """
    low = np.floor((way_xy_m.min(axis=0) - radius_m) / CELL_M)
    high = np.ceil((way_xy_m.max(axis=0) + radius_m) / CELL_M)
    x_m, y_m = (CELL_M * (np.arange(a, b) + 0.5) for a, b in zip(low, high, strict=True))
    cells = np.stack(np.meshgrid(x_m, y_m, indexing="ij"), axis=-1).reshape(-1, 2)
    near: F8 = cells[KDTree(way_xy_m).query(cells, distance_upper_bound=radius_m)[0] <= radius_m]
    return near


def relief(cells_xy_m: F8, height_m: HeightField) -> Relief:
    """Return heights and slopes of the ground at points (n, 2), n >= 1; slopes over `CELL_M` in x and in y."""
    x_m, y_m = cells_xy_m.T
    half = CELL_M / 2
    rise_x = (height_m(x_m + half, y_m) - height_m(x_m - half, y_m)) / CELL_M
    rise_y = (height_m(x_m, y_m + half) - height_m(x_m, y_m - half)) / CELL_M
    slope_deg = np.degrees(np.arctan(np.hypot(rise_x, rise_y)))
    ground_m = height_m(x_m, y_m)
    return Relief(float(ground_m.min()), float(ground_m.max()), float(slope_deg.mean()), float(slope_deg.max()))
