"""Columns and codes in `scenes/OUTPUTS.md`, and stem lists in `scenes/README.md`, are those of the program."""

import re
from pathlib import Path

import pytest

from vlp16emu.extras.clouds.cloud import CAPTURE_COLUMNS, RETURN_NAMES, SCENE_COLUMNS, TRUTH_COLUMNS
from vlp16emu.extras.truth.slots import LEAF_OR_WOOD, SLOT_COLUMNS
from vlp16emu.extras.truth.truth import _GNSS_COLUMNS, _IMU_COLUMNS, ATTITUDE, STAMP
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.given_stand import _COLUMNS
from vlp16emu.forest.stand.inventory import INVENTORY
from vlp16emu.scenario import scene_files
from vlp16emu.tables import LARGEST
from vlp16emu.types import PlantPart, Semantic

SCENES = Path(__file__).resolve().parents[2] / "scenes"


def table(heading, number=0, file="OUTPUTS.md"):
    """Cells of a table below a heading, line by line, without the line that names the columns."""
    text = (SCENES / file).read_text(encoding="utf-8")
    section = re.split(r"(?m)^##+ ", text.partition(f"# {heading}\n")[2])[0]
    lines = re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)[number].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def names(cell):
    return re.findall(r"`(\w+)`", cell)


def test_the_columns_of_the_inventory_are_given_in_their_order():
    """Each column of the file has its line in the table, with the unit that its name ends with."""
    rows = table("The inventory")
    assert [names(cell)[0] for cell, _, _ in rows] == list(INVENTORY.names)
    assert all(name.endswith(f"_{unit}") for (name,), unit in ((names(c), u) for c, u, _ in rows) if unit)


def test_the_columns_of_a_stem_list_are_given_with_their_limits():
    """Every name that a column may have is given, with its limits in its own unit and whether it must be there."""
    given = {name: row for row in table("Stem lists", file="README.md") for name in names(row[0])}
    read = {name: (column, factor) for column in _COLUMNS.values() for name, factor in column.units.items()}
    assert set(given) == {*read}
    del read["species"]
    for name, (column, factor) in read.items():
        _, unit, limits, needed, _ = given[name]
        assert name.endswith(f"_{unit}") or name in {"x", "y"} or not unit
        if column.high == LARGEST:
            assert limits == ""
        else:
            assert limits.startswith(f"{column.low / factor:g} to {column.high / factor:g}")
        assert needed.startswith("in each line") == column.is_filled
        assert bool(needed) == column.is_needed


@pytest.mark.parametrize(("number", "columns"), [(0, SCENE_COLUMNS), (1, CAPTURE_COLUMNS)])
def test_the_columns_of_points_are_given_in_each_format(number, columns):
    """Each array of points has its line, with its names in CSV and PLY."""
    given = [tuple(tuple(names(cell)) for cell in row[:3]) for row in table("Points", number)]
    assert given == [((column.name,), column.csv, column.ply) for column in columns]


def test_the_numbers_of_returns_are_given():
    """What means strongest, last and second strongest is given with its number."""
    given = {names(row[0])[0]: row[3] for row in table("Points")}["return_number"]
    assert given == ", ".join(f"{i} {name.replace('_', ' ')}" for i, name in enumerate(RETURN_NAMES))


@pytest.mark.parametrize(("number", "labels"), [(0, Semantic), (1, PlantPart)])
def test_the_labels_are_given_with_their_numbers(number, labels):
    """Every class and every part is in its table under its number, and no other does."""
    rows = table("Labels", number + 3)
    assert {int(row[0]): row[1] for row in rows} == {int(label): label.name.lower() for label in labels}


def test_the_columns_of_the_truth_are_given():
    """The table of labels names every column that `--truth` adds, and those of IMU and GNSS every column of their files."""
    assert [name for row in table("Labels") for name in names(row[0])] == [c.name for c in TRUTH_COLUMNS]
    assert [name for row in table("imu.csv") for name in names(row[0])] == [*_IMU_COLUMNS, *ATTITUDE, STAMP]
    assert [name for row in table("gnss.csv") for name in names(row[0])] == list(_GNSS_COLUMNS)
    assert [name for row in table("returns.parquet") for name in names(row[0])] == list(SLOT_COLUMNS)


def test_leaf_or_wood_is_given_for_each_part():
    """The column `leaf_wood` of the table is that of labelled points."""
    assert [int(row[2]) for row in table("Labels", 4)] == LEAF_OR_WOOD.tolist()


def test_the_species_are_given_with_their_numbers():
    """Every tree and shrub of the program is in the table under its number, and no other does."""
    assert {int(number): name for number, name in table("Species")} == flora().names


def test_every_scene_has_a_row_and_a_picture():
    """The table of `scenes/README.md` names all scenes, each with a heading and a picture that exists."""
    text = (Path(__file__).parents[2] / "scenes" / "README.md").read_text(encoding="utf-8")
    for name in scene_files():
        assert f"\n| [`{name}`](#{name}) | " in text, name
        assert f"\n### {name}\n" in text, name
        assert f"](pictures/{name}.png)" in text, name
        assert (Path(__file__).parents[2] / "scenes" / "pictures" / f"{name}.png").is_file(), name
