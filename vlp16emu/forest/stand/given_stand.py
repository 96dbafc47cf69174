"""Measured trees: a stem list, completed by the species' curves, in place of a generated stand."""

import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from vlp16emu.elementary import log
from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import Corridor, Polyline
from vlp16emu.forest.plants.prototypes import CrownKey
from vlp16emu.forest.plants.species import BARK_SPREAD, LEAF_SPREAD, Species, Trees, find_species, flora
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import LEAST_SLENDERNESS, Plot, buckling_height_m
from vlp16emu.forest.stand.points import Land
from vlp16emu.forest.stand.stand import (
    RIVALS_M,
    TREE,
    competition,
    foot_discs,
    in_the_way_m,
    path_gap_m,
    residuals,
)
from vlp16emu.forest.tiles import TILE_M
from vlp16emu.random import generator
from vlp16emu.tables import Column, Table, optional, read_table
from vlp16emu.types import F8
from vlp16emu.world.vectors import places_m

_APART_M = 0.05  # two stems nearer to each other count as one tree listed twice
_ROUNDING = 1e-9  # relative rounding error of a DBH from cm
# Limits in metres or degrees: beyond them a wrong unit is more likely than a tree.
_COLUMNS = {
    "x_m": Column({"x_m": 1.0, "x": 1.0}),
    "y_m": Column({"y_m": 1.0, "y": 1.0}),
    "species": Column({"species": 1.0}),
    "dbh_m": Column({"dbh_cm": 0.01, "dbh_m": 1.0}, 0.01, 5.0),
    "height_m": Column({"height_m": 1.0}, 2.0, 130.0, is_filled=False),
    "crown_base_m": replace(optional("crown_base_m"), low=0.0, high=130.0),
    "crown_width_m": replace(optional("crown_width_m"), low=0.1, high=60.0),
    "taper": replace(optional("taper"), low=-0.9, high=3.0),
    "lean_deg": replace(optional("lean_deg"), low=0.0, high=45.0),
    "lean_azimuth_deg": replace(optional("lean_azimuth_deg"), low=0.0, high=360.0),
    "lean_towards_deg": replace(optional("lean_towards_deg"), low=0.0, high=360.0),
}


def read_stem_list(
    path: Path, all_species: Mapping[str, Species], origin_m: tuple[float, float, float], seed: int = 0
) -> Trees:
    """Read a stem list.

    The first line names the columns, in any order, between commas, semicolons or tabs: x and y (in m; also
    `x_m`, `y_m`), `species` (a name of the species table, common or scientific), `dbh_cm` or `dbh_m`,
    `height_m`, and if known `crown_base_m`, `crown_width_m`, `taper`, `lean_deg` and `lean_azimuth_deg`
    (clockwise from north) or `lean_towards_deg` (counter-clockwise from east). So an inventory of a forest is
    also a stem list. Other columns are ignored, as are heights above sea level: trees stand on the scene's
    ground.

    Cells from `height_m` on may be empty. Heights then follow the species' height curve through the quadratic
    mean diameter of its measured trees and their mean height, no higher than a stem can stand and the tallest
    known tree; crown base and width follow the species'
    equations, the neighbours, and a residual drawn by the seed, as are taper, reflectance and the azimuth of
    each crown about its stem; a stem without lean is upright.

    Returns trees (n,) `TREE` in the order of the list, with id, z and form still 0; easting, northing and
    height of the origin become (0, 0, 0) in the scene. Raises GeometryError, naming file, line and column,
    for a value that is missing, not a number, out of its limits, or no known species, and for a tree listed
    twice.
    """
    table = read_table(path, _COLUMNS, "a stem list in CSV", GeometryError)
    if {"lean_azimuth_deg", "lean_towards_deg"} <= table.names.keys():
        raise GeometryError(f"{path}, line 1", "found lean_azimuth_deg and lean_towards_deg", "one of them")
    if not len(table):
        raise GeometryError(str(path), "no tree below line 1", "one tree to a line")
    names = table.texts("species")
    species = [
        find_species([name], all_species, table.where(row, "species"))[0] for row, name in enumerate(names)
    ]
    trees = np.zeros(len(table), TREE)
    trees["species"] = [kind.number for kind in species]
    trees["list_line"] = table.lines
    trees["x_m"] = table.numbers("x_m") - origin_m[0]
    trees["y_m"] = table.numbers("y_m") - origin_m[1]
    trees["dbh_m"] = table.numbers("dbh_m")
    _check_sizes(table, species)
    trees["height_m"] = _with_heights(table, species)
    kinds = [kind for kind in all_species.values() if kind.number in set(trees["species"].tolist())]
    _set_crowns(trees, table, kinds, seed)
    _set_looks(trees, kinds, seed)
    trees["lean_deg"] = np.nan_to_num(table.numbers("lean_deg"))
    towards = table.numbers("lean_towards_deg")
    azimuth = table.numbers("lean_azimuth_deg")
    trees["lean_towards_deg"] = np.nan_to_num(np.where(np.isnan(towards), 90.0 - azimuth, towards)) % 360
    _check(table, trees)
    return trees


