"""Measured trees: a stem list in CSV, and what it leaves out from the species' own curves."""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vlp16emu.errors import GeometryError, readable
from vlp16emu.forest.plants.flora import Trees, known
from vlp16emu.forest.plants.species import Species
from vlp16emu.forest.stand.settings import LEAST_SLENDERNESS
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.types import Array, IntArray
from vlp16emu.world.vectors import places_m

_APART_M = 0.05  # two stems nearer to each other are one that was listed twice
_TOP_SHARE = 0.2  # the thickest fifth of all stems has the top height, by Weise's definition


@dataclass(frozen=True, slots=True)
class _Column:
    units: Mapping[str, float]  # names that it may have, each with what brings it to metres or degrees
    low: float
    high: float  # limits in metres or degrees: beyond them it is more likely a slip of the unit than a tree
    every_column: bool = False  # whether there must be such a column
    every_cell: bool = False  # whether each tree must have it


_COLUMNS = {
    "x_m": _Column({"x_m": 1.0, "x": 1.0}, -math.inf, math.inf, every_column=True, every_cell=True),
    "y_m": _Column({"y_m": 1.0, "y": 1.0}, -math.inf, math.inf, every_column=True, every_cell=True),
    "dbh_m": _Column({"dbh_cm": 0.01, "dbh_m": 1.0}, 0.01, 5.0, every_column=True, every_cell=True),
    "height_m": _Column({"height_m": 1.0}, 2.0, 130.0, every_column=True),
    "crown_base_m": _Column({"crown_base_m": 1.0}, 0.0, 130.0),
    "crown_width_m": _Column({"crown_width_m": 1.0}, 0.1, 60.0),
    "lean_deg": _Column({"lean_deg": 1.0}, 0.0, 45.0),
    "lean_azimuth_deg": _Column({"lean_azimuth_deg": 1.0}, 0.0, 360.0),
    "lean_towards_deg": _Column({"lean_towards_deg": 1.0}, 0.0, 360.0),
}

_SPECIES = "species"
_DIRECTIONS = ("lean_azimuth_deg", "lean_towards_deg")


def read_stem_list(path: Path, table: Mapping[str, Species], origin_m: tuple[float, float, float]) -> Trees:
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
    rows = _read_rows(path)
    lines = np.array([line for line, _ in rows])
    trees = np.zeros(len(rows), TREE)
    species = [known([row[_SPECIES]], table, f"{path}, line {line}, column {_SPECIES}")[0] for line, row in rows]
    trees["species"], trees["list_line"] = [one.number for one in species], lines
    numbers = {name: _numbers(path, rows, column) for name, column in _COLUMNS.items()}
    trees["x_m"], trees["y_m"] = numbers["x_m"] - origin_m[0], numbers["y_m"] - origin_m[1]
    trees["dbh_m"] = numbers["dbh_m"]
    trees["height_m"] = _with_heights(path, numbers, species)
    trees["crown_base_m"], trees["crown_width_m"] = _with_crowns(trees, numbers, species)
    trees["lean_deg"] = np.nan_to_num(numbers["lean_deg"])
    towards = np.where(
        np.isnan(numbers["lean_towards_deg"]), 90.0 - numbers["lean_azimuth_deg"], numbers["lean_towards_deg"]
    )
    trees["lean_towards_deg"] = np.nan_to_num(towards) % 360
    _check_slender(path, lines, trees)
    _check_crown_bases(path, lines, trees)
    _check_twice(path, lines, trees)
    return trees


