"""From the sections of a scenario to the parts of an emulator. Builds no geometry yet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from vlp16emu.device import GpsInput
from vlp16emu.motion import Gait, Motion, Path, Standing, Walking
from vlp16emu.random import Purpose
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.given import MeshFile
from vlp16emu.scenario.motion import Static
from vlp16emu.scenario.world import Clusters as ClustersSection
from vlp16emu.scenario.world import Forest as ForestSection
from vlp16emu.scenario.world import Hall as HallSection
from vlp16emu.scenario.world import HardCore as HardCoreSection
from vlp16emu.scenario.world import Pattern as PatternSection
from vlp16emu.scenario.world import Plantation as PlantationSection
from vlp16emu.scenario.world import Plot as PlotSection
from vlp16emu.scenario.world import Scattered as ScatteredSection
from vlp16emu.scenario.world import Storey as StoreySection
from vlp16emu.scenario.world import Woods as WoodsSection
from vlp16emu.sensor import BEAM_TABLES, Clock, Head, Rotor
from vlp16emu.types import HeightField, PlantPart, Semantic, SensorModel, World
from vlp16emu.units import seconds_to_ns
from vlp16emu.world import (
    Box,
    Clusters,
    Dem,
    Flora,
    Forest,
    Furnished,
    Furniture,
    GivenStand,
    Grass,
    Hall,
    HardCore,
    Layer,
    Logs,
    Look,
    Pattern,
    Place,
    Pole,
    Polyline,
    Rows,
    Saplings,
    Scattered,
    Shrubs,
    Species,
    SpeciesMix,
    Sphere,
    Stand,
    Stones,
    Storey,
    Stumps,
    Terrain,
    density_per_ha,
    flora,
    load_mesh,
    looks_of,
    read_stem_list,
    stones_per_ha,
)

__all__ = ["Parts", "assemble"]

_STRAY_M = 1.0
"""How far the sensor may be from its path over the ground: sway, and lasers off the centre."""


@dataclass(frozen=True, slots=True)
class Parts:
    """What an emulator is made of."""

    head: Head
    motion: Motion
    world: World
    gps: GpsInput


def assemble(scenario: Scenario) -> Parts:
    """Make the parts that a scenario describes.

    Raises
    ------
    InputError
        where a part cannot be made of what its section says
    """
    section, reach_m = scenario.world, scenario.sensor.max_range_m + _STRAY_M
    if isinstance(section, HallSection):
        motion, _ = _motion(scenario, lambda x_m, _y_m: np.zeros_like(x_m))
        hall = _furnished(_hall(section), section.meshes, reach_m)
        return Parts(_head(scenario), motion, hall, _gps(scenario))
    ground = _ground(section, scenario.seed)
    motion, path_xy_m = _motion(scenario, ground.height_m)
    if isinstance(ground, Dem):
        ground.check(path_xy_m, reach_m)
    forest = _forest(section, scenario.seed, ground.height_m, Polyline(path_xy_m), reach_m)
    world = _furnished(forest, section.meshes, reach_m)
    return Parts(_head(scenario), motion, world, _gps(scenario))


def _ground(section: WoodsSection, seed: int) -> Terrain | Dem:
    """Make the ground, or read it."""
    if section.dem is None:
        return Terrain(seed=seed, **section.terrain.model_dump(exclude={"relief"}))
    file, cell_m, corner_m = section.dem.file, section.dem.cell_m, section.dem.corner_m
    return Dem(FilePath(file), cell_m=cell_m, corner_m=corner_m, origin_m=section.origin_m)


def _forest(
    section: ForestSection | PlotSection, seed: int, height_m: HeightField, path: Polyline, reach_m: float
) -> Forest:
    """Make the forest."""
    plants = flora(FilePath(section.species_file) if section.species_file else None)
    stems: Stand | GivenStand
    if isinstance(section, PlotSection):
        stems, canopy = _given_stand(section, seed, height_m, path, plants.trees)
    else:
        stems, canopy = _stand(section, seed, height_m, path, plants), [s.species for s in section.species]
    return Forest(
        seed=seed,
        height_m=height_m,
        stems=stems,
        layers=[layer for layer in _layers(section, seed, canopy, plants) if layer.per_ha],
        path=path,
        path_clearance_m=section.path_clearance_m,
        reach_m=reach_m,
        plants=plants,
    )


def _given_stand(
    section: PlotSection, seed: int, height_m: HeightField, path: Polyline, table: Mapping[str, Species]
) -> tuple[GivenStand, list[str]]:
    """Make a stand of given trees, and tell what species they are."""
    file = FilePath(section.stem_list)
    trees = read_stem_list(file, table, section.origin_m)
    stand = GivenStand(
        seed=seed,
        height_m=height_m,
        source=file,
        trees=trees,
        table=table,
        path=path,
        path_clearance_m=section.path_clearance_m,
        season=section.season,
        dead_branches=section.dead_branches,
    )
    return stand, [name for name, species in table.items() if species.number in trees["species"]]


def _stand(section: ForestSection, seed: int, height_m: HeightField, path: Polyline, plants: Flora) -> Stand:
    """Make a stand that grows itself."""
    purposes = (Purpose.STAND, Purpose.SECOND_STOREY, Purpose.THIRD_STOREY)
    return Stand(
        seed=seed,
        height_m=height_m,
        storeys=[
            _storey(storey, seed, purpose)
            for storey, purpose in zip((section, *section.storeys), purposes, strict=False)
        ],
        path=path,
        path_clearance_m=section.path_clearance_m,
        season=section.season,
        dead_branches=section.dead_branches,
        plants=plants,
    )


def _storey(section: StoreySection, seed: int, purpose: Purpose) -> Storey:
    """One storey, with its density from its basal area where that is given."""
    species = [SpeciesMix(**share.model_dump()) for share in section.species]
    per_ha = section.stems_per_ha or density_per_ha(section.basal_area_m2_per_ha, species)
    return Storey(_pattern(section.pattern, seed, purpose, per_ha), species)


def _layers(section: WoodsSection, seed: int, canopy: list[str], plants: Flora) -> list[Layer]:
    """All that grows and lies under the trees."""
    young, shrubs, logs, stumps = section.regeneration, section.shrubs, section.logs, section.stumps

    def scattered(purpose: Purpose, per_ha: float) -> Pattern:
        return Scattered(seed=seed, purpose=purpose, per_ha=per_ha)

    return [
        Saplings(
            pattern=_pattern(young.pattern, seed, Purpose.REGENERATION, young.stems_per_ha),
            species=young.species or [name for name in canopy if plants.trees[name].foliage],
            height_m=young.height_m,
            season=section.season,
            plants=plants,
        ),
        Shrubs(
            pattern=_pattern(shrubs.pattern, seed, Purpose.SHRUBS, shrubs.per_ha),
            species=shrubs.species,
            season=section.season,
            plants=plants,
        ),
        Stones(scattered(Purpose.STONES, stones_per_ha(section.stones.cover))),
        Logs(
            scattered(Purpose.LOGS, logs.per_ha),
            logs.species or canopy,
            logs.diameter_m,
            logs.length_m,
            plants,
        ),
        Stumps(
            scattered(Purpose.STUMPS, stumps.per_ha),
            stumps.species or canopy,
            stumps.diameter_m,
            stumps.height_m,
            plants,
        ),
        Grass(scattered(Purpose.GRASS, 10_000 * section.grass.tufts_per_m2), section.grass.height_m),
    ]


def _pattern(section: PatternSection, seed: int, purpose: Purpose, per_ha: float) -> Pattern:
    """Make a point pattern of some density."""
    match section:
        case ClustersSection():
            return Clusters(
                seed=seed,
                purpose=purpose,
                per_ha=per_ha,
                per_cluster=section.per_cluster,
                sigma_m=section.sigma_m,
            )
        case PlantationSection():
            return Rows(
                seed=seed,
                purpose=purpose,
                per_ha=per_ha,
                row_spacing_m=section.row_spacing_m,
                tree_spacing_m=section.tree_spacing_m,
                azimuth_deg=section.azimuth_deg,
                jitter_m=section.jitter_m,
            )
        case HardCoreSection():
            return HardCore(seed=seed, purpose=purpose, per_ha=per_ha)
        case ScatteredSection():
            return Scattered(seed=seed, purpose=purpose, per_ha=per_ha)


def _furnished(world: Forest | Hall, files: Sequence[MeshFile], reach_m: float) -> World:
    """Put the user's own meshes into a world."""
    if not files:
        return world
    return Furnished(world, furniture=[_furniture(file) for file in files], reach_m=reach_m)


