"""Bad input is one line that says where, what was found and what was expected: the rows of `tests/refusals.toml`."""

import os
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from vlp16emu.cli.app import run
from vlp16emu.engine import assemble
from vlp16emu.errors import InputError
from vlp16emu.scenario import load

TABLE = tomllib.loads((Path(__file__).parents[1] / "refusals.toml").read_text(encoding="utf-8"))
RIG = "rig=[{}, {return_mode='dual', address='10.0.0.7', data_port=2368, position_port=8308}]"
MADE = (
    ("record", "static_bench", "bench.pcap"),
    ("record", "static_bench", "rig.pcap", "--set", RIG),
    ("truth", "static_bench", "truth"),
)
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with all that the command lines name."""
    folder = tmp_path_factory.mktemp("refusals")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for words in MADE:
            assert run([*words, "--duration", "0.1", "--json"]) == 0
        for name, text in TABLE["files"].items():
            Path(name).parent.mkdir(exist_ok=True)
            Path(name).write_text(text, encoding="utf-8")
    (folder / "empty.pcap").write_bytes((folder / "bench.pcap").read_bytes()[:24])
    os.mkfifo(folder / "pipe")
    for ending in ("csv", "laz", "npz", "ply"):
        (folder / f"full.{ending}").symlink_to("/dev/full")
    return folder


def content(folder):
    """Names, sizes and times of all that lies in a folder."""
    found = ((path, path.lstat()) for path in sorted(folder.rglob("*")))
    return [(path, status.st_size, status.st_mtime_ns) for path, status in found]


def assert_said(found, line):
    """A line is as in the table, whose … stands for anything."""
    pattern = ".*".join(map(re.escape, line.split("…")))
    assert re.fullmatch(pattern, found), f"{found!r}, not {line!r}"


@pytest.mark.parametrize(("code", "verb", "words", "line"), COMMANDS)
def test_a_command_that_cannot_be_carried_out_is_one_line(cli, folder, monkeypatch, code, verb, words, line):
    """The exit code is 2 for bad input, 1 for a full disk; standard output stays empty, and files as they are."""
    if verb == "view" or "--view" in words:
        pytest.importorskip("viser", reason="the extra viewer is not installed")
    monkeypatch.chdir(folder)
    before = content(folder)
    outcome = cli(*([] if verb == "vlp16emu" else [verb]), *shlex.split(words))
    assert (outcome.code, outcome.out) == (code, "")
    assert outcome.err.count("\n") == 1
    assert_said(outcome.err, f"error: {line}\n")
    assert content(folder) == before


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
