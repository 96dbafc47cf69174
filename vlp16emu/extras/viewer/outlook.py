"""Outlook of a drawn walk: length, times and packets of its recording, and things in its way.

The curve and its timing are those of the walk itself, so that a recording does what is shown here.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec, norm
from vlp16emu.engine import Unit
from vlp16emu.engine.build import reach_of_path_m
from vlp16emu.engine.engine import number_at
from vlp16emu.errors import InputError
from vlp16emu.extras.survey import Survey
from vlp16emu.extras.viewer.draft import Draft, plan_of, walk_of
from vlp16emu.foliage.polyline import Corridor, Polyline
from vlp16emu.forest.make import ForestSite
from vlp16emu.forest.settings import Plot, Woods
from vlp16emu.forest.stand.floor_shapes import FloorKey, FloorKind
from vlp16emu.forest.stand.given_stand import listed_trees
from vlp16emu.forest.stand.stand import foot_discs, in_the_way_m, path_gap_m
from vlp16emu.scenario import Scenario, load
from vlp16emu.sensor.settings import Sensor
from vlp16emu.types import F8, Mesh, PacketKind, Semantic
from vlp16emu.units import seconds_to_ns
from vlp16emu.world.hall import HallWorld

Kind = Literal["refused", "stays", "left out", "unknown"]
"""What a recording does with a thing in the way: `refused`: there is no recording; `stays`: the sensor goes
through it; `left out`: the stand is grown without it; `unknown`: what stands there is not grown yet."""

_SOLID = frozenset(
    {
        FloorKind.STONE,
        FloorKind.LOG,
        FloorKind.BROKEN_LOG,
        FloorKind.STUMP,
        FloorKind.BROKEN_STUMP,
        FloorKind.ROOT_PLATE,
    }
)
"""Things on the ground that people walk around; they step over or through the others."""
_BODY_M = 0.25  # half the width of a person's shoulders in outdoor clothing, as of `extras.people`
_SAMPLE_M = 0.25  # greatest edge of the triangles whose corners stand for an object
_ABOUT_FAULT_M = 1.0  # length to either side of a fault that is marked
PER_S = 10  # the recording ends at a whole tenth of a second


@dataclass(frozen=True, slots=True)
class Mark:
    """A stretch of the path with something in its way."""

    kind: Kind
    words: str
    rows: NDArray[np.bool_]  # (n,) points of the path that belong to it


@dataclass(frozen=True, slots=True)
class Outlook:
    """Path of a draft, its recording, and the things in its way."""

    path_m: F8  # (n, 3) on the ground; through the way points without a curve if nobody can walk it
    marks: tuple[Mark, ...] = ()  # in order along the path
    length_m: float = 0.0  # this and the values below are 0 if nobody can walk it
    run_time_s: float = 0.0
    recorded_s: float = 0.0  # duration of the recording: the scene's, but no longer than the walk
    revolutions: float = 0.0  # of the first sensor
    data_packets: int = 0  # of all sensors; 0 for a sensor without packets
    position_packets: int = 0

    @property
    def refusal(self) -> str:
        """Reason for which `record` would refuse the scene; empty if it would not."""
        return next((mark.words for mark in self.marks if mark.kind == "refused"), "")


class Surroundings:
    """The ground of a scene and the stand that was grown on it, for the outlook of drafts.

    Parameters
    ----------
    scenario : scene with the first draft, in which the motion is a walk
    units : its sensors
    stand : the stand near the path for which the world was grown last
    """

    def __init__(self, scenario: Scenario, units: Sequence[Unit], stand: Survey) -> None:
        self._scenario = scenario
        self._walk = walk_of(scenario)
        self._first = Draft.of(scenario)
        self._units = units
        self._stand = stand
        self._site = scenario.world.site(scenario.world_seed)
        world = scenario.world
        self._clearance_m = _BODY_M
        if isinstance(world, Woods):
            self._clearance_m = world.path_clearance_m
        self._trees = listed_trees(world, scenario.world_seed) if isinstance(world, Plot) else stand.trees
        keeps_stems = isinstance(world, Plot) and world.on_conflict != "drop"
        self._stems: Kind = "refused" if keeps_stems else "left out"
        self._solids = [*_solids(stand, self._walk.sensor_height_m)]
        self._middle_m = np.array([solid.xy_m.mean(axis=0) for solid in self._solids]).reshape(-1, 2)
        pairs = zip(self._solids, self._middle_m, strict=True)
        self._reach_m = np.array([norm(solid.xy_m - middle_m).max() for solid, middle_m in pairs])

    def on_ground(self, xy_m: F8) -> F8:
        """Return points (n, 3) on the ground at places (n, 2)."""
        return np.column_stack([xy_m, self._site.height_m(*xy_m.T)])

    def settings(self, draft: Draft) -> dict[str, object]:
        """Return the keys of the scene that a draft changes; InputError if `record` would refuse it."""
        outlook = self.outlook(draft)
        if outlook.refusal:
            raise InputError("path", outlook.refusal)
        changed = draft.settings(self._first, self._walk)
        if outlook.recorded_s != self._scenario.duration_s:
            changed["duration_s"] = outlook.recorded_s
        return changed

    def outlook(self, draft: Draft) -> Outlook:
        """Return the outlook of a draft."""
        try:
            scenario = load(self._scenario, draft.settings(self._first, self._walk))
            route = walk_of(scenario).route(self._site, scenario.gps, is_stored=False)
        except InputError as error:
            return self._faulty(draft, error)
        path = route.path
        run_time_s = route.run_time_s
        recorded_s = scenario.duration_s
        if draft.is_whole or recorded_s > run_time_s:
            recorded_s = math.floor(run_time_s * PER_S) / PER_S
        marks = sorted(self._marks(path.xy_m, path.along_m), key=lambda mark: int(mark.rows.argmax()))
        data, position = (self._packets(kind, recorded_s) for kind in (PacketKind.DATA, PacketKind.POSITION))
        return Outlook(
            self.on_ground(path.xy_m),
            tuple(marks),
            length_m=route.length_m,
            run_time_s=run_time_s,
            recorded_s=recorded_s,
            revolutions=self._units[0].head.rotor.revolutions(seconds_to_ns(recorded_s)),
            data_packets=data,
            position_packets=position,
        )

    def _packets(self, kind: PacketKind, recorded_s: float) -> int:
        units = [unit for unit in self._units if isinstance(unit.section, Sensor)]
        ends_ns = 0, seconds_to_ns(recorded_s)
        counts = ([number_at(self._scenario, unit, kind, end_ns) for end_ns in ends_ns] for unit in units)
        return sum(last - first for first, last in counts)

    def _faulty(self, draft: Draft, error: InputError) -> Outlook:
        plan = plan_of(draft.xy_m)
        xy_m = draft.xy_m if plan is None else plan.xy_m
        rows = np.ones(len(xy_m), np.bool_)
        if error.at_m is not None:
            rows = norm(xy_m - np.array(error.at_m)) < _ABOUT_FAULT_M
        return Outlook(self.on_ground(xy_m), (Mark("refused", str(error), rows),))

    def _marks(self, xy_m: F8, along_m: F8) -> Iterator[Mark]:
        yield from self._off_ground(xy_m, along_m)
        path = Corridor(xy_m, self._clearance_m)
        yield from self._stem_marks(path, along_m)
        yield from self._solid_marks(path, along_m)
        if self._stand.hall is None:
            grown_m = Polyline(self._stand.path_m[:, :2]).distance_m(xy_m)
            if (rows := grown_m > self._stand.radius_m).any():
                beyond = (
                    f"farther than {self._stand.radius_m:g} m from the path for which the stand was grown"
                )
                yield Mark("unknown", f"{_stretch(along_m, rows)}: {beyond}", rows)

    def _off_ground(self, xy_m: F8, along_m: F8) -> Iterator[Mark]:
        site = self._site
        if isinstance(site, HallWorld) and (rows := ~site.has_ground(xy_m)).any():
            words = "outside the walls, where nothing is in sight"
            yield Mark("stays", f"{_stretch(along_m, rows)}: {words}", rows)
        reach_m = reach_of_path_m(self._scenario)
        if isinstance(site, ForestSite) and (rows := ~site.has_ground(xy_m, reach_m)).any():
            words = "no heights in the file, under it or in sight"
            yield Mark("refused", f"{_stretch(along_m, rows)}: {words}", rows)

    def _stem_marks(self, path: Corridor, along_m: F8) -> Iterator[Mark]:
        table = self._stand.plants.trees
        if not len(self._trees):
            return
        radius_m = foot_discs(self._trees, table=table)[:, 2]
        which = np.flatnonzero(path_gap_m(self._trees, radius_m, path) < path.clearance_m)
        for tree, stem_m in zip(self._trees[which], radius_m[which].tolist(), strict=True):
            rows = _near_stem(tree, stem_m + path.clearance_m, path.xy_m)
            name = self._stand.species[int(tree["species"])].replace("_", " ")
            words = f"stem of {name}, DBH {100 * tree['dbh_m']:.0f} cm"
            yield Mark(self._stems, f"{_stretch(along_m, rows)}: {words}", rows)

    def _solid_marks(self, path: Corridor, along_m: F8) -> Iterator[Mark]:
        gap_m = path.distance_m(self._middle_m) - self._reach_m
        for number in np.flatnonzero(gap_m < max(path.clearance_m, _BODY_M)).tolist():
            solid = self._solids[number]
            clearance_m = path.clearance_m if solid.kind == "left out" else _BODY_M
            if path.distance_m(solid.xy_m).min() < clearance_m:
                rows = _rows_near(path.xy_m, solid.xy_m, clearance_m)
                yield Mark(solid.kind, f"{_stretch(along_m, rows)}: {solid.name}", rows)


@dataclass(frozen=True, slots=True)
class _Solid:
    """An object on the ground that nobody walks through."""

    name: str
    kind: Kind
    xy_m: F8  # (k, 2) places that it occupies below the sensor


def _solids(stand: Survey, height_m: float) -> Iterator[_Solid]:
    """Yield the stones and dead wood that are drawn, the user's meshes, and the objects of a hall."""
    window = stand.window
    near = Polyline(stand.path_m[:, :2]).distance_m(window.world_T_shape[:, :2, 3]) <= stand.radius_m
    for placement, shape in enumerate(window.shape.tolist()):
        key = window.shapes[shape]
        surface = window.surfaces[window.first_surface[placement]]
        name = stand.names.get(int(surface["instance"]))
        is_thing = isinstance(key, FloorKey) and key.kind in _SOLID and near[placement]
        if not is_thing and (name is None or surface["semantic"] == Semantic.GROUND):
            continue
        world_T = window.world_T_shape[placement]
        meshes = [mesh for mesh in stand.world.shape(key) if len(mesh.faces)]
        points_m = np.concatenate([_sample(mesh, world_T) for mesh in meshes])
        low = points_m[:, 2] < stand.bare.height_m(points_m[:, 0], points_m[:, 1]) + height_m
        if low.any():
            kind: Kind = "left out" if name is None else "stays"
            yield _Solid(name or str(key.kind).replace("_", " "), kind, points_m[low, :2])