def _with_heights(table: Table, species: list[Species]) -> F8:
    dbh_cm = 100 * table.numbers("dbh_m")
    height_m = table.numbers("height_m")
    number = np.array([kind.number for kind in species])
    unknown = np.isnan(height_m)
    for kind in {kind.number: kind for kind in species}.values():
        missing = (number == kind.number) & unknown
        measured = (number == kind.number) & ~unknown
        if missing.any() and not measured.any():
            found = f"no tree of {kind.name} has a height"
            raise GeometryError(
                f"{table.path}: height_m", found, "one at least, to draw its height curve through"
            )
        if missing.any():
            mean_cm = float(np.sqrt(np.mean(np.square(dbh_cm[measured]))))
            curve_m = kind.height_curve(dbh_cm[missing], mean_cm, float(height_m[measured].mean()))
            most_m = np.minimum(_buckling_m(dbh_cm[missing] / 100), kind.champion.height_m)
            height_m[missing] = np.maximum(np.minimum(curve_m, most_m), _COLUMNS["height_m"].low)
    return height_m


def _buckling_m(dbh_m: F8) -> F8:
    return np.array([buckling_height_m(stem_m) for stem_m in dbh_m.tolist()])


def _set_crowns(trees: Trees, table: Table, kinds: list[Species], seed: int) -> None:
    """Set taper and crowns; crown values that the list lacks follow from species, size and neighbours."""
    from scipy.spatial import cKDTree  # here: it takes a while to load

    dbh_cm = 100 * trees["dbh_m"]
    height_m = trees["height_m"]
    xy_m = places_m(trees, "xy")
    for name in ("crown_base_m", "crown_width_m", "taper"):
        trees[name] = table.numbers(name)
    # One row of numbers to a tree: a tree more at the end of a list changes no other.
    _, ratio, wide, taper = residuals(
        generator(seed, Growth.GIVEN_TREE, 1).standard_normal((len(trees), 4))
    ).T
    competition_m2 = np.zeros((len(trees), 2))
    for kind in kinds:
        is_kind = trees["species"] == kind.number
        competition_m2[is_kind] = kind.competition_m2(dbh_cm[is_kind])
        trees["taper"][is_kind] = np.where(np.isnan(trees["taper"]), kind.taper_of(taper), trees["taper"])[
            is_kind
        ]
    pressure = np.zeros((2, len(trees)))
    for i, near in enumerate(cKDTree(xy_m).query_ball_point(xy_m, RIVALS_M)):
        larger = (dbh_cm[near] > dbh_cm[i])[None]
        pressure[:, i : i + 1] = competition(
            competition_m2[near], np.pi * RIVALS_M * RIVALS_M, larger, np.ones_like(larger)
        )
    for kind in kinds:
        is_kind = trees["species"] == kind.number
        no_base, no_width = (is_kind & np.isnan(trees[name]) for name in ("crown_base_m", "crown_width_m"))
        rivals = (pressure[0][no_base], pressure[1][no_base])
        trees["crown_base_m"][no_base] = kind.crown_base_m(
            dbh_cm[no_base], height_m[no_base], rivals, ratio[no_base]
        )
        openness = kind.openness(pressure[1][no_width])
        trees["crown_width_m"][no_width] = kind.crown_width_m(
            dbh_cm[no_width], wide[no_width]
        ) * kind.widening(dbh_cm[no_width], openness)


