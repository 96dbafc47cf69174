"""The table of laws of real units."""

import math
import re
import tomllib
from pathlib import Path

import pytest

from vlp16emu.sensor.laws import law, span

PACKAGE = Path(__file__).parents[2] / "vlp16emu"
ROWS = {
    f"{section}.{name}": row
    for section, rows in tomllib.loads((PACKAGE / "sensor/laws.toml").read_text(encoding="utf-8")).items()
    for name, row in rows.items()
}


@pytest.mark.parametrize("name", ROWS)
def test_a_law_has_value_unit_and_source(name):
    """Each row says what it is, with finite numbers, a unit and a source."""
    row = ROWS[name]
    assert set(row) == {"what", "value", "unit", "source"}
    assert all(math.isfinite(value) for value in span(name))
    assert row["what"].endswith(".")
    assert row["unit"]
    assert row["source"]


def test_every_law_is_used():
    """The package names each law, or its section with all names of `LossRates`."""
    texts = [path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")]
    used = {name for text in texts for name in re.findall(r'(?:law|span)\("([\w.]+)"\)', text)}
    names = ("step", "up", "down", "dark", "gloss", "raise_code", "bright", "again")
    rates = {f"loss.{name}" for name in names}
    assert used | rates == set(ROWS)


def test_one_value_is_asked_for_by_another_name_than_a_span():
    """`law` gives one number, `span` all; a law of two ends is no number."""
    assert law("loss.near_m") == 4.0
    assert span("loss.step") == (0.1, 0.45)
    with pytest.raises(ValueError, match="unpack"):
        law("loss.step")


def test_names_of_recordings_stand_in_data_files():
    """No module names a recording: a unit is a letter, which protocol/README.md explains."""
    found = [
        path.name
        for path in PACKAGE.rglob("*.py")
        if re.search("einride|mrpt|nebula", path.read_text(encoding="utf-8"), re.IGNORECASE)
    ]
    assert found == []
    page = (PACKAGE.parent / "protocol" / "README.md").read_text(encoding="utf-8")
    assert all(f"unit {letter} |" in page for letter in "ABCD")
