"""The ground and the forest on it, from the table `[world]`."""

import hashlib
import math
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import Corridor
from vlp16emu.forest.ground.dem import DemHeights
from vlp16emu.forest.ground.terrain import TerrainHeights
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.settings import Forest, Plot, Wind, Woods
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.stand.given_stand import GivenStand, stems_in_the_way
from vlp16emu.forest.stand.points import Land
from vlp16emu.forest.stand.stand import Stand
from vlp16emu.inputs import LARGEST_BYTES, read_bytes
from vlp16emu.settings import Section
from vlp16emu.types import F8, MovingTrees, World


class ForestSite:
    """The ground of a forest or a plot; a `Site`.

    The seed determines ground, plants and gusts. Raises GeometryError if heights cannot be read.
    """

    def __init__(self, section: Woods, seed: int) -> None:
        self._section = section
        self._seed = seed
        self.origin_m = section.origin_m
        self._ground: TerrainHeights | DemHeights = (
            TerrainHeights(section.terrain, seed=seed)
            if section.dem is None
            else DemHeights(section.dem, origin_m=section.origin_m)
        )
        self.height_m = self._ground.height_m

    @property
    def name(self) -> str:
        """Digest of all inputs of the ground."""
        section = self._section
        settings = section.model_dump_json(include={"dem", "origin_m", "terrain"})
        return _digest(settings, _content(section.dem.file if section.dem else None), str(self._seed))

    @cached_property
    def obstacles(self) -> tuple[F8, F8] | None:
        """Stems that the path must avoid, with the errors of `stems_in_the_way`.

        None if the path stays as it is.
        """
        section = self._section
        if isinstance(section, Plot) and section.on_conflict == "move_path":
            return stems_in_the_way(section, self._seed)
        return None

    def has_ground(self, xy_m: F8, reach_m: float) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 2) at which a path has ground.

        A file of heights may not have it everywhere.
        """
        if isinstance(self._ground, DemHeights):
            return self._ground.has_heights(xy_m, reach_m)
        return np.ones(len(xy_m), np.bool_)

    def world(
        self, path_xy_m: F8, *, reach_m: float, farthest_m: float, wind: Section | None, start_ns: int
    ) -> tuple[World, MovingTrees | None]:
        """Return the forest and the sway of its trees; parameters and errors as in `Site`."""
        section = self._section
        ground = self._ground
        if isinstance(ground, DemHeights):
            ground.check(path_xy_m, reach_m)
        path = Corridor(path_xy_m, section.path_clearance_m)
        if isinstance(section, Forest) and path.clearance_m >= reach_m:
            expected = f"less than the {reach_m:.0f} m that are seen, where it leaves no tree"
            raise GeometryError("world.path_clearance_m", f"found {path.clearance_m:g}", expected)
        trails = ground.trails if isinstance(ground, TerrainHeights) else None
        land = Land(self._seed, self.height_m, path, flora(section.species_file), trails)
        stems: Stand | GivenStand
        if isinstance(section, Plot):
            stems = GivenStand(section, land)
            stems.check(path, reach_m)
        else:
            assert isinstance(section, Forest)  # the only other kind
            stems = Stand(section, land)
        bare = ForestWorld(
            section,
            stems,
            land,
            reach_m=reach_m,
            # A sensor whose range ends within `near_m` meets no medium, so none is made.
            near_m=section.near_m if section.near_m < farthest_m else math.inf,
            name=_cache_name(section, self._seed, path, reach_m),
            plants_name=_content(section.species_file),
        )
        sway = None
        if isinstance(wind, Wind) and wind.speed_m_s > 0:
            from vlp16emu.forest.stand.wind import TreeSway  # here: still forests do without

            sway = TreeSway(wind, forest=bare, start_ns=start_ns)
        return section.with_meshes(bare, path_xy_m, reach_m), sway


def _cache_name(section: Woods, seed: int, path: Corridor, reach_m: float) -> str:
    stem_list = section.stem_list if isinstance(section, Plot) else None
    dem_file = section.dem.file if section.dem else None
    files = section.species_file, dem_file, stem_list, *(model.file for model in section.tree_models)
    settings = section.model_dump_json(exclude={"meshes", "near_m", "seed"})
    path_digest = hashlib.sha256(path.xy_m.tobytes()).hexdigest()
    return _digest(settings, str(seed), f"{reach_m!r}", *map(_content, files), path_digest)


def _digest(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _content(file: str | None) -> str:
    if not file:
        return ""
    content = read_bytes(Path(file), "a file of the forest", GeometryError, most_bytes=LARGEST_BYTES)
    return hashlib.sha256(content).hexdigest()[:32]
