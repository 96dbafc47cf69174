"""Figures of what stands along the path of a sensor."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vlp16emu.extras.sheets.figures import CELL_M, Relief, StandRow, cells_near, clark_evans, relief, stand_rows
from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.scenario import Scenario
from vlp16emu.world.vectors import places_m

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

    length_m: float
    """0 if the sensor stands still."""
    start_m: list[float]
    """x, y, z."""
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
    measure: str
    """The size whose extremes follow: height, length or diameter."""
    least_m: float
    greatest_m: float
    species: Mapping[str, int]
    """Counts by name, the most frequent first."""


@dataclass(frozen=True, slots=True)
class WorldSummary:
    """Figures of any world."""

    scene: str
    title: str
    seed: int
    world: str
    """Kind of the world."""
    path: PathSummary
    radius_m: float
    """Distance from the path within which things are reported."""
    named: tuple[NamedThing, ...]


@dataclass(frozen=True, slots=True)
class ForestSummary(WorldSummary):
    """Figures of a forest, within the radius."""

    area_ha: float
    relief: Relief
    trees: tuple[StandRow, ...]
    clark_evans: float | None
    """None with fewer than two trees."""
    things: Mapping[str, Things]
    """By kind."""
    trees_in_reach: int
    """Trees within the sensor's range."""


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