def _sample(mesh: Mesh, world_T_mesh: F8) -> F8:
    """Return points (k, 3) in the world from all over a mesh, 1 cm to `_SAMPLE_M` apart."""
    vertices_m = matvec(world_T_mesh[:, :3], mesh.vertices_m.astype(np.float64)) + world_T_mesh[:, 3]
    faces = mesh.faces
    if np.ptp(vertices_m, axis=0).max() <= _SAMPLE_M:
        return vertices_m
    import trimesh  # here: it takes a while to load

    if faces.shape[1] == 4:
        faces = np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])
    points_m, _ = trimesh.remesh.subdivide_to_size(vertices_m, faces, _SAMPLE_M, max_iter=20)
    return np.unique(np.round(points_m, 2), axis=0)


def _near_stem(tree: np.void, within_m: float, xy_m: F8) -> NDArray[np.bool_]:
    places_m = np.concatenate(in_the_way_m(np.array([tree])))
    return _rows_near(xy_m, places_m, within_m)


def _rows_near(xy_m: F8, places_m: F8, within_m: float) -> NDArray[np.bool_]:
    """Return a mask of the points (n, 2) of a path that are near places (k, 2), at least the nearest one."""
    from scipy.spatial import KDTree  # here: it takes a while to load

    gap_m = np.asarray(KDTree(places_m).query(xy_m)[0])
    within_m = max(within_m, float(gap_m.min()))  # the nearest place may be between two points of the path
    return np.asarray(gap_m <= within_m)


def _stretch(along_m: F8, rows: NDArray[np.bool_]) -> str:
    """Return begin and end of a stretch along the path in words."""
    first_m, last_m = along_m[rows][[0, -1]]
    return f"{first_m:.0f} m" if last_m - first_m < 1.5 else f"{first_m:.0f} to {last_m:.0f} m"
