"""`scenes/SETTINGS.md`, the page of all keys of a scene file."""

import re
import runpy
from pathlib import Path

import pytest

from vlp16emu.scenario import load, schema

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {"scene": schema(), **schema()["$defs"]}


@pytest.fixture(scope="module")
def tool(tool_named):
    return tool_named("settings_table")


def test_the_page_is_as_its_script_makes_it(tool):
    """The page in the repository is what `tools/settings_table` makes of the definitions."""
    assert (ROOT / "scenes" / "SETTINGS.md").read_text(encoding="utf-8") == tool.page(), "run tools/settings_table"


def test_every_key_is_on_the_page(tool):
    """Each section of the schema has its heading, and each key a line there or a link to the section that has the same line."""
    tables, said = tool.tables(), {}
    assert set(tables) == {"", *schema()["$defs"]}
    assert len({table.title for table in tables.values()}) == len(tables)
    for name, table in tables.items():
        text = tool.section(table, tables, said)
        shared = [key for keys in re.findall(r"((?:`\w+`,? )+)as in \[", text) for key in re.findall(r"`(\w+)`", keys)]
        own = [line.split("`")[1] for line in text.splitlines() if line.startswith("| `")]
        assert sorted(own + shared) == sorted(SECTIONS[name or "scene"]["properties"])
    assert len(said) <= 400


FROM = {"world.basal_area_m2_per_ha": "managed_mixed", "wind.towards_deg": "windy_spruce"}
EXAMPLES = [
    (path, example)
    for examples in runpy.run_path(str(ROOT / "tools" / "settings_table"))["BASIC"].values()
    for path, example in examples.items()
]


@pytest.mark.parametrize(("path", "example"), EXAMPLES, ids=[path for path, _ in EXAMPLES])
def test_the_examples_of_what_people_set_are_taken(path, example):
    """Each example is a value of its key that differs from the default."""
    assert load(FROM.get(path, "birch_walk"), [f"{path}={example}"]) != load(FROM.get(path, "birch_walk"))
