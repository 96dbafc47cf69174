"""`scenes/SETTINGS.md`, the page of all keys of a scene file."""

from pathlib import Path

import pytest

from vlp16emu.scenario import schema

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {"scene": schema(), **schema()["$defs"]}


@pytest.fixture(scope="module")
def tool(tool_named):
    return tool_named("settings_table")


def test_the_page_is_as_its_script_makes_it(tool):
    """The page in the repository is what `tools/settings_table` makes of the definitions."""
    assert (ROOT / "scenes" / "SETTINGS.md").read_text(encoding="utf-8") == tool.page(), "run tools/settings_table"


def test_every_section_is_on_the_page(tool):
    """Each section of the schema has its table, once, and each key a line there."""
    tables = tool.tables()
    assert set(tables) == {"", *schema()["$defs"]}
    assert len({table.title for table in tables.values()}) == len(tables)
    for name, table in tables.items():
        lines = tool.section(table, tables).splitlines()
        keys = SECTIONS[name or "scene"]["properties"]
        assert [line.split("`")[1] for line in lines if line.startswith("| `")] == list(keys)


def test_every_key_has_a_meaning(tool):
    """No line of the page ends without saying what the key is."""
    assert [line for line in tool.page().splitlines() if line.startswith("|") and line.endswith("|  |")] == []


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("speed_m_s", "m/s"),
        ("accel_walk_m_s3_sqrt_hz", "m/s3/sqrt(Hz)"),
        ("basal_area_m2_per_ha", "m2/ha"),
        ("rpm", "rev/min"),
        ("range_at_10_percent_m", "m"),
        ("rays", ""),
        ("threshold_snr", ""),
    ],
)
def test_units_are_read_off_the_keys(tool, key, unit):
    """The unit of a key is that of its longest known ending."""
    assert tool._unit(key) == unit