def _read_rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Cells by column name, and the line of each tree."""
    with readable(path, "a stem list in CSV", GeometryError), path.open(encoding="utf-8-sig", newline="") as file:
        header = file.readline()
        delimiter = next(mark for mark in ";\t," if mark in header or mark == ",")
        names = [name.strip().lower() for name in next(csv.reader([header], delimiter=delimiter), [])]
        _check_header(path, names)
        rows = []
        reader = csv.reader(file, delimiter=delimiter)
        for cells in reader:
            line = reader.line_num + 1
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(names):
                raise GeometryError(f"{path}, line {line}", f"found {len(cells)} cells", f"{len(names)}, as in line 1")
            rows.append((line, dict(zip(names, (cell.strip() for cell in cells), strict=True))))
    if not rows:
        raise GeometryError(str(path), "no tree below line 1", "one tree to a line")
    return rows


def _check_header(path: Path, names: list[str]) -> None:
    where = f"{path}, line 1"
    wanted = [((_SPECIES,), True), (_DIRECTIONS, False)]
    wanted += [(tuple(c.units), c.every_column) for c in _COLUMNS.values()]
    is_list = any(name in choices for choices, _ in wanted for name in names)  # else nothing of it is shown
    for choices, needed in wanted:
        found = [name for name in names if name in choices]
        if len(found) > 1:
            raise GeometryError(where, f"found {' and '.join(found)}", f"one of {' or '.join(choices)}")
        if needed and not found:
            listed = ", ".join(names) if is_list else "the columns"
            raise GeometryError(where, f"no column {' or '.join(choices)}", f"it among {listed}")


def _numbers(path: Path, rows: list[tuple[int, dict[str, str]]], column: _Column) -> Array:
    """One column in metres or degrees, (n,), NaN where a cell is empty or there is no such column."""
    header = next((header for header in column.units if header in rows[0][1]), None)
    if header is None:
        return np.full(len(rows), np.nan)
    factor = column.units[header]
    low, high = (f"{limit / factor:g}" for limit in (column.low, column.high))
    expected = "a number" if math.isinf(column.low) else f"a number from {low} to {high}"
    numbers = np.empty(len(rows))
    for i, (line, row) in enumerate(rows):
        where = f"{path}, line {line}, column {header}"
        if not row[header]:
            if column.every_cell:
                raise GeometryError(where, "nothing", expected)
            numbers[i] = np.nan
            continue
        try:
            number = float(row[header])
        except ValueError:
            raise GeometryError(where, f"found {row[header]!r}", expected) from None
        numbers[i] = number * factor
        if not (math.isfinite(number) and column.low <= numbers[i] <= column.high):
            raise GeometryError(where, f"found {row[header]}", expected)
    return numbers


def _with_heights(path: Path, numbers: dict[str, Array], species: list[Species]) -> Array:
    """Heights (n,), those that nobody measured by the species' curve."""
    dbh_cm, height_m = 100 * numbers["dbh_m"], numbers["height_m"].copy()
    of = np.array([one.number for one in species])
    for one in {one.number: one for one in species}.values():
        own, missing = of == one.number, (of == one.number) & np.isnan(height_m)
        if not missing.any():
            continue
        measured = own & ~missing
        if not measured.any():
            found = f"no tree of {one.name} has a height"
            raise GeometryError(f"{path}: height_m", found, "one at least, to draw its height curve through")
        mean_cm = float(np.sqrt(np.mean(np.square(dbh_cm[measured]))))
        curve_m = one.height_m(dbh_cm[missing], mean_cm, float(height_m[measured].mean()))
        height_m[missing] = np.maximum(curve_m, _COLUMNS["height_m"].low)
    return height_m


def _with_crowns(trees: Trees, numbers: dict[str, Array], species: list[Species]) -> tuple[Array, Array]:
    """Crown bases and crown widths (n,), those that nobody measured by the species' equations."""
    dbh_cm, height_m = 100 * trees["dbh_m"], trees["height_m"]
    thickest = np.argsort(-dbh_cm, kind="stable")[: math.ceil(_TOP_SHARE * len(trees))]
    top_m = float(height_m[thickest].mean())
    base_m, width_m = numbers["crown_base_m"].copy(), numbers["crown_width_m"].copy()
    for one in {one.number: one for one in species}.values():
        own = trees["species"] == one.number
        no_base, no_width = own & np.isnan(base_m), own & np.isnan(width_m)
        base_m[no_base] = one.crown_base_m(dbh_cm[no_base], height_m[no_base], top_m)
        width_m[no_width] = one.crown_width_m(dbh_cm[no_width])
    return base_m, width_m


def _check_slender(path: Path, lines: IntArray, trees: Trees) -> None:
    """Refuse a list of trees that are far too thick for their height: their DBH is in millimetres."""
    slenderness = trees["height_m"] / trees["dbh_m"]
    if (middle := float(np.median(slenderness))) < LEAST_SLENDERNESS:
        i = int(slenderness.argmin())
        found = f"found {100 * trees['dbh_m'][i]:g} cm at a height of {trees['height_m'][i]:g} m; half of all trees are less than {middle:.0f} times as high as thick"
        expected = f"{LEAST_SLENDERNESS:g} times or more (is the DBH in mm?)"
        raise GeometryError(f"{path}, line {lines[i]}, DBH", found, expected)


def _check_crown_bases(path: Path, lines: IntArray, trees: Trees) -> None:
    above = trees["crown_base_m"] >= trees["height_m"]
    if above.any():
        i = int(above.argmax())
        where, base_m, height_m = f"{path}, line {lines[i]}", trees["crown_base_m"][i], trees["height_m"][i]
        raise GeometryError(f"{where}, column crown_base_m", f"found {base_m:g}", f"less than the height, {height_m:g}")


def _check_twice(path: Path, lines: IntArray, trees: Trees) -> None:
    from scipy.spatial import cKDTree

    places = places_m(trees, "xy")
    pairs = sorted(cKDTree(places).query_pairs(_APART_M))
    if pairs:
        first, second = pairs[0]
        found = f"the place of line {lines[first]}, ({places[second, 0]:g}, {places[second, 1]:g}) m in the scene"
        raise GeometryError(f"{path}, line {lines[second]}", found, f"trees at least {_APART_M:g} m apart")