def _check_sizes(table: Table, species: list[Species]) -> None:
    """Refuse lists with DBH in millimetres, and sizes that no tree of the species has.

    Heights that the list lacks are not checked.
    """
    dbh_m = table.numbers("dbh_m")
    height_m = table.numbers("height_m")
    slenderness = height_m / dbh_m
    if (measured := np.flatnonzero(~np.isnan(height_m))).size:
        middle = float(np.median(slenderness[measured]))
        if middle < LEAST_SLENDERNESS:
            i = int(measured[slenderness[measured].argmin()])
            size = f"{100 * dbh_m[i]:g} cm at a height of {height_m[i]:g} m"
            found = f"found {size}; half of all trees are less than {middle:.0f} times as high as thick"
            expected = f"{LEAST_SLENDERNESS:g} times or more (is the DBH in mm?)"
            raise GeometryError(table.where(i, "dbh_m"), found, expected)
    champion_m = np.array([(kind.champion.height_m, kind.champion.dbh_cm / 100) for kind in species])
    if (thick := np.flatnonzero(dbh_m > (1 + _ROUNDING) * champion_m[:, 1])).size:
        i = int(thick[0])
        expected = f"{100 * champion_m[i, 1]:.4g} cm at most, the DBH of the thickest known {species[i].name}"
        raise GeometryError(table.where(i, "dbh_m"), f"found {100 * dbh_m[i]:g} cm", expected)
    if (tall := np.flatnonzero(height_m > champion_m[:, 0])).size:
        i = int(tall[0])
        expected = f"{champion_m[i, 0]:g} m at most, the height of the tallest known {species[i].name}"
        raise GeometryError(table.where(i, "height_m"), f"found {height_m[i]:g} m", expected)
    most_m = _buckling_m(dbh_m)
    if (weak := np.flatnonzero(height_m > most_m)).size:
        i = int(weak[0])
        size = f"{height_m[i]:g} m at a DBH of {100 * dbh_m[i]:g} cm"
        found = f"found {size}, {slenderness[i]:.0f} times as high as thick"
        expected = f"{most_m[i]:.3g} m at most, where a stem buckles under its own weight"
        raise GeometryError(table.where(i, "height_m"), found, expected)


def _check(table: Table, trees: Trees) -> None:
    """Refuse crowns above the tip, and doubled trees."""
    from scipy.spatial import cKDTree  # here: it takes a while to load

    if (above := np.flatnonzero(trees["crown_base_m"] >= trees["height_m"])).size:
        i = int(above[0])
        found = f"found {trees['crown_base_m'][i]:g}"
        raise GeometryError(
            table.where(i, "crown_base_m"), found, f"less than the height, {trees['height_m'][i]:g}"
        )
    places = places_m(trees, "xy")
    if pairs := sorted(cKDTree(places).query_pairs(_APART_M)):
        first, second = pairs[0]
        place = f"({places[second, 0]:g}, {places[second, 1]:g}) m in the scene"
        found = f"the place of line {table.lines[first]}, {place}"
        raise GeometryError(table.where(second), found, f"trees at least {_APART_M:g} m apart")


_CROWN_RATIOS = 0.4, 0.6
"""Limits between the variants of a class, so that no crown is stretched much along its stem."""
_CLASS_BASE_M = 0.3
_CLASS_RATIO = 1.25
"""Base of crown classes: class c has a DBH of about _CLASS_BASE_M * _CLASS_RATIO**c."""
_NAMED = 20  # most trees in the way that an error names
_log = logging.getLogger(__name__)


class GivenStand:
    """Trees of a list, tile by tile.

    Missing values, such as the azimuth of a crown about its stem, are drawn by the seed. A crown is a
    prototype for the list's trees of that species and diameter class, scaled to the tree. Each tree has the
    leaf area index of its species on its own crown projection, as the ground area of a tree does not follow
    from a list.

    Raises GeometryError for a faulty list, and for trees on the path unless they are dropped.
    """

    def __init__(self, section: Plot, land: Land) -> None:
        self._source = Path(section.stem_list)
        plants = land.plants
        trees = read_stem_list(self._source, plants.trees, section.origin_m, land.seed)
        self._species = [
            kind for kind in plants.trees.values() if kind.number in set(trees["species"].tolist())
        ]
        self.species = [kind.name for kind in self._species]
        self._season = section.season
        self._dead_branches = section.dead_branches
        if section.crooked_stems:
            trees["form"] = generator(land.seed, Growth.STEM_FORM).integers(1, 2**63, len(trees))
        trees = _clear_of_path(section, trees, plants.trees, land.path)
        trees["z_m"] = land.height_m(trees["x_m"], trees["y_m"])
        tile = np.floor(places_m(trees, "xy") / TILE_M).astype(np.int64)
        tiles, tile_of, count = np.unique(tile, axis=0, return_inverse=True, return_counts=True)
        self._tiles = {(ix, iy): trees[tile_of.ravel() == i] for i, (ix, iy) in enumerate(tiles.tolist())}
        self.per_ha = float(count.max()) / (TILE_M * TILE_M / 10_000)  # greatest density of a tile
        self._prototypes = _prototypes(trees)
        self._all = trees

    def check(self, path: Polyline, reach_m: float) -> None:
        """Raise GeometryError, naming the nearest tree, if no crown is within reach of a path."""
        gap_m = path.distance_m(places_m(self._all, "xy"))
        if (gap_m - self._all["crown_width_m"] / 2 > reach_m).all():
            i = int(gap_m.argmin())
            x_m, y_m = self._all["x_m"][i], self._all["y_m"][i]
            nearest = f"the nearest at ({x_m:.1f}, {y_m:.1f}) m in the scene"
            found = f"no tree in sight, {nearest}, {gap_m[i]:.1f} m from the path"
            expected = f"one {reach_m:g} m from it at most (a list in map coordinates needs an origin_m)"
            raise GeometryError(str(self._source), found, expected)

    def trees(self, ix: int, iy: int) -> Trees:
        """Trees with their foot in a tile, `TREE` with id still 0, in the order of the list."""
        return self._tiles.get((ix, iy), np.zeros(0, TREE))

    def crown(self, cohort: int, crown_class: int, variant: int) -> CrownKey:
        """Return the key of the crown prototype of a diameter class and crown ratio."""
        species = self._species[cohort]
        dbh_m, height_m, base_m, width_m = self._prototypes[cohort, crown_class, variant]
        sizes = dbh_m, height_m, base_m, width_m, species.leaf_area_index * math.pi / 4 * width_m * width_m
        return CrownKey(species.name, variant, *sizes, self._season, self._dead_branches)


