"""Survey of trees and objects near the path of a sensor.

It has figures, and the files that `vlp16emu forest` writes.
"""

from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from vlp16emu.engine import Parts, assemble
from vlp16emu.errors import InputError
from vlp16emu.extras.colours import surface_colours
from vlp16emu.extras.meshes.furnish import Furnished
from vlp16emu.extras.stand_map import bark_seen, map_of
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.ground.dem import write_ascii
from vlp16emu.forest.plants.prototypes import CrownKey
from vlp16emu.forest.plants.species import Flora, flora
from vlp16emu.forest.plants.stem import STEM_CIRCLE, Stems
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.stand.inventory import INVENTORY, branch_circles, inventory, write_csv
from vlp16emu.forest.stand.stand import REGENERATION, TREE
from vlp16emu.forest.stand.tree_models import TreeModels
from vlp16emu.forest.stand.twin import Thing, things_near, write_glb
from vlp16emu.motion.pose import Motion
from vlp16emu.output import OutputFile
from vlp16emu.scenario import Scenario
from vlp16emu.trees import Tree
from vlp16emu.types import F8, HeightField, Window, World
from vlp16emu.units import seconds_to_ns
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.vectors import places_m

CELL_M = 0.5  # edge of the cells for areas and slopes: about the length of a foot on the slope
_GROUND_CELL_M = 0.25  # cell of the ground grid: the finest common one for forests
_MEASURES = {
    "sapling": ("height", 2),
    "shrub": ("height", 2),
    "stone": ("length", 0),
    **dict.fromkeys(("log", "broken_log"), ("length", 0)),
    **dict.fromkeys(("stump", "broken_stump"), ("diameter", 0)),
    "root_plate": ("diameter", 1),
    **dict.fromkeys(("tuft", "herb", "fern", "dwarf_shrub"), ("height", 2)),
}
"""Reported size of each kind of object, and its axis."""
_STEPS_PER_S = 10  # rate of the points of the path: about 12 cm apart at walking speed


@dataclass(frozen=True, slots=True)
class Survey:
    """Trees and ground near the path."""

    world: World
    bare: ForestWorld | HallWorld  # the world without the user's own meshes
    path_m: F8  # (n, 3) sensor positions in order of time; one if the sensor stands still
    field_deg: tuple[float, float]  # elevations of the sensor's lowest and highest beam
    radius_m: float  # distance from the path within which objects are reported
    window: Window  # all within the sensor's range
    trees: NDArray[np.void]  # (n,) `TREE` within the sensor's range, without saplings
    near: NDArray[np.void]  # (m,) `TREE` within the radius
    things: list[Thing]  # all other objects within the radius
    seed: int

    @property
    def hall(self) -> HallWorld | None:
        """The hall, or None in a forest."""
        return self.bare if isinstance(self.bare, HallWorld) else None

    @property
    def plants(self) -> Flora:
        """Species of trees and shrubs."""
        return self.bare.plants if isinstance(self.bare, ForestWorld) else flora()

    @property
    def models(self) -> TreeModels:
        """Trees of the user's own models."""
        return self.bare.models if isinstance(self.bare, ForestWorld) else TreeModels()

    @property
    def species(self) -> dict[int, str]:
        """Names of species by number."""
        return self.plants.names

    @property
    def names(self) -> Mapping[int, str]:
        """Names by instance, for objects that have one."""
        names = dict[int, str]()
        for world in (self.world, self.bare):
            if isinstance(world, HallWorld | Furnished):
                names |= world.names
        return names

    @property
    def bounds_m(self) -> tuple[F8, F8]:
        """South-west and north-east corner (2,) of the surveyed area.

        The area is the hall, or the bounding rectangle of the radius around the path.
        """
        if self.hall is not None:
            corner_m = np.array(self.hall.size_m[:2]) / 2
            return -corner_m, corner_m
        xy_m = self.path_m[:, :2]
        return xy_m.min(axis=0) - self.radius_m, xy_m.max(axis=0) + self.radius_m

    def inventory(self, trees: NDArray[np.void]) -> NDArray[np.void]:
        """Return the inventory of some of the trees (k,)."""
        is_modelled = self.models.has(trees)
        rows = np.zeros(len(trees), INVENTORY)
        grown = trees[~is_modelled]
        rows[~is_modelled] = inventory(grown, self._crowns(grown), seed=self.seed, table=self.plants.trees)
        rows[is_modelled] = self.models.inventory(trees[is_modelled])
        return rows

    def stem_circles(self, trees: NDArray[np.void]) -> NDArray[np.void]:
        """Return circles `STEM_CIRCLE` along the stems of some of the trees (k,), by tree.

        Near trees also have circles along their branches.
        """
        is_modelled = self.models.has(trees)
        grown = trees[~is_modelled]
        stems = Stems(grown, table=self.plants.trees).circles()
        near = grown[np.isin(grown["id"], self.near["id"])]
        branches = branch_circles(near, self._crowns(near), seed=self.seed, table=self.plants.trees)
        circles = np.concatenate([stems, self.models.circles(trees[is_modelled]), branches])
        return circles[np.argsort(circles["tree"], kind="stable")]

    def _crowns(self, trees: NDArray[np.void]) -> list[CrownKey]:
        """Return the crowns of some of the trees (k,)."""
        window = self.window
        instance = window.surfaces["instance"][window.first_surface].tolist()
        shapes = (window.shapes[i] for i in window.shape)
        crowns = {i: key for i, key in zip(instance, shapes, strict=True) if isinstance(key, CrownKey)}
        return [crowns[i] for i in trees["id"].tolist()]

    def inside(self, xy_m: F8) -> NDArray[np.bool_]:
        """Return a mask of points (k, 2) within the radius."""
        return np.asarray(Polyline(self.path_m[:, :2]).distance_m(xy_m) <= self.radius_m)


