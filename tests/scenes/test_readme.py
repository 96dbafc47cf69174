"""What the README shows can be done."""

import re
import shlex
from pathlib import Path

import pytest

from vlp16emu.cli.app import run
from vlp16emu.scenario import load

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = sorted(
    set(re.findall(r"`?(vlp16emu (?:record|stream|decode|verify|forest|scenes|schema)\b[^`\n]*)", README))
)


def test_the_scene_of_the_readme_can_be_walked(tmp_path):
    """The scene file that the README shows is one, and its walk is long enough."""
    (block,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    path = tmp_path / "my_forest.toml"
    path.write_text(block, encoding="utf-8")
    scenario = load(str(path))
    assert scenario.duration_s * scenario.motion.speed_m_s <= 40.0


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