def _furniture(section: MeshFile) -> Furniture:
    """Read a mesh, and tell what its parts are and where it stands."""
    mesh = load_mesh(FilePath(section.file), unit=section.unit, up=section.up)
    own = {
        part.name: _look(
            section.reflectance if part.reflectance is None else part.reflectance,
            part.semantic or section.semantic,
            part.part or section.part,
        )
        for part in section.parts
    }
    common = _look(section.reflectance, section.semantic, section.part)
    places = tuple(Place(**place.model_dump()) for place in section.places)
    return Furniture(mesh, looks_of(mesh, common, own), places, section.one_thing)


def _look(reflectance: float, semantic: str, part: str) -> Look:
    """Say what a part of a mesh is, from the names in the scene."""
    return Look(reflectance, Semantic[semantic.upper()], PlantPart[part.upper()])


def _hall(section: HallSection) -> Hall:
    """Make the room."""
    return Hall(
        length_m=section.length_m,
        width_m=section.width_m,
        height_m=section.height_m,
        wall_reflectance=section.wall_reflectance,
        boxes=[Box(**box.model_dump()) for box in section.boxes],
        poles=[Pole(**pole.model_dump()) for pole in section.poles],
        spheres=[Sphere(**sphere.model_dump()) for sphere in section.spheres],
    )


