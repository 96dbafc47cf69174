"""From what the user wrote to the ground, and to the world on it."""

import hashlib
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.forest.given.given_stand import GivenStand, stems_in_the_way
from vlp16emu.forest.given.tree_model import TreeModels
from vlp16emu.forest.ground.dem import DemHeights
from vlp16emu.forest.ground.terrain import TerrainHeights
from vlp16emu.forest.plants.flora import flora
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.stand.settings import Forest, Plot, Wind
from vlp16emu.forest.stand.stand import Stand
from vlp16emu.forest.stand.wind import TreeSway
from vlp16emu.types import World
from vlp16emu.world.furnished import Furnished, Furniture
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.mesh_settings import MeshFile
from vlp16emu.world.polyline import Corridor
from vlp16emu.world.settings import Hall
from vlp16emu.world.user_mesh import load_mesh

Array = NDArray[np.float64]


def ground_of(section: Forest | Plot | Hall, seed: int) -> TerrainHeights | DemHeights | HallWorld:
    """Make the ground, or read it; that of a hall is its floor."""
    if isinstance(section, Hall):
        return HallWorld(section)
    if section.dem is None:
        return TerrainHeights(section.terrain, seed=seed)
    return DemHeights(section.dem, origin_m=section.origin_m)


def ground_name(section: Forest | Plot | Hall, seed: int) -> str:
    """Digest of all that decides the ground."""
    if isinstance(section, Hall):
        return "flat"
    own = section.model_dump_json(include={"dem", "origin_m", "terrain"})
    text = "\n".join([own, _content(section.dem.file if section.dem else None), str(seed)])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def obstacles_of(section: Forest | Plot | Hall) -> tuple[Array, Array] | None:
    """Find what the path is to lead around, as of `stems_in_the_way`; None where it keeps its way.

    Raises
    ------
    GeometryError
        where the list of trees is wrong
    """
    if isinstance(section, Plot) and section.on_conflict == "move_path":
        return stems_in_the_way(section)
    return None


def world_of(
    section: Forest | Plot | Hall,
    wind: Wind | None,
    *,
    seed: int,
    start_ns: int,
    ground: TerrainHeights | DemHeights | HallWorld,
    path_xy_m: Array,
    reach_m: float,
    farthest_m: float,
) -> tuple[World, TreeSway | None]:
    """Make a world, and what moves its trees; None in still air.

    Parameters
    ----------
    seed : of the scenario
    start_ns : UTC of the run's first pulse
    ground : of the section
    path_xy_m : (n, 2) path of the sensors
    reach_m : from there, how far they see
    farthest_m : range of the one that sees farthest

    Raises
    ------
    GeometryError
        where the world cannot be made as it is written, or ends within reach
    """
    bare: ForestWorld | HallWorld
    sway = None
    if isinstance(section, Hall):
        bare = HallWorld(section)
        bare.check(path_xy_m)
    else:
        if isinstance(ground, DemHeights):
            ground.check(path_xy_m, reach_m)
        path, blows = Corridor(path_xy_m, section.path_clearance_m), wind is not None and wind.speed_m_s > 0
        # A sensor that sees no farther than `near_m` meets no medium: then none is made.
        near_m = section.near_m if section.near_m < farthest_m else math.inf
        bare = _forest(section, seed, ground, path, reach_m, near_m=near_m, loose_stems=blows)
        if wind is not None and blows:
            sway = TreeSway(wind, forest=bare, start_ns=start_ns)
    return _furnished(bare, section.meshes, path_xy_m, reach_m), sway


def _forest(
    section: Forest | Plot,
    seed: int,
    ground: TerrainHeights | DemHeights | HallWorld,
    path: Corridor,
    reach_m: float,
    *,
    near_m: float,
    loose_stems: bool,
) -> ForestWorld:
    plants, height_m = flora(section.species_file), ground.height_m
    trails = ground.trails if isinstance(ground, TerrainHeights) else None
    stems: Stand | GivenStand
    if isinstance(section, Plot):
        stems = GivenStand(section, seed=seed, height_m=height_m, path=path, plants=plants)
        stems.check(path, reach_m)
    else:
        stems = Stand(section, seed=seed, height_m=height_m, path=path, plants=plants, trails=trails)
    return ForestWorld(
        section,
        stems,
        seed=seed,
        height_m=height_m,
        path=path,
        reach_m=reach_m,
        plants=plants,
        trails=trails,
        models=TreeModels(section.tree_models, plants, section.season),
        loose_stems=loose_stems,
        near_m=near_m,
        name=_name(section, seed, path, reach_m, loose_stems=loose_stems),
        plants_name=_content(section.species_file),
    )


def _name(section: Forest | Plot, seed: int, path: Corridor, reach_m: float, *, loose_stems: bool) -> str:
    """Digest of all that decides a forest, files by what they hold."""
    dem_file = section.dem.file if section.dem else None
    stem_list = section.stem_list if isinstance(section, Plot) else None
    models = [model.file for model in section.tree_models]
    files: list[str | None] = [section.species_file, dem_file, stem_list, *models]
    parts = [
        section.model_dump_json(exclude={"meshes", "near_m", "seed"}),
        str(seed),
        f"{reach_m!r} {loose_stems}",
    ]
    digest = hashlib.sha256("\n".join([*parts, *map(_content, files), ""]).encode())
    digest.update(path.xy_m.tobytes())
    return digest.hexdigest()[:32]


def _content(file: str | None) -> str:
    """Digest of what a file holds; nothing where none is given."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:32] if file else ""


def _furnished(
    bare: ForestWorld | HallWorld, files: list[MeshFile], path_xy_m: Array, reach_m: float
) -> World:
    """Put the user's own meshes into a world, and warn of those that are out of sight."""
    if not files:
        return bare
    furniture = [Furniture(one, load_mesh(Path(one.file), unit=one.unit, up=one.up)) for one in files]
    world = Furnished(bare, furniture=furniture, reach_m=reach_m)
    world.check(path_xy_m)
    return world
