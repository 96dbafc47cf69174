"""Measured trees: a stem list in CSV, and what it leaves out from the species' own curves."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from vlp16emu.errors import GeometryError
from vlp16emu.forest.plants.flora import Trees, known
from vlp16emu.forest.plants.species import Species
from vlp16emu.forest.stand.settings import LEAST_SLENDERNESS
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.tables import Column, Table, optional, read_table
from vlp16emu.types import Array
from vlp16emu.world.vectors import places_m

_APART_M = 0.05  # two stems nearer to each other are one that was listed twice
_TOP_SHARE = 0.2  # the thickest fifth of all stems has the top height, by Weise's definition


# Limits in metres or degrees: beyond them it is more likely a slip of the unit than a tree.
_COLUMNS = {
    "x_m": Column({"x_m": 1.0, "x": 1.0}),
    "y_m": Column({"y_m": 1.0, "y": 1.0}),
    "species": Column({"species": 1.0}),
    "dbh_m": Column({"dbh_cm": 0.01, "dbh_m": 1.0}, 0.01, 5.0),
    "height_m": Column({"height_m": 1.0}, 2.0, 130.0, is_filled=False),
    "crown_base_m": replace(optional("crown_base_m"), low=0.0, high=130.0),
    "crown_width_m": replace(optional("crown_width_m"), low=0.1, high=60.0),
    "lean_deg": replace(optional("lean_deg"), low=0.0, high=45.0),
    "lean_azimuth_deg": replace(optional("lean_azimuth_deg"), low=0.0, high=360.0),
    "lean_towards_deg": replace(optional("lean_towards_deg"), low=0.0, high=360.0),
}


def read_stem_list(path: Path, all_species: Mapping[str, Species], origin_m: tuple[float, float, float]) -> Trees:
    """Read a stem list.

    The first line names the columns, in any order, between commas, semicolons or tabs: x and y (in m; also
    `x_m`, `y_m`), `species` (a name of the species table, common or scientific), `dbh_cm` or `dbh_m`, `height_m`, and if known
    `crown_base_m`, `crown_width_m`, `lean_deg` and `lean_azimuth_deg` (clockwise from north) or
    `lean_towards_deg` (counter-clockwise from east). So an inventory of a forest is a stem list too. Others
    are ignored, heights above sea level too: trees stand on the scene's ground.

    Cells from `height_m` on may be empty. Then heights follow the species' height curve through the
    quadratic mean diameter of its measured trees and their mean height; crown base and width follow the
    species' own equations, with the mean height of the thickest fifth of the list as top height; a stem
    without lean is upright.

    Parameters
    ----------
    origin_m : easting, northing and height that become (0, 0, 0) in the scene

    Returns
    -------
    (n,) `TREE` in the order of the list; what is by chance or by the ground (id, z, crown azimuth, prototype, reflectance) is still 0

    Raises
    ------
    GeometryError
        naming file, line and column of what is missing, no number, out of its limits, no species, or listed twice
    """
    table = read_table(path, _COLUMNS, "a stem list in CSV", GeometryError)
    if {"lean_azimuth_deg", "lean_towards_deg"} <= table.names.keys():
        expected = "one of them"
        raise GeometryError(f"{path}, line 1", "found lean_azimuth_deg and lean_towards_deg", expected)
    if not len(table):
        raise GeometryError(str(path), "no tree below line 1", "one tree to a line")
    names = table.texts("species")
    species = [known([name], all_species, table.where(row, "species"))[0] for row, name in enumerate(names)]
    trees = np.zeros(len(table), TREE)
    trees["species"], trees["list_line"] = [one.number for one in species], table.lines
    trees["x_m"], trees["y_m"] = table.numbers("x_m") - origin_m[0], table.numbers("y_m") - origin_m[1]
    trees["dbh_m"] = table.numbers("dbh_m")
    trees["height_m"] = _with_heights(table, species)
    trees["crown_base_m"], trees["crown_width_m"] = _with_crowns(table, trees, species)
    trees["lean_deg"] = np.nan_to_num(table.numbers("lean_deg"))
    towards, azimuth = table.numbers("lean_towards_deg"), table.numbers("lean_azimuth_deg")
    trees["lean_towards_deg"] = np.nan_to_num(np.where(np.isnan(towards), 90.0 - azimuth, towards)) % 360
    _check_slender(table, trees)
    _check_crown_bases(table, trees)
    _check_twice(table, trees)
    return trees


def _with_heights(table: Table, species: list[Species]) -> Array:
    """Return heights (n,), unmeasured ones by the species' curve."""
    dbh_cm, height_m = 100 * table.numbers("dbh_m"), table.numbers("height_m")
    of = np.array([one.number for one in species])
    for one in {one.number: one for one in species}.values():
        own, missing = of == one.number, (of == one.number) & np.isnan(height_m)
        if not missing.any():
            continue
        measured = own & ~missing
        if not measured.any():
            found = f"no tree of {one.name} has a height"
            raise GeometryError(f"{table.path}: height_m", found, "one at least, to draw its height curve through")
        mean_cm = float(np.sqrt(np.mean(np.square(dbh_cm[measured]))))
        curve_m = one.height_m(dbh_cm[missing], mean_cm, float(height_m[measured].mean()))
        height_m[missing] = np.maximum(curve_m, _COLUMNS["height_m"].low)
    return height_m


