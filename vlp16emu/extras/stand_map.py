"""Map of a stand: stems, ground and the profile along the path, and how much of each stem the path sees."""

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from vlp16emu.cores import usable_cores
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.trees import Tree
from vlp16emu.types import F8, I8, Firings, HeightField, PlantPart, Semantic, Window, World
from vlp16emu.world.vectors import places_m

_MOST_CELLS = 80  # greatest number of cells of ground along an edge of the map
_MOST_PLACES = 500  # greatest number of places along the profile
_DECIMALS = 2  # of metres; of diameters a tenth of a millimetre
_SECTORS = 24  # bark is looked at in sectors of 15 degrees
_STATION_M = 1.0  # distance between the places on the path from which stems are looked at
_SAME_M = 0.15  # a ray that ends on its tree this near has met the point: sections are not round


def map_of(
    path_m: F8,
    trees: NDArray[np.void],
    species: Mapping[int, str],
    bounds_m: tuple[F8, F8],
    height_m: HeightField,
) -> Tree:
    """Return stems, ground and profile of a stand as lists, for reports.

    Parameters
    ----------
    path_m : (n, 3) positions of the sensor
    trees : (k,) `INVENTORY`
    species : names by number
    bounds_m : south-west and north-east corner (2,) of the map
    height_m : the ground
    """
    low_m, high_m = bounds_m
    cell_m = max(1.0, math.ceil(float((high_m - low_m).max()) / _MOST_CELLS))
    x_m, y_m = (np.arange(a, b + cell_m, cell_m) for a, b in zip(low_m, high_m, strict=True))
    grid_x, grid_y = np.meshgrid(x_m, y_m)
    heights_m = np.round(height_m(grid_x, grid_y), _DECIMALS)
    ground = {
        "west_m": float(x_m[0]),
        "south_m": float(y_m[0]),
        "cell_m": cell_m,
        "heights_m": heights_m.tolist(),
    }
    return {"stems": _stems(path_m, trees, species), "ground": ground, "profile": _profile(path_m, height_m)}


def _along_m(path_m: F8) -> F8:
    """Return the horizontal distances (n,) along a path (n, 3)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m[:, :2], axis=0).T))])


def _stems(path_m: F8, trees: NDArray[np.void], species: Mapping[int, str]) -> Tree:
    xy_m = places_m(trees, "xy")
    aside_m, nearest = (
        KDTree(path_m[:, :2]).query(xy_m) if len(trees) else (np.zeros(0), np.zeros(0, np.int64))
    )
    lists: Tree = {"id": trees["id"].tolist(), "species": [species[n] for n in trees["species"].tolist()]}
    for name in ("x_m", "y_m", "z_m", "height_m", "crown_base_m", "crown_width_m"):
        lists[name] = np.round(trees[name], _DECIMALS).tolist()
    lists["dbh_m"] = np.round(trees["dbh_m"], 4).tolist()
    lists["along_m"] = np.round(_along_m(path_m)[nearest], _DECIMALS).tolist()  # where the path is nearest
    lists["aside_m"] = np.round(aside_m, _DECIMALS).tolist()  # distance from the path
    return lists


def _profile(path_m: F8, height_m: HeightField) -> dict[str, list[float]]:
    rows = np.unique(np.linspace(0, len(path_m) - 1, _MOST_PLACES).astype(np.int64))
    x_m, y_m, sensor_m = path_m[rows].T
    columns = {"distance_m": _along_m(path_m)[rows], "x_m": x_m, "y_m": y_m, "sensor_m": sensor_m}
    columns["ground_m"] = np.asarray(height_m(x_m, y_m))
    return {name: np.round(column, _DECIMALS).tolist() for name, column in columns.items()}


def bark_seen(
    path_m: F8,
    trees: NDArray[np.void],
    world: World,
    window: Window,
    t_ns: int,
    *,
    reach_m: float,
    field_deg: tuple[float, float],
) -> F8:
    """Return the share (k,) of the bark at breast height that a level sensor sees from anywhere on its path.

    Single rays go from places a metre apart to 24 points around each stem. Foliage beyond `world.near_m` of
    the path is a medium, which stops a ray as often as leaves do.

    Parameters
    ----------
    path_m : (n, 3) positions of the sensor
    trees : (k,) `INVENTORY`
    window : of the world, with all in reach of the path
    t_ns : UTC, for moving surfaces
    reach_m : range of the sensor
    field_deg : elevations of its lowest and highest beam
    """
    along_m = _along_m(path_m)
    stations_m = path_m[np.unique(np.searchsorted(along_m, np.arange(0.0, along_m[-1] + 1e-9, _STATION_M)))]
    turn = 2 * np.pi * np.arange(_SECTORS) / _SECTORS
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(_SECTORS)])
    breast_m = np.column_stack([trees["x_breast_m"], trees["y_breast_m"], trees["z_m"] + BREAST_HEIGHT_M])
    bark_m = (breast_m[:, None] + trees["dbh_m"][:, None, None] / 2 * around).reshape(-1, 3)
    outward = np.tile(around, (len(trees), 1))
    owner = np.repeat(trees["id"], _SECTORS)
    seen = np.zeros(len(bark_m), np.bool_)
    low, high = (math.tan(math.radians(deg)) for deg in field_deg)
    with ThreadPoolExecutor(usable_cores()) as workers:
        geometry = caster(world, workers).open(window)
        surfaces = geometry.surfaces
        is_stem = (surfaces["semantic"] == Semantic.TREE) & np.isin(
            surfaces["part"], (PlantPart.STEM, PlantPart.ROOT_FLARE)
        )
        for place_m in stations_m:
            ray_m = bark_m - place_m
            flat_m = np.hypot(*ray_m[:, :2].T)
            slope = ray_m[:, 2] / np.maximum(flat_m, 1e-9)
            faces = (ray_m * outward).sum(axis=1) < 0
            rows = np.flatnonzero(~seen & faces & (flat_m <= reach_m) & (slope >= low) & (slope <= high))
            if len(rows):
                range_m, surface = _cast(geometry, t_ns, place_m, ray_m[rows], reach_m)
                hit = np.isfinite(range_m)
                hit[hit] &= is_stem[surface[hit]] & (surfaces["instance"][surface[hit]] == owner[rows][hit])
                seen[rows] = hit & (np.abs(range_m - np.linalg.norm(ray_m[rows], axis=1)) < _SAME_M)
    return np.asarray(seen.reshape(-1, _SECTORS).mean(axis=1))


def _cast(geometry: Geometry, t_ns: int, place_m: F8, ray_m: F8, reach_m: float) -> tuple[F8, I8]:
    """Cast rays (n, 3) from a place; return their ranges and surfaces (n,)."""
    padded = np.resize(ray_m, (-(-len(ray_m) // 8) * 8, 1, 3))  # casters take eight together
    direction = padded / np.linalg.norm(padded, axis=-1, keepdims=True)
    hits = geometry.cast(Firings.rays(t_ns, place_m, direction), np.zeros(1), reach_m)
    return hits.range_m[: len(ray_m)].astype(np.float64), hits.surface[: len(ray_m)].astype(np.int64)