def _set_looks(trees: Trees, kinds: list[Species], seed: int) -> None:
    # One row of numbers to a tree: a tree more at the end of a list changes no other.
    uniform = generator(seed, Growth.GIVEN_TREE).random((len(trees), 3))
    trees["crown_azimuth_deg"] = 360 * uniform[:, 0]
    trees["crown_variant"] = np.digitize(1 - trees["crown_base_m"] / trees["height_m"], _CROWN_RATIOS)
    trees["crown_class"] = np.round(log(trees["dbh_m"] / _CLASS_BASE_M) / log(_CLASS_RATIO))
    for cohort, kind in enumerate(kinds):
        is_kind = trees["species"] == kind.number
        trees["cohort"][is_kind] = cohort
        trees["bark_reflectance"][is_kind] = kind.bark_reflectance
        trees["leaf_reflectance"][is_kind] = kind.leaf_reflectance
    trees["bark_reflectance"] += BARK_SPREAD * (2 * uniform[:, 1] - 1)
    trees["leaf_reflectance"] += LEAF_SPREAD * (2 * uniform[:, 2] - 1)


def listed_trees(section: Plot, seed: int) -> Trees:
    """Return all trees (n,) `TREE` of a plot's list, also those on the path.

    Errors as in `read_stem_list`.
    """
    return read_stem_list(Path(section.stem_list), flora(section.species_file).trees, section.origin_m, seed)


def stems_in_the_way(section: Plot, seed: int) -> tuple[F8, F8]:
    """Positions (n, 2) of stems at the foot and above head height, and distances (n,).

    The path must keep these distances from them.

    Raises GeometryError for a faulty list.
    """
    table = flora(section.species_file).trees
    trees = listed_trees(section, seed)
    gap_m = foot_discs(trees, table=table)[:, 2] + section.path_clearance_m
    return np.concatenate(in_the_way_m(trees)), np.tile(gap_m, 2)


def _clear_of_path(section: Plot, trees: Trees, table: Mapping[str, Species], path: Corridor) -> Trees:
    gap_m = path_gap_m(trees, foot_discs(trees, table=table)[:, 2], path)
    in_the_way = gap_m < path.clearance_m
    if not in_the_way.any():
        return trees
    named = [
        f"line {tree['list_line']} at ({tree['x_m']:g}, {tree['y_m']:g}) m, {max(gap, 0.0):.2f} m away"
        for tree, gap in zip(trees[in_the_way], gap_m[in_the_way], strict=True)
    ]
    more = f", and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
    found = (
        f"nearer to the path than path_clearance_m = {path.clearance_m:g}: {'; '.join(named[:_NAMED])}{more}"
    )
    if section.on_conflict != "drop":
        found = f"{len(named)} of {len(trees)} trees {found}"
        expected = 'none, or on_conflict = "drop" or "move_path"'
        raise GeometryError(section.stem_list, found, expected)
    if in_the_way.all():
        raise GeometryError(section.stem_list, f"all trees {found}", "one that is left")
    _log.warning("%s: left out %d of %d trees %s", section.stem_list, len(named), len(trees), found)
    return trees[~in_the_way]


def _prototypes(trees: Trees) -> dict[tuple[int, int, int], tuple[float, ...]]:
    """DBH, height, crown base and crown width of the mean tree of each cohort, crown class and variant."""
    kinds = np.column_stack([trees["cohort"], trees["crown_class"], trees["crown_variant"]]).astype(np.int64)
    size = np.column_stack([trees[name] for name in ("dbh_m", "height_m", "crown_base_m", "crown_width_m")])
    names, name_of = np.unique(kinds, axis=0, return_inverse=True)
    return {
        (c, k, v): tuple(size[name_of.ravel() == i].mean(axis=0).tolist())
        for i, (c, k, v) in enumerate(names.tolist())
    }
