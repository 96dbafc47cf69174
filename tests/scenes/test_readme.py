"""What the README shows can be done."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from vlp16emu.cli.app import run
from vlp16emu.scenario import load

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = sorted(set(re.findall(r"(?m)(?:`|^    )(vlp16emu [a-z]+\b[^`\n]*)", README)))
TABLES = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
HEAD = "schema", "title", "seed", "duration_s"


def test_the_scene_of_the_readme_can_be_walked(tmp_path):
    """The scene file that the README shows is one, and its walk is long enough."""
    path = tmp_path / "my_forest.toml"
    path.write_text(TABLES[0], encoding="utf-8")
    scenario = load(str(path))
    assert scenario.duration_s * scenario.motion.speed_m_s <= 40.0


@pytest.mark.parametrize("tables", TABLES[1:])
def test_the_tables_of_the_readme_fit_into_a_scene(tables, tmp_path):
    """Tables that the README shows alone, in the place of those of its scene, make a scene."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in tomllib.loads(TABLES[0]).items() if key in HEAD]
    others = [table for table in re.split(r"(?m)^(?=\[)", TABLES[0])[1:] if table.split()[0] not in tables]
    path = tmp_path / "my_forest.toml"
    path.write_text("\n".join([*lines, tables, *others]), encoding="utf-8")
    assert load(str(path)).title == "Thirty seconds among birches"


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_of_the_readme_are_understood(command, capsys):
    """Verbs and options in the README exist: with --help behind them they are accepted."""
    assert run([*shlex.split(command)[1:], "--help"]) == 0
    assert capsys.readouterr().err == ""


def test_the_places_of_the_readme_exist():
    """Files and folders that the README names are there."""
    places = re.findall(r"`((?:protocol|tools|scenes|tests|vlp16emu)/[\w./-]*)`", README)
    assert len(places) > 8
    assert [place for place in places if not (ROOT / place).exists()] == []