def _motion(scenario: Scenario, height_m: HeightField) -> tuple[Motion, NDArray[np.float64]]:
    """Motion over the given ground, and its way on the map (n, 2)."""
    section = scenario.motion
    if isinstance(section, Static):
        xy_m = np.array([[section.x_m, section.y_m]])
        position_m = np.append(xy_m[0], height_m(xy_m[:, 0], xy_m[:, 1])[0] + section.height_m)
        return Standing(position_m, section.yaw_deg, section.pitch_deg, section.roll_deg), xy_m
    path = Path(np.array(section.way_points_m), height_m)
    walking = Walking(
        path,
        start_ns=scenario.start_ns,
        speed_m_s=section.speed_m_s,
        sensor_height_m=section.sensor_height_m,
        pitch_deg=section.pitch_deg,
        roll_deg=section.roll_deg,
        gait=Gait(**section.gait.model_dump()),
    )
    return walking, path.xy_m


def _head(scenario: Scenario) -> Head:
    """Make the sensor proper."""
    section = scenario.sensor
    rotor = Rotor(
        rpm=section.rpm,
        start_azimuth_deg=section.start_azimuth_deg,
        eccentricity_deg=section.eccentricity_deg,
        eccentricity_phase_deg=section.eccentricity_phase_deg,
        noise_deg=section.azimuth_noise_deg,
        seed=scenario.seed,
    )
    clock = Clock(
        locked=scenario.gps.connected,
        power_up_ns=scenario.start_ns - seconds_to_ns(section.powered_for_s),
        error_ppm=section.clock_error_ppm,
    )
    return Head(BEAM_TABLES[SensorModel(section.model)], rotor, clock, scenario.start_ns)


def _gps(scenario: Scenario) -> GpsInput:
    """Make what is wired to the sensor."""
    return GpsInput(scenario.gps.connected, seconds_to_ns(scenario.gps.sentence_delay_s))
