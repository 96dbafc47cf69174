"""`scenes/SETTINGS.md`, the page of all keys of a scene file."""

import re
import runpy
from decimal import Decimal
from pathlib import Path

import pytest

from vlp16emu.errors import InputError
from vlp16emu.scenario import load, schema

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {"scene": schema(), **schema()["$defs"]}


@pytest.fixture(scope="module")
def tool(tool_named):
    return tool_named("settings_table")


def test_the_page_is_as_its_script_makes_it(tool):
    """The page in the repository is what `tools/settings_table` makes of the definitions."""
    assert (ROOT / "scenes" / "SETTINGS.md").read_text(encoding="utf-8") == tool.page(), (
        "run tools/settings_table"
    )


def test_every_key_is_on_the_page(tool):
    """Each section of the schema has its heading, and each key a line there or a link to the section that
    has the same line."""
    tables, said = tool.tables(), {}
    assert set(tables) == {"", *schema()["$defs"]}
    assert len({table.title for table in tables.values()}) == len(tables)
    for name, table in tables.items():
        text = tool.section(table, tables, said)
        shared = [
            key
            for keys in re.findall(r"((?:`\w+`,? )+)as in \[", text)
            for key in re.findall(r"`(\w+)`", keys)
        ]
        own = [line.split("`")[1] for line in text.splitlines() if line.startswith("| `")]
        assert sorted(own + shared) == sorted(SECTIONS[name or "scene"]["properties"])
    assert len(said) <= 410


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


NUMBER = r"-?[\d.]+"
BOUNDS = re.compile(
    rf"(?P<whole>whole number )?"
    rf"(?:from (?P<ge>{NUMBER}) to (?P<le>{NUMBER})|(?:above (?P<gt>{NUMBER})|at least (?P<least>{NUMBER}))?"
    rf"(?: and )?(?:at most (?P<most>{NUMBER})|below (?P<lt>{NUMBER}))?)(?: in steps of (?P<step>\d+))?$"
)


BESIDE = {"sensor.min_range_m": ["sensor.max_range_m=131.07"], "sensor.max_range_m": ["sensor.model=vls-128"]}
"""Settings without which another key refuses a value within the limits."""


def first_tables():
    """Return the values that the page's tables of common settings admit, by key."""
    text = (ROOT / "scenes" / "SETTINGS.md").read_text(encoding="utf-8").partition("## All keys")[0]
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| `")]
    return {row[0].strip("| `"): row[3] for row in rows}


def refusal(key, value):
    """Return the line with which `--set` refuses a value of a key; empty if it is taken."""
    try:
        load(FROM.get(key, "birch_walk"), [*BESIDE.get(key, ()), f"{key}={value}"])
    except InputError as error:
        return str(error)
    return ""


def limits():
    """Return the limits of the numbers in these tables, by key."""
    found = {key: BOUNDS.match(values.partition(";")[0]) for key, values in first_tables().items()}
    groups = {key: match.groupdict() for key, match in found.items() if match}
    return {key: limit for key, limit in groups.items() if any(limit.values())}


LIMITS = limits()


@pytest.mark.parametrize("key", LIMITS)
def test_the_limits_of_the_first_tables_are_those_of_the_program(key):
    """`--set` takes each number of the common tables up to its limits, and refuses the next beyond."""
    found = {name: Decimal(value) for name, value in LIMITS[key].items() if value and name != "whole"}
    step = found.pop("step", Decimal(1) if LIMITS[key]["whole"] else Decimal("1e-6"))
    taken, refused = [], []
    for name, limit in found.items():
        beyond = limit - step if name in ("ge", "gt", "least") else limit + step
        is_open = name in ("gt", "lt")
        taken.append(2 * limit - beyond if is_open else limit)
        refused.append(limit if is_open else beyond)
    if LIMITS[key]["step"]:
        taken.append(found["ge"] + step)
        refused.append(found["ge"] + 1)
    assert [refusal(key, value) for value in taken] == [""] * len(taken)
    for value in refused:
        assert refusal(key, value).startswith(f"--set {key}={value}: found ")


@pytest.mark.parametrize("key", [key for key, values in first_tables().items() if re.match(r'"\w', values)])
def test_the_words_of_the_first_tables_are_those_of_the_program(key):
    """The refusal of a wrong word by `--set` lists the words that the common tables have for that key."""
    words = re.findall(r'"([^"]+)"', first_tables()[key])
    expectation = refusal(key, "none_of_them").partition("expected")[2]
    assert sorted(re.findall(r'"([^"]+)"', expectation)) == sorted(words)


def test_the_defaults_of_a_rig_are_those_of_an_empty_table(tool):
    """Defaults under `rig` are what an empty table of `[[rig]]` gives."""
    (unit,) = load("birch_walk", ["rig=[{}]"]).rig
    assert tool.tables()["RigUnit"].default == unit.model_dump(mode="json")
