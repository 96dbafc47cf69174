"""Survey for `vlp16emu forest` and the page: all that stands near the path of a sensor."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Parts, assemble
from vlp16emu.errors import InputError
from vlp16emu.extras.sheets.seen import stems_seen, tables_of_returns
from vlp16emu.forest.plants.crown import CrownKey
from vlp16emu.forest.plants.flora import Flora, flora
from vlp16emu.forest.plants.stem_rings import stem_circles
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.stand.inventory import INVENTORY, Models, branch_circles, inventory
from vlp16emu.forest.stand.nearby import Thing, things_near
from vlp16emu.forest.stand.stand import REGENERATION, TREE
from vlp16emu.motion.pose import Motion
from vlp16emu.scenario import Scenario
from vlp16emu.types import F8, Window, World
from vlp16emu.units import seconds_to_ns
from vlp16emu.world.furnished import Furnished
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.polyline import Polyline
from vlp16emu.world.vectors import places_m

_STEPS_PER_S = 10
"""Rate of the points of the path: some 12 cm apart at walking speed."""


@dataclass(frozen=True, slots=True)
class Survey:
    """Trees and ground near the path."""

    world: World
    bare: ForestWorld | HallWorld
    """The world without the user's own meshes."""
    path_m: F8
    """(n, 3) sensor positions in order of time; one if the sensor stands still."""
    field_of_view_deg: tuple[float, float]
    """Elevations of the sensor's lowest and highest beam."""
    radius_m: float
    """Distance from the path within which things are reported."""
    window: Window
    """All within the sensor's range."""
    trees: NDArray[np.void]
    """(n,) `TREE` within the sensor's range, without saplings."""
    near: NDArray[np.void]
    """(m,) `TREE` within the radius."""
    things: list[Thing]
    """Everything else within the radius."""
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
    def models(self) -> Models:
        """Trees of the user's own models."""
        return self.bare.models if isinstance(self.bare, ForestWorld) else Models()

    @property
    def species(self) -> dict[int, str]:
        """Names of species by number."""
        return self.plants.names

    @property
    def names(self) -> Mapping[int, str]:
        """Names by instance, of things that have one."""
        named = (one for one in (self.world, self.bare) if isinstance(one, HallWorld | Furnished))
        return {instance: name for one in named for instance, name in one.names.items()}

    @property
    def bounds_m(self) -> tuple[F8, F8]:
        """South-west and north-east corner (2,) of the hall, or of the rectangle around everything within the radius."""
        if self.hall is not None:
            corner_m = np.array(self.hall.size_m[:2]) / 2
            return -corner_m, corner_m
        xy_m = self.path_m[:, :2]
        return xy_m.min(axis=0) - self.radius_m, xy_m.max(axis=0) + self.radius_m

    def inventory(self, trees: NDArray[np.void]) -> NDArray[np.void]:
        """Return the inventory of some of the trees (k,)."""
        is_modelled, rows = self.models.has(trees), np.zeros(len(trees), INVENTORY)
        grown = trees[~is_modelled]
        rows[~is_modelled] = inventory(grown, self._crowns(grown), seed=self.seed, table=self.plants.trees)
        rows[is_modelled] = self.models.inventory(trees[is_modelled])
        return rows

    def stems_seen(self, trees: NDArray[np.void], folder: Path) -> NDArray[np.void]:
        """Return `STEM_SEEN` of some of the trees (k,): what the returns of a run show of them, by its truth in `folder`."""
        is_modelled, trees = self.models.has(trees), trees.copy()
        trees["form"][is_modelled] = 0  # straight
        return stems_seen(trees, tables_of_returns(folder), table=self.plants.trees)

    def stem_circles(self, trees: NDArray[np.void]) -> NDArray[np.void]:
        """Return circles `STEM_CIRCLE` along the stems of some of the trees (k,), and along the branches of the near ones, by tree."""
        is_modelled = self.models.has(trees)
        grown = trees[~is_modelled]
        stems = stem_circles(grown, table=self.plants.trees)
        near = grown[np.isin(grown["id"], self.near["id"])]
        branches = branch_circles(near, self._crowns(near), seed=self.seed, table=self.plants.trees)
        circles = np.concatenate([stems, self.models.circles(trees[is_modelled]), branches])
        return circles[np.argsort(circles["tree"], kind="stable")]

    def _crowns(self, trees: NDArray[np.void]) -> list[CrownKey]:
        """Return the crown prototypes of trees without a model."""
        window = self.window
        instance = window.surfaces["instance"][window.first_surface].tolist()
        shapes = (window.shapes[i] for i in window.shape)
        crowns = {i: key for i, key in zip(instance, shapes, strict=True) if isinstance(key, CrownKey)}
        return [crowns[i] for i in trees["id"].tolist()]

    def inside(self, xy_m: F8) -> NDArray[np.bool_]:
        """Return which points (k, 2) lie within the radius."""
        within: NDArray[np.bool_] = Polyline(self.path_m[:, :2]).distance_m(xy_m) <= self.radius_m
        return within


def survey(scenario: Scenario, radius_m: float, parts: Parts | None = None, path_xy_m: F8 | None = None) -> Survey:
    """Survey the surroundings of the path of a scenario's sensor, or of `path_xy_m` (n, 2) if its motion is not known yet.

    InputError if a part of the scenario cannot be made, or the radius exceeds the sensor's range.
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
    path, window = Polyline(path_m[:, :2]), world.window(path_m)
    trees = bare.trees(path_m) if isinstance(bare, ForestWorld) else np.zeros(0, TREE)
    trees = trees[trees["storey"] != REGENERATION]
    gap_m = path.distance_m(places_m(trees, "xy"))
    far_m = np.inf if isinstance(bare, HallWorld) else radius_m
    return Survey(
        world=world,
        bare=bare,
        path_m=path_m,
        field_of_view_deg=(float(beams_deg.min()), float(beams_deg.max())),
        radius_m=radius_m,
        window=window,
        trees=trees[gap_m <= reach_m],
        near=trees[gap_m <= radius_m],
        things=things_near(window, world.shape, trees=trees["id"], path=path, radius_m=far_m),
        seed=scenario.world_seed,
    )


def way_m(scenario: Scenario, motion: Motion) -> F8:
    """Return positions (n, 3) of the sensor over the scene's duration; one if it stands still."""
    if not motion.moves:
        return motion.poses_at(np.array([scenario.start_ns])).world_p_body_m
    time_s = min(scenario.duration_s, motion.run_time_s)
    steps = np.linspace(0, seconds_to_ns(time_s), 2 + int(time_s * _STEPS_PER_S)).astype(np.int64)
    return motion.poses_at(scenario.start_ns + steps).world_p_body_m