def _with_crowns(table: Table, trees: Trees, species: list[Species]) -> tuple[Array, Array]:
    """Return crown bases and crown widths (n,), unmeasured ones by the species' equations."""
    dbh_cm, height_m = 100 * trees["dbh_m"], trees["height_m"]
    thickest = np.argsort(-dbh_cm, kind="stable")[: math.ceil(_TOP_SHARE * len(trees))]
    top_m = float(height_m[thickest].mean())
    base_m, width_m = table.numbers("crown_base_m"), table.numbers("crown_width_m")
    for one in {one.number: one for one in species}.values():
        own = trees["species"] == one.number
        no_base, no_width = own & np.isnan(base_m), own & np.isnan(width_m)
        base_m[no_base] = one.crown_base_m(dbh_cm[no_base], height_m[no_base], top_m)
        width_m[no_width] = one.crown_width_m(dbh_cm[no_width])
    return base_m, width_m


def _check_slender(table: Table, trees: Trees) -> None:
    """Refuse a list of trees that are far too thick for their height: their DBH is in millimetres."""
    slenderness = trees["height_m"] / trees["dbh_m"]
    if (middle := float(np.median(slenderness))) < LEAST_SLENDERNESS:
        i = int(slenderness.argmin())
        found = f"found {100 * trees['dbh_m'][i]:g} cm at a height of {trees['height_m'][i]:g} m; half of all trees are less than {middle:.0f} times as high as thick"
        expected = f"{LEAST_SLENDERNESS:g} times or more (is the DBH in mm?)"
        raise GeometryError(table.where(i, "dbh_m"), found, expected)


def _check_crown_bases(table: Table, trees: Trees) -> None:
    above = trees["crown_base_m"] >= trees["height_m"]
    if above.any():
        i = int(above.argmax())
        found = f"found {trees['crown_base_m'][i]:g}"
        raise GeometryError(table.where(i, "crown_base_m"), found, f"less than the height, {trees['height_m'][i]:g}")


def _check_twice(table: Table, trees: Trees) -> None:
    from scipy.spatial import cKDTree

    places = places_m(trees, "xy")
    pairs = sorted(cKDTree(places).query_pairs(_APART_M))
    if pairs:
        first, second = pairs[0]
        found = f"the place of line {table.lines[first]}, ({places[second, 0]:g}, {places[second, 1]:g}) m in the scene"
        raise GeometryError(table.where(second), found, f"trees at least {_APART_M:g} m apart")