def survey(scenario: Scenario, radius_m: float, parts: Parts | None = None) -> Survey:
    """Survey the surroundings of the path of a scenario's sensor.

    InputError if a part of the scenario cannot be made, its world is from another package, or the radius
    exceeds the sensor's range.
    """
    reach_m = scenario.sensor.max_range_m
    if radius_m > reach_m:
        raise InputError(
            "--radius", f"found {radius_m:g}", f"at most {reach_m:g}, which is the sensor's reach"
        )
    parts = parts or assemble(scenario)
    world = parts.world
    elevation_deg = parts.head.beams.elevation_deg
    bare = world.bare if isinstance(world, Furnished) else world
    if not isinstance(bare, ForestWorld | HallWorld):
        raise InputError("world.kind", f"found {scenario.world.kind}", "forest, plot or hall")
    path_m = _path_m(scenario, parts.motion)
    path = Polyline(path_m[:, :2])
    window = world.window(path_m)
    trees = bare.trees(path_m) if isinstance(bare, ForestWorld) else np.zeros(0, TREE)
    trees = trees[trees["storey"] != REGENERATION]
    gap_m = path.distance_m(places_m(trees, "xy"))
    far_m = np.inf if isinstance(bare, HallWorld) else radius_m
    return Survey(
        world=world,
        bare=bare,
        path_m=path_m,
        field_deg=(float(elevation_deg.min()), float(elevation_deg.max())),
        radius_m=radius_m,
        window=window,
        trees=trees[gap_m <= reach_m],
        near=trees[gap_m <= radius_m],
        things=things_near(window, world.shape, trees=trees["id"], path=path, radius_m=far_m),
        seed=scenario.world_seed,
    )


def _path_m(scenario: Scenario, motion: Motion) -> F8:
    """Return positions (n, 3) of the sensor over the scene's duration; one if it stands still."""
    if not motion.moves:
        return motion.poses_at(np.array([scenario.start_ns])).world_p_body_m
    time_s = min(scenario.duration_s, motion.run_time_s)
    steps = np.linspace(0, seconds_to_ns(time_s), 2 + int(time_s * _STEPS_PER_S)).astype(np.int64)
    return motion.poses_at(scenario.start_ns + steps).world_p_body_m


def stand_rows(inventory: NDArray[np.void], species: Mapping[int, str], ground_m2: float) -> list[Tree]:
    """Return figures by species of an inventory (n,), the most frequent first.

    Figures of all trees follow if there are several species.
    """
    numbers, stems = np.unique(inventory["species"], return_counts=True)
    groups = [
        (species[int(number)], inventory[inventory["species"] == number])
        for number in numbers[np.argsort(-stems, kind="stable")]
    ]
    if len(groups) > 1:
        groups.append(("all", inventory))
    ground_ha = ground_m2 / 10_000
    rows = list[Tree]()
    for name, trees in groups:
        dbh_m = trees["dbh_m"]
        # The mean of diameters is quadratic.
        row = {"stems_per_ha": len(trees) / ground_ha, "dbh_mean_cm": 100 * np.sqrt(np.mean(dbh_m**2))}
        row |= {"dbh_min_cm": 100 * dbh_m.min(), "dbh_max_cm": 100 * dbh_m.max()}
        row |= {"height_mean_m": trees["height_m"].mean(), "height_max_m": trees["height_m"].max()}
        row["basal_area_m2_per_ha"] = np.sum(np.pi / 4 * dbh_m**2) / ground_ha
        row["stem_m3_per_ha"] = trees["stem_m3"].sum() / ground_ha  # volume of stems over bark
        row["leaf_area_index"] = trees["leaf_m2"].sum() / ground_m2  # of these trees, over the whole area
        rows.append(
            {"species": name, "stems": len(trees)} | {key: float(value) for key, value in row.items()}
        )
    return rows


