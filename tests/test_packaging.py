"""What a wheel brings into somebody's site-packages."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from configparser import ConfigParser
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TREE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, BUILD = TREE["project"], TREE["build-system"]["requires"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel built by hatchling, without network, from a copy of what it is made of."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("vlp16emu", "scenes", "protocol", "tests", "tools"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(out)]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    (path,) = out.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        yield archive


def test_a_wheel_is_the_package_and_its_scenes(wheel):
    """A wheel has one importable name, every file of the package, every scene with its files, every table of
    a model, and nothing compiled."""
    names = set(wheel.namelist())
    assert {name.partition("/")[0] for name in names} == {
        "vlp16emu",
        f"vlp16emu-{PROJECT['version']}.dist-info",
    }
    ours = {
        path for path in (ROOT / "vlp16emu").rglob("*") if path.is_file() and "__pycache__" not in path.parts
    }
    scenes = {*(ROOT / "scenes").glob("*.toml"), *(ROOT / "scenes" / "own_plot").iterdir()}
    models = set((ROOT / "protocol" / "models").glob("*.toml"))
    assert len(scenes) >= 7
    assert names >= {str(path.relative_to(ROOT)) for path in ours} | {
        f"vlp16emu/{path.relative_to(ROOT)}" for path in scenes | models
    }
    assert not [name for name in names if name.endswith((".pyc", ".nbc", ".nbi"))]


def test_a_wheel_has_the_command_and_the_licence(wheel):
    """The command `vlp16emu`, the plugin of pytest, the lowest Python and the licence stand in the wheel."""
    info = f"vlp16emu-{PROJECT['version']}.dist-info"
    entries = ConfigParser()
    entries.read_string(wheel.read(f"{info}/entry_points.txt").decode())
    assert {group: dict(entries[group]) for group in entries.sections()} == {
        "console_scripts": {"vlp16emu": "vlp16emu.__main__:main"},
        "pytest11": {"vlp16emu.pytest": "vlp16emu.pytest"},
    }
    metadata = Parser().parsestr(wheel.read(f"{info}/METADATA").decode())
    assert (metadata["License-Expression"], metadata["Requires-Python"]) == ("MIT", ">=3.11")
    assert f"{info}/licenses/LICENSE" in wheel.namelist()
    versions = {name.rpartition(" ")[2] for name in metadata.get_all("Classifier") if "Python :: " in name}
    assert versions == {"3.11", "3.12", "3.13"}


@pytest.fixture
def set_up(tmp_path):
    """`tools/setup` with a pip that writes down what it is called with, and installs nothing."""
    for name in ("pyproject.toml", "requirements.lock", "tools/setup"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    (programs / "python").symlink_to(sys.executable)
    note = 'for word; do [ -f "$word" ] && cat "$word" >>asked; done; echo "$@" >>asked'
    (programs / "pip").write_text(f"#!/bin/sh\n{note}\nexit 0\n")
    (programs / "pip").chmod(0o755)

    def call(*arguments):
        asked = tmp_path / "asked"
        asked.write_text("")
        done = subprocess.run(
            [tmp_path / "tools" / "setup", *arguments], capture_output=True, text=True, check=False
        )
        lines = asked.read_text().splitlines()
        calls = [line for line in lines if line.startswith(("install", "check"))]
        first = lines[: lines.index(calls[0])] if calls else []
        return done, calls, {line.partition("==")[0] for line in first if "==" in line}

    return call


def test_the_set_up_installs_what_was_hashed_and_no_more(set_up):
    """Every package comes with its hash from the lock, what needs it included; those of an extra only for
    it."""
    done, calls, plain = set_up()
    assert (done.returncode, done.stderr) == (0, "")
    hashed = [line for line in calls if "--require-hashes --no-deps" in line]
    assert (len(hashed), len(calls)) == (2, 4)
    assert "--no-deps -e ." in calls[2]
    assert plain >= {"numpy", "llvmlite", "pydantic-core", "mdurl", "typing-inspection"}
    assert not plain & {"pytest", "mypy", "pillow", "rasterio", "hatchling", "ruff"}
    _, _, picture = set_up("picture")
    assert picture - plain >= {"pillow"}
    assert not picture & {"pytest", "rasterio"}
    _, _, dev = set_up("dev")
    assert dev >= picture | {"pytest", "rasterio", "affine", "pluggy"}


def test_the_set_up_refuses_an_extra_that_is_none(set_up):
    """Another word than an extra is named with those there are, and nothing is installed."""
    done, calls, _ = set_up("nope")
    assert (done.returncode, calls) == (2, [])
    extras = ", ".join(PROJECT["optional-dependencies"])
    assert done.stderr == f"error: nope: no such extra; expected one of {extras}\n"
