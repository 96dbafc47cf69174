"""What `vlp16emu forest` looks at: all that stands near the path of a sensor, gathered once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Parts, assemble
from vlp16emu.errors import InputError
from vlp16emu.extras.sheets.seen import stems_seen, tables_of_returns
from vlp16emu.forest.plants.circles import branch_circles
from vlp16emu.forest.plants.crown import CrownKey
from vlp16emu.forest.plants.flora import Flora, flora
from vlp16emu.forest.plants.stem_rings import stem_circles
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.stand.inventory import INVENTORY, Models, inventory
from vlp16emu.forest.stand.nearby import Thing, things_near
from vlp16emu.forest.stand.stand import REGENERATION, TREE
from vlp16emu.motion.pose import Motion
from vlp16emu.scenario import Scenario
from vlp16emu.types import HeightField, Mesh, ShapeKey, Window
from vlp16emu.units import seconds_to_ns
from vlp16emu.world.furnished import Furnished
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.polyline import Polyline
from vlp16emu.world.vectors import places_m

Array = NDArray[np.float64]

_STEPS_PER_S = 10
"""Points of the path: a hand's breadth apart at a walker's speed."""


@dataclass(frozen=True, slots=True)
class Survey:
    """What stands near the path."""

    grow: Callable[[ShapeKey], tuple[Mesh, ...]]
    """Meshes of a shape of the world."""
    hall: HallWorld | None
    """The hall, where the world is one."""
    height_m: HeightField
    path_m: Array
    """(n, 3) sensor positions; one where it stands."""
    field_of_view_deg: tuple[float, float]
    """Elevations of the sensor's lowest and highest beam."""
    radius_m: float
    """Of the surroundings that are looked at."""
    window: Window
    """All in the sensor's reach."""
    trees: NDArray[np.void]
    """(n,) `TREE` in the sensor's reach, without saplings."""
    near: NDArray[np.void]
    """(m,) those of them that stand in the surroundings."""
    things: list[Thing]
    """Everything else in the surroundings."""
    plants: Flora
    """Trees and shrubs."""
    models: Models
    """The user's own, some of the trees."""
    names: Mapping[int, str]
    """Of things that have one, by instance."""
    seed: int

    @property
    def species(self) -> dict[int, str]:
        """Names of trees and shrubs by number."""
        return self.plants.names

    def inventory(self, trees: NDArray[np.void]) -> NDArray[np.void]:
        """Take the inventory of some of the trees (k,)."""
        is_modelled, rows = self.models.has(trees), np.zeros(len(trees), INVENTORY)
        grown = trees[~is_modelled]
        rows[~is_modelled] = inventory(grown, self._crowns(grown), seed=self.seed, table=self.plants.trees)
        rows[is_modelled] = self.models.inventory(trees[is_modelled])
        return rows

    def stems_seen(self, trees: NDArray[np.void], folder: Path) -> NDArray[np.void]:
        """Sum up what the returns of a run show of the stems of some of the trees (k,), by the folder of its truth."""
        straight = np.where(self.models.has(trees), 0, trees["form"])
        trees = trees.copy()
        trees["form"] = straight
        return stems_seen(trees, tables_of_returns(folder), table=self.plants.trees)

    def stem_circles(self, trees: NDArray[np.void]) -> NDArray[np.void]:
        """Circles `STEM_CIRCLE` along the stems of some of the trees (k,), and along the branches of those near, by tree."""
        is_modelled = self.models.has(trees)
        grown = trees[~is_modelled]
        stems = stem_circles(grown, table=self.plants.trees)
        near = grown[np.isin(grown["id"], self.near["id"])]
        branches = branch_circles(near, self._crowns(near), seed=self.seed, table=self.plants.trees)
        circles = np.concatenate([stems, self.models.circles(trees[is_modelled]), branches])
        return circles[np.argsort(circles["tree"], kind="stable")]

    def _crowns(self, trees: NDArray[np.void]) -> list[CrownKey]:
        """Name the crown prototypes of trees that have grown."""
        window = self.window
        instance = window.surfaces["instance"][window.first_surface].tolist()
        shapes = (window.shapes[i] for i in window.shape)
        crowns = {i: key for i, key in zip(instance, shapes, strict=True) if isinstance(key, CrownKey)}
        return [crowns[i] for i in trees["id"].tolist()]

    def inside(self, xy_m: Array) -> NDArray[np.bool_]:
        """Which points (k, 2) lie in the surroundings."""
        within: NDArray[np.bool_] = Polyline(self.path_m[:, :2]).distance_m(xy_m) <= self.radius_m
        return within


def survey(scenario: Scenario, radius_m: float, parts: Parts | None = None, path_xy_m: Array | None = None) -> Survey:
    """Look around the path of a scenario's sensor, or around `path_xy_m` (n, 2) where its motion is not known yet.

    InputError where a part of the scenario cannot be made, or the sensor does not see as far as the radius.
    """
    reach_m = scenario.sensor.max_range_m
    if radius_m > reach_m:
        raise InputError("--radius", f"found {radius_m:g}", f"at most {reach_m:g}, which is the sensor's reach")
    parts = parts or assemble(scenario)
    beams_deg, world = parts.head.beams.elevation_deg, parts.world
    bare = world.bare if isinstance(world, Furnished) else world
    assert isinstance(bare, ForestWorld | HallWorld)
    if path_xy_m is None:
        path_m = way_m(scenario, parts.motion)
    else:
        path_m = np.column_stack([path_xy_m, bare.height_m(*path_xy_m.T)])
    path = Polyline(path_m[:, :2])
    window = world.window(path_m)
    trees = bare.trees(path_m) if isinstance(bare, ForestWorld) else np.zeros(0, TREE)
    trees = trees[trees["storey"] != REGENERATION]
    gap_m = path.distance_m(places_m(trees, "xy"))
    far_m = np.inf if isinstance(bare, HallWorld) else radius_m
    names = (one.names for one in (world, bare) if isinstance(one, HallWorld | Furnished))
    return Survey(
        grow=world.shape,
        hall=bare if isinstance(bare, HallWorld) else None,
        height_m=bare.height_m,
        path_m=path_m,
        field_of_view_deg=(float(beams_deg.min()), float(beams_deg.max())),
        radius_m=radius_m,
        window=window,
        trees=trees[gap_m <= reach_m],
        near=trees[gap_m <= radius_m],
        things=things_near(window, world.shape, trees=trees["id"], path=path, radius_m=far_m),
        plants=bare.plants if isinstance(bare, ForestWorld) else flora(),
        models=bare.models if isinstance(bare, ForestWorld) else Models(),
        names={instance: name for known in names for instance, name in known.items()},
        seed=scenario.world_seed,
    )


def way_m(scenario: Scenario, motion: Motion) -> Array:
    """Positions (n, 3) of the sensor over the scene's duration."""
    if not motion.moves:
        return motion.poses_at(np.array([scenario.start_ns])).world_p_body_m
    time_s = min(scenario.duration_s, motion.run_time_s)
    steps = np.linspace(0, seconds_to_ns(time_s), 2 + int(time_s * _STEPS_PER_S)).astype(np.int64)
    return motion.poses_at(scenario.start_ns + steps).world_p_body_m
