"""From the `[world]` table to a forest or a hall."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError
from vlp16emu.random import Purpose
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.finish import Finish
from vlp16emu.scenario.given import MeshFile
from vlp16emu.scenario.world import MOST_STEMS_PER_HA
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
from vlp16emu.types import HeightField, PlantPart, Semantic, World
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
    Wind,
    density_per_ha,
    flora,
    load_mesh,
    looks_of,
    read_stem_list,
    stones_per_ha,
)

__all__ = ["forest_of", "furnished", "ground_name", "ground_of", "hall_of", "wind_of"]


def ground_of(section: WoodsSection, seed: int) -> Terrain | Dem:
    """Make the ground, or read it."""
    if section.dem is None:
        return Terrain(seed=seed, **section.terrain.model_dump(exclude={"relief"}))
    file, cell_m, corner_m = section.dem.file, section.dem.cell_m, section.dem.corner_m
    return Dem(FilePath(file), cell_m=cell_m, corner_m=corner_m, origin_m=section.origin_m)


def ground_name(section: WoodsSection, seed: int) -> str:
    """Digest of all that decides the ground."""
    own = section.model_dump_json(include={"dem", "origin_m", "terrain"})
    text = "\n".join([own, _content(section.dem.file if section.dem else None), str(seed)])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def forest_of(
    section: ForestSection | PlotSection,
    seed: int,
    height_m: HeightField,
    path: Polyline,
    reach_m: float,
    *,
    near_m: float,
    loose_stems: bool,
) -> Forest:
    """Make the forest."""
    plants = flora(FilePath(section.species_file) if section.species_file else None)
    stems: Stand | GivenStand
    if isinstance(section, PlotSection):
        stems, canopy = _given_stand(section, seed, height_m, path, plants.trees)
        stems.check(path, reach_m)
    else:
        stems, canopy = _stand(section, seed, height_m, path, plants), [s.species for s in section.species]
    return Forest(
        name=_name(section, str(seed), path, reach_m, loose_stems=loose_stems),
        plants_name=_content(section.species_file),
        seed=seed,
        height_m=height_m,
        stems=stems,
        layers=[layer for layer in _layers(section, seed, canopy, plants) if layer.per_ha],
        path=path,
        path_clearance_m=section.path_clearance_m,
        reach_m=reach_m,
        plants=plants,
        loose_stems=loose_stems,
        near_m=near_m,
    )


def _name(
    section: ForestSection | PlotSection, seed: str, path: Polyline, reach_m: float, *, loose_stems: bool
) -> str:
    """Digest of all that decides a forest, files by what they hold."""
    dem_file = section.dem.file if section.dem else None
    stem_list = section.stem_list if isinstance(section, PlotSection) else None
    files: list[str | None] = [section.species_file, dem_file, stem_list]
    parts = [section.model_dump_json(exclude={"meshes", "near_m"}), seed, f"{reach_m!r} {loose_stems}"]
    digest = hashlib.sha256("\n".join([*parts, *map(_content, files), ""]).encode())
    digest.update(np.ascontiguousarray(path.xy_m, np.float64).tobytes())
    return digest.hexdigest()[:32]


def _content(file: str | None) -> str:
    """Digest of what a file holds; nothing where none is given."""
    return hashlib.sha256(FilePath(file).read_bytes()).hexdigest()[:32] if file else ""


def wind_of(scenario: Scenario, forest: Forest) -> Wind | None:
    """Make the wind that moves a forest of loose stems; none in still air."""
    section, world = scenario.wind, scenario.world
    if section is None or not section.speed_m_s or not isinstance(world, WoodsSection):
        return None
    return Wind(
        seed=scenario.seed,
        trees=forest.trees,
        plants=forest.plants,
        season=world.season,
        start_ns=scenario.start_ns,
        **section.model_dump(),
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
    if per_ha > MOST_STEMS_PER_HA:
        raise GeometryError(
            "basal_area_m2_per_ha",
            f"found {section.basal_area_m2_per_ha:g}, {per_ha:.0f} stems of that size per ha",
            f"at most {MOST_STEMS_PER_HA}",
        )
    return Storey(_pattern(section.pattern, seed, purpose, per_ha), species)


def _layers(section: WoodsSection, seed: int, canopy: list[str], plants: Flora) -> list[Layer]:
    """All that grows and lies under the trees."""
    young, shrubs, logs, stumps = section.regeneration, section.shrubs, section.logs, section.stumps
    living = young.species or [name for name in canopy if plants.trees[name].foliage]
    if young.stems_per_ha and not living:
        raise GeometryError(
            "regeneration.species", "found none, and only dead trees above", "names of species"
        )

    def scattered(purpose: Purpose, per_ha: float) -> Pattern:
        """Places of plants that know nothing of each other."""
        return Scattered(seed=seed, purpose=purpose, per_ha=per_ha)

    return [
        Saplings(
            pattern=_pattern(young.pattern, seed, Purpose.REGENERATION, young.stems_per_ha),
            species=living,
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


def furnished(
    world: Forest | Hall, files: Sequence[MeshFile], path_xy_m: NDArray[np.float64], reach_m: float
) -> World:
    """Put the user's own meshes into a world, and warn of those that nobody sees from the path (n, 2)."""
    if not files:
        return world
    made = Furnished(world, furniture=[_furniture(file) for file in files], reach_m=reach_m)
    made.check(path_xy_m)
    return made


def _furniture(section: MeshFile) -> Furniture:
    """Read a mesh, and tell what its parts are and where it stands."""
    mesh = load_mesh(FilePath(section.file), unit=section.unit, up=section.up)
    own = {
        part.name: _look(
            section.brightness if part.brightness is None else part.brightness,
            part.semantic or section.semantic,
            part.part or section.part,
        )
        for part in section.parts
    }
    common = _look(section.brightness, section.semantic, section.part)
    places = tuple(Place(**place.model_dump()) for place in section.places)
    return Furniture(mesh, looks_of(mesh, common, own), places, section.one_thing)


def _look(reflectance: float, semantic: str, part: str) -> Look:
    """Say what a part of a mesh is, from the names in the scene."""
    return Look(reflectance, Semantic[semantic.upper()], PlantPart[part.upper()])


def hall_of(section: HallSection) -> Hall:
    """Make the room."""
    return Hall(
        length_m=section.length_m,
        width_m=section.width_m,
        height_m=section.height_m,
        wall_reflectance=section.wall_reflectance,
        boxes=[Box(**_told(box)) for box in section.boxes],
        poles=[Pole(**_told(pole)) for pole in section.poles],
        spheres=[Sphere(**_told(sphere)) for sphere in section.spheres],
    )


def _told(thing: Finish) -> dict[str, Any]:
    """Say what a thing of the hall is, its finish as one number."""
    return thing.model_dump(exclude=set(thing.either_or)) | {"reflectance": thing.brightness}
