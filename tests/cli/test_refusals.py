"""Bad input is one line that says where, what was found and what was expected: the rows of
`tests/refusals.toml`."""

import re
import shlex

import pytest
from kit import refusals

from vlp16emu.cli.app import run
from vlp16emu.engine import assemble
from vlp16emu.errors import InputError
from vlp16emu.scenario import load

TABLE = refusals()
CODES = {"refused": 2, "failed": 1}
COMMANDS = [
    pytest.param(code, verb, words, line, id=f"{verb} {words}"[:80])
    for group, code in CODES.items()
    for verb, rows in TABLE[group].items()
    for words, line in rows.items()
]
SETTINGS = [
    pytest.param(scene, settings, line, id=f"{scene} {settings}"[:80])
    for scene, rows in TABLE["settings"].items()
    for settings, line in rows.items()
]
SCENES = [
    pytest.param(scene["text"], change, line, id=f"{name} {line}"[:80])
    for name, scene in TABLE["scenes"].items()
    for change, line in scene["wrong"].items()
]


def content(folder):
    """Names, sizes and times of all that lies in a folder."""
    found = ((path, path.lstat()) for path in sorted(folder.rglob("*")))
    return [(path, status.st_size, status.st_mtime_ns) for path, status in found]


def assert_said(found, line):
    """A line is as in the table, whose … stands for anything."""
    pattern = ".*".join(map(re.escape, line.split("…")))
    assert re.fullmatch(pattern, found), f"{found!r}, not {line!r}"


@pytest.mark.parametrize(("code", "verb", "words", "line"), COMMANDS)
def test_a_command_that_cannot_be_carried_out_is_one_line(cli, inputs, monkeypatch, code, verb, words, line):
    """The exit code is 2 for bad input, 1 for a full disk; standard output stays empty, and files as they
    are."""
    if verb == "view" or "--view" in words:
        pytest.importorskip("viser", reason="the extra viewer is not installed")
    monkeypatch.chdir(inputs)
    before = content(inputs)
    outcome = cli(*([] if verb == "vlp16emu" else [verb]), *shlex.split(words))
    assert (outcome.code, outcome.out) == (code, "")
    assert outcome.err.count("\n") == 1
    assert_said(outcome.err, f"error: {line}\n")
    assert content(inputs) == before


@pytest.mark.parametrize(("scene", "settings", "line"), SETTINGS)
def test_a_setting_that_cannot_be_is_one_line(scene, settings, line):
    """The setting is named as it was given, not blamed on the file, before memory or time are gone."""
    with pytest.raises(InputError) as caught:
        assemble(load(scene, settings.split(" & ")))
    assert_said(str(caught.value), line.replace("{set}", f"--set {settings}"))


@pytest.mark.parametrize(("text", "change", "line"), SCENES)
def test_a_scene_that_cannot_be_is_one_line(tmp_path, text, change, line):
    """The line has the file, the key path, what was found and what was expected."""
    right, wrong = change.split(" -> ")
    assert text.count(right) == 1
    path = tmp_path / "scene.toml"
    path.write_text(text.replace(right, wrong), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load(path)
    assert_said(str(caught.value), f"{path}: {line}")


def test_a_long_word_of_the_command_line_is_cut(capsys):
    """An argument of 6000 characters that no verb takes is repeated in part: the line has less than 1200."""
    assert run(["scenes", "x/" * 3_000]) == 2
    line = capsys.readouterr().err
    assert line.startswith("error: Got unexpected extra argument")
    assert line.endswith("...; see `vlp16emu scenes --help`\n")
    assert len(line) < 1_200
