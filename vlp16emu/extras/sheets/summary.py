"""Figures of what stands along the path of a sensor: density, diameter, basal area, volume, pattern, relief."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.scenario import Scenario
from vlp16emu.types import F8, HeightField
from vlp16emu.world.vectors import places_m

CELL_M = 0.5
"""Edge of the cells for areas and slopes: about the length of a foot on the slope."""


@dataclass(frozen=True, slots=True)
class StandRow:
    """Figures of one species of a stand, or of all."""

    species: str
    stems: int
    stems_per_ha: float
    dbh_mean_cm: float  # quadratic mean
    dbh_min_cm: float
    dbh_max_cm: float
    height_mean_m: float
    height_max_m: float
    basal_area_m2_per_ha: float
    stem_m3_per_ha: float  # volume of stems over bark
    leaf_area_index: float  # leaf area of these trees over the area considered


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


_MEASURES = {
    "sapling": ("height", 2),
    "shrub": ("height", 2),
    "stone": ("length", 0),
    **dict.fromkeys(("log", "broken_log"), ("length", 0)),
    **dict.fromkeys(("stump", "broken_stump"), ("diameter", 0)),
    "root_plate": ("diameter", 1),
    **dict.fromkeys(("tuft", "herb", "fern", "dwarf_shrub"), ("height", 2)),
}
"""Reported size of a kind of thing, and its axis."""


@dataclass(frozen=True, slots=True)
class PathSummary:
    """The path of the sensor."""

    length_m: float  # 0 if the sensor stands still
    start_m: list[float]  # x, y, z
    end_m: list[float]


@dataclass(frozen=True, slots=True)
class NamedThing:
    """A named thing: of a hall, or one of the user's own."""

    name: str
    kind: str
    instance: int
    place_m: list[float]
    size_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Things:
    """Things of one kind without names."""

    count: int
    per_ha: float
    measure: str  # the size whose extremes follow: height, length or diameter
    least_m: float
    greatest_m: float
    species: Mapping[str, int]  # counts by name, the most frequent first


@dataclass(frozen=True, slots=True)
class WorldSummary:
    """Figures of any world."""

    scene: str
    title: str
    seed: int
    world: str  # kind of the world
    path: PathSummary
    radius_m: float  # distance from the path within which things are reported
    named: tuple[NamedThing, ...]


@dataclass(frozen=True, slots=True)
class ForestSummary(WorldSummary):
    """Figures of a forest, within the radius."""

    area_ha: float
    relief: Relief
    trees: tuple[StandRow, ...]
    clark_evans: float | None  # none with fewer than two trees
    things: Mapping[str, Things]  # by kind
    trees_in_reach: int  # trees within the sensor's range


def summary_of(scene: str, scenario: Scenario, seen: Survey) -> WorldSummary:
    """Summarise the survey of a scene of this name."""
    path_xy_m = seen.path_m[:, :2]
    length_m = float(np.hypot(*np.diff(path_xy_m, axis=0).T).sum())
    bare = WorldSummary(
        scene=scene,
        title=scenario.title,
        seed=scenario.seed,
        world=scenario.world.kind,
        path=PathSummary(length_m, seen.path_m[0].tolist(), seen.path_m[-1].tolist()),
        radius_m=seen.radius_m,
        named=tuple(
            NamedThing(seen.names[thing.instance], thing.kind, thing.instance, thing.place_m.tolist(), thing.size_m)
            for thing in seen.things
            if thing.instance in seen.names
        ),
    )
    if seen.hall is not None:
        return bare
    cells = cells_near(path_xy_m, seen.radius_m)
    ground_m2 = len(cells) * CELL_M**2
    xy_m, all_xy_m = (places_m(trees, "xy") for trees in (seen.near, seen.trees))
    return ForestSummary(
        **{name: getattr(bare, name) for name in WorldSummary.__slots__},
        area_ha=ground_m2 / 10_000,
        relief=relief(cells, seen.bare.height_m),
        trees=tuple(stand_rows(seen.inventory(seen.near), seen.species, ground_m2)),
        clark_evans=clark_evans(xy_m, all_xy_m, ground_m2) if len(xy_m) > 1 else None,
        things=_things(seen, ground_m2),
        trees_in_reach=len(seen.trees),
    )


def _things(seen: Survey, ground_m2: float) -> dict[str, Things]:
    """Count things without names by kind, with their species and the range of their sizes."""
    kinds = dict[str, Things]()
    nameless = [thing for thing in seen.things if thing.instance not in seen.names]
    for kind in sorted({thing.kind for thing in nameless}):
        things, (measure, axis) = [thing for thing in nameless if thing.kind == kind], _MEASURES[kind]
        sizes_m = [thing.size_m[axis] for thing in things]
        species = dict(Counter(seen.species[one.species] for one in things if one.species).most_common())
        per_ha = len(things) / ground_m2 * 10_000
        kinds[kind] = Things(len(things), per_ha, measure, min(sizes_m), max(sizes_m), species)
    return kinds
