"""Columns and codes in `scenes/OUTPUTS.md`, and stem lists in `scenes/README.md`, are those of the
program."""

import re
from pathlib import Path

import pytest

from vlp16emu.extras.clouds.cloud import CAPTURE_COLUMNS, RETURN_NAMES, SCENE_COLUMNS, TRUTH_COLUMNS
from vlp16emu.extras.imu.settings import Imu
from vlp16emu.extras.truth.slots import LEAF_OR_WOOD, SLOT_COLUMNS
from vlp16emu.extras.truth.tables import FIXES, POSES, inertial_table
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.given_stand import _COLUMNS
from vlp16emu.forest.stand.inventory import INVENTORY
from vlp16emu.scenario import load, scene_files, schema
from vlp16emu.tables import LARGEST
from vlp16emu.types import PlantPart, Semantic

INERTIAL = inertial_table(Imu(attitude=True, jitter_s=0.001))
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
    """Every name that a column may have is given, with its limits in its own unit and whether it must be
    there."""
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
    """Each array of points has its line, with its names in CSV and PLY, and returns their numbers."""
    given = [tuple(tuple(names(cell)) for cell in row[:3]) for row in table("Points", number)]
    assert given == [((column.name,), tuple(column.csv), tuple(column.ply)) for column in columns]
    returns = [row[3] for row in table("Points", number) if names(row[0]) == ["return_number"]]
    assert returns == [
        ", ".join(f"{i} {name.replace('_', ' ')}" for i, name in enumerate(RETURN_NAMES))
    ] * len(returns)


@pytest.mark.parametrize(
    ("heading", "columns"),
    [
        ("Labels", [column.name for column in TRUTH_COLUMNS]),
        ("imu.csv", INERTIAL.header.rstrip().split(",")),
        ("gnss.csv", FIXES.header.rstrip().split(",")),
        ("returns.parquet", list(SLOT_COLUMNS)),
    ],
)
def test_the_columns_of_the_truth_are_given(heading, columns):
    """Each column of labels and of the files of the truth has its line."""
    assert [name for row in table(heading) for name in names(row[0])] == columns


@pytest.mark.parametrize(("number", "table_"), [(0, POSES), (1, INERTIAL), (2, FIXES)])
def test_the_fields_of_the_tables_are_given(number, table_):
    """Each field of the binary tables has its line, with its type."""
    rows = table("Tables of the ground truth", number)
    given = {name: kind for fields, kind, _ in rows for name in names(fields)}
    kinds = {"<i8": "int64", "<f8": "float64", "|b1": "bool"}
    dtypes = {name: table_.dtype[name] for name in table_.dtype.names}
    shapes = {name: f" x {kind.shape[0]}" if kind.shape else "" for name, kind in dtypes.items()}
    assert given == {name: kinds[kind.base.str] + shapes[name] for name, kind in dtypes.items()}


def test_labels_and_their_numbers_are_given():
    """Every class and part is in its table under its number, each part with its leaf or wood, and every
    species."""
    for number, labels in ((3, Semantic), (4, PlantPart)):
        assert {int(row[0]): row[1] for row in table("Labels", number)} == {
            int(x): x.name.lower() for x in labels
        }
    assert [int(row[2]) for row in table("Labels", 4)] == LEAF_OR_WOOD.tolist()
    assert {int(number): name for number, name in table("Species")} == flora().names


def test_every_scene_has_a_row_and_a_picture():
    """The table of `scenes/README.md` names all scenes, each with a heading and a picture that exists."""
    text = (Path(__file__).parents[2] / "scenes" / "README.md").read_text(encoding="utf-8")
    for name in scene_files():
        assert f"\n| [`{name}`](#{name}) | " in text, name
        assert f"\n### {name}\n" in text, name
        assert f"](pictures/{name}.png)" in text, name
        assert (Path(__file__).parents[2] / "scenes" / "pictures" / f"{name}.png").is_file(), name


def test_the_figures_of_a_scene_are_those_of_the_program(tool_named):
    """In the table of scenes, seasons, sensors and durations are right, and all figures of the first row."""
    tool = tool_named("scene_table")
    text = (SCENES / "README.md").read_text(encoding="utf-8")
    for name, file in scene_files().items():
        (line,) = re.findall(rf"(?m)^\| \[`{name}`\].*$", text)
        season, sensor, duration = tool.setting_cells(load(str(file)))
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert [cells[2], *cells[-2:]] == [season, sensor, duration], name
    assert f"\n{tool.row('birch_walk', 'pure silver birch')}\n" in text


@pytest.mark.parametrize(("heading", "section"), [("Events", "events"), ("Motion and rig", "motion")])
def test_the_kinds_of_a_table_are_given(heading, section):
    """The tables of events and motions name each kind that a scene takes."""
    node = schema()["properties"][section]
    kinds = node.get("items", node)["discriminator"]["mapping"]
    given = [name for row in table(heading, file="README.md") for name in names(row[0])]
    assert sorted(given) == sorted(kinds)