def clark_evans(xy_m: F8, all_xy_m: F8, ground_m2: float) -> float:
    """Return the index of Clark and Evans (1954): 1 for a random pattern, less for clumps.

    It is the mean distance to the nearest neighbour over its expectation at random, and at most 2.149, for a
    regular pattern.

    Parameters
    ----------
    xy_m : (n, 2) points in the area, n >= 2
    all_xy_m : (m, 2) points in the area and around it: neighbours outside count, so the border needs no
        correction
    """
    nearest_m = np.asarray(KDTree(all_xy_m).query(xy_m, k=[2])[0])
    return float(nearest_m.mean() * 2 * np.sqrt(len(xy_m) / ground_m2))


def cells_near(path_xy_m: F8, radius_m: float) -> F8:
    """Return the centres (n, 2) of the cells of `CELL_M` within a radius of a line of points (m, 2).

    Their number times `CELL_M` squared is the area around the path.
    """
    low = np.floor((path_xy_m.min(axis=0) - radius_m) / CELL_M)
    high = np.ceil((path_xy_m.max(axis=0) + radius_m) / CELL_M)
    x_m, y_m = (CELL_M * (np.arange(a, b) + 0.5) for a, b in zip(low, high, strict=True))
    cells = np.stack(np.meshgrid(x_m, y_m, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(cells[Polyline(path_xy_m).distance_m(cells) <= radius_m])


def relief(cells_xy_m: F8, height_m: HeightField) -> dict[str, float]:
    """Return extremes of height and slope of the ground at points (n, 2), n >= 1.

    Slopes are over `CELL_M` in x and in y.
    """
    x_m, y_m = cells_xy_m.T
    half = CELL_M / 2
    rise_x = (height_m(x_m + half, y_m) - height_m(x_m - half, y_m)) / CELL_M
    rise_y = (height_m(x_m, y_m + half) - height_m(x_m, y_m - half)) / CELL_M
    slope_deg = np.degrees(np.arctan(np.hypot(rise_x, rise_y)))
    ground_m = height_m(x_m, y_m)
    return {
        "low_m": float(ground_m.min()),
        "high_m": float(ground_m.max()),
        "slope_mean_deg": float(slope_deg.mean()),
        "slope_max_deg": float(slope_deg.max()),
    }


def summary_of(scene: str, scenario: Scenario, seen: Survey, rows: NDArray[np.void]) -> Tree:
    """Summarise the survey of the scene named `scene`.

    The summary of any world has path and named objects, that of a forest also figures within the radius. The
    inventory `rows` has the trees within the radius, and perhaps others.
    """
    path_xy_m = seen.path_m[:, :2]
    length_m = float(np.hypot(*np.diff(path_xy_m, axis=0).T).sum())
    names = seen.names
    summary: Tree = {
        "scene": scene,
        "title": scenario.title,
        "seed": scenario.seed,
        "world": scenario.world.kind,
        # length 0 if the sensor stands still
        "path": {"length_m": length_m, "start_m": seen.path_m[0].tolist(), "end_m": seen.path_m[-1].tolist()},
        "radius_m": seen.radius_m,  # distance from the path within which objects are reported
        "named": [
            {
                "name": names[thing.instance],
                "kind": thing.kind,
                "instance": thing.instance,
                "place_m": thing.place_m.tolist(),
                "size_m": thing.size_m,
            }
            for thing in seen.things
            if thing.instance in names
        ],
    }
    if seen.hall is not None:
        return summary | {"hall_m": list(seen.hall.size_m)}
    cells = cells_near(path_xy_m, seen.radius_m)
    ground_m2 = len(cells) * CELL_M**2
    xy_m = places_m(seen.near, "xy")
    all_xy_m = places_m(seen.trees, "xy")
    near = rows[np.isin(rows["id"], seen.near["id"])]
    return summary | {
        "area_ha": ground_m2 / 10_000,
        "relief": relief(cells, seen.bare.height_m),
        "trees": stand_rows(near, seen.species, ground_m2),
        "clark_evans": clark_evans(xy_m, all_xy_m, ground_m2) if len(xy_m) > 1 else None,
        "things": _things(seen, ground_m2),
        "trees_in_reach": len(seen.trees),  # within the sensor's range
        **map_of(seen.path_m, near, seen.species, seen.bounds_m, seen.bare.height_m),
    }


def _things(seen: Survey, ground_m2: float) -> dict[str, Tree]:
    """Count unnamed objects by kind, with their species by frequency, and the extremes of their size."""
    kinds = dict[str, Tree]()
    nameless = [thing for thing in seen.things if thing.instance not in seen.names]
    for kind in sorted({thing.kind for thing in nameless}):
        things = [thing for thing in nameless if thing.kind == kind]
        measure, axis = _MEASURES[kind]
        sizes_m = [thing.size_m[axis] for thing in things]
        species = Counter(seen.species[thing.species] for thing in things if thing.species)
        kinds[kind] = {
            "count": len(things),
            "per_ha": len(things) / ground_m2 * 10_000,
            "measure": measure,
            "least_m": min(sizes_m),
            "greatest_m": max(sizes_m),
            "species": dict(species.most_common()),
        }
    return kinds


def write_survey(
    scene: str, scenario: Scenario, radius_m: float, wanted: Mapping[str, Path], *, bark: bool = False
) -> Tree:
    """Survey a scene, write the files of the options in `wanted`, and return the summary.

    With `bark` the stems of the summary have the share of their bark that is seen from the path. The files
    are opened before any long computation, and get their names together at the end. Raises InputError as
    `survey`; OutputError if a file cannot be created.
    """
    with ExitStack() as stack:
        outputs = {
            name: stack.enter_context(OutputFile(path, where=f"{name} {path}"))
            for name, path in wanted.items()
        }
        seen = survey(scenario, radius_m)
        rows = seen.inventory(seen.trees if "--inventory" in wanted else seen.near)
        summary = summary_of(scene, scenario, seen, rows)
        if bark and "stems" in summary:
            summary["stems"]["bark_seen"] = _bark_seen(seen, rows, scenario)
        for name, output in outputs.items():
            file = stack.enter_context(output.writing())
            _write(name, file, seen, rows)
            file.flush()  # here, so that no file gets its name if the disk is full
    return summary


def _bark_seen(seen: Survey, rows: NDArray[np.void], scenario: Scenario) -> list[float]:
    """Return the share of bark that is seen of the stems within the radius.

    Stems are in the order of the inventory `rows`.
    """
    near = rows[np.isin(rows["id"], seen.near["id"])]
    share = bark_seen(
        seen.path_m,
        near,
        seen.world,
        seen.window,
        scenario.start_ns,
        reach_m=scenario.sensor.max_range_m,
        field_deg=seen.field_deg,
    )
    return [round(float(value), 3) for value in share]


def _write(name: str, file: BinaryIO, seen: Survey, rows: NDArray[np.void]) -> None:
    """Write the file of an option; `rows` is the inventory of the trees that `--inventory` lists."""
    if name == "--inventory":  # all trees within the sensor's range
        write_csv(file, rows, table=seen.plants.trees)
    elif name == "--stems":  # skeletons with radii, as in a QSM
        text: Tree = {"fmt": [*["%d"] * 4, *["%.4f"] * 5], "delimiter": ",", "comments": ""}
        np.savetxt(file, seen.stem_circles(seen.trees), header=",".join(STEM_CIRCLE.names or ()), **text)
    elif name == "--ground":
        write_ascii(file, seen.bare.height_m, *seen.bounds_m, _GROUND_CELL_M)
    else:  # everything within the radius, or the whole hall, as a twin
        at_m = {thing.instance: thing.place_m for thing in seen.things}
        at_m |= dict(zip(seen.near["id"].tolist(), places_m(seen.near), strict=True))
        look: Tree = {"species": seen.species, "colours": surface_colours(seen.window.surfaces, seen.species)}
        inside = None if seen.hall else seen.inside
        write_glb(file, seen.window, seen.world.shape, places_m=at_m, inside=inside, **look)
