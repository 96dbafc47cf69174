"""What a wheel brings into somebody's site-packages."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


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


def test_a_wheel_has_one_name(wheel):
    """Installing puts exactly one importable name into site-packages: vlp16emu."""
    tops = {name.partition("/")[0] for name in wheel.namelist()}
    assert tops == {"vlp16emu", f"vlp16emu-{PROJECT['version']}.dist-info"}


def test_a_wheel_has_every_module_and_nothing_compiled(wheel):
    """All modules of the checkout are in the wheel, no cache is."""
    ours = {str(path.relative_to(ROOT)) for path in (ROOT / "vlp16emu").rglob("*.py")}
    assert ours <= set(wheel.namelist())
    assert not [name for name in wheel.namelist() if name.endswith((".pyc", ".nbc", ".nbi"))]


def test_a_wheel_has_its_data(wheel):
    """Scenes, the species table and the marker for type checkers are shipped inside the package."""
    names = set(wheel.namelist())
    scenes = {f"vlp16emu/scenes/{path.name}" for path in (ROOT / "scenes").glob("*.toml")}
    assert len(scenes) >= 3
    assert names >= scenes | {"vlp16emu/py.typed", "vlp16emu/world/species.toml"}


def test_a_wheel_has_the_command_and_the_licence(wheel):
    """The command `vlp16emu`, the lowest Python and the licence stand in the wheel."""
    info = f"vlp16emu-{PROJECT['version']}.dist-info"
    assert wheel.read(f"{info}/entry_points.txt").decode().split() == [
        "[console_scripts]",
        "vlp16emu",
        "=",
        "vlp16emu.cli:main",
    ]
    metadata = Parser().parsestr(wheel.read(f"{info}/METADATA").decode())
    assert (metadata["License-Expression"], metadata["Requires-Python"]) == ("MIT", ">=3.11")
    assert f"{info}/licenses/LICENSE" in wheel.namelist()


def test_the_lock_file_names_every_requirement_and_no_place():
    """The lock file pins each requirement of the project, and holds no index, host or path."""
    lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    pinned = {line.partition("==")[0] for line in lines if "==" in line and not line.startswith((" ", "#"))}
    extras = PROJECT["optional-dependencies"]
    wanted = {
        requirement.partition(">=")[0].partition("[")[0]
        for requirement in [*PROJECT["dependencies"], *extras["picture"], *extras["dev"]]
    }
    assert wanted - {"vlp16emu"} <= pinned
    assert not [line for line in lines if "://" in line or "index" in line or line.startswith(("-", "/"))]
