"""Libraries of extras: their lowest versions are those of pyproject.toml, and an old one is one line."""

import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from vlp16emu import libraries
from vlp16emu.extras.doctor import _PURPOSES

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Return a function that puts the metadata of a distribution before all others."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(name, version):
        folder = tmp_path / f"{name}-{version}.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")

    return put


@pytest.mark.parametrize("extra", _PURPOSES)
def test_bounds_are_those_of_the_project(extra):
    """Names and bounds are as `packaging` reads them in pyproject.toml, which states them once."""
    rows = [Requirement(line) for line in EXTRAS[extra]]
    brought = {name: "" for row in rows for name in row.extras}
    assert (
        libraries.bounds_of(extra)
        == {row.name: str(row.specifier).removeprefix(">=") for row in rows} | brought
    )
    assert libraries.lacking(extra) == []


def test_each_extra_of_users_has_a_check():
    """`doctor` checks all extras but those for tests and developers."""
    assert set(_PURPOSES) == set(EXTRAS) - {"dev", "test"}


@pytest.mark.parametrize(
    "version", ["0.9.23", "0.10", "0.10.99", "0.11", "0.11.0", "0.11rc1", "0.11.9", "0.100", "1", "1.0.post1"]
)
def test_versions_are_in_the_order_of_the_index(installed, version):
    """A version is too old where `packaging` says so, release candidates of the bound apart."""
    installed("rosbags", version)
    is_old = Version(version).release < Version("0.11").release
    assert libraries.lacking("ros") == ([f"rosbags>=0.11 (found {version})"] if is_old else [])


def test_bags_with_an_old_library_are_one_line(cli, installed, tmp_path):
    """With rosbags 0.9.23, as pointcloudset installs it, reading and writing of bags name what to install."""
    installed("rosbags", "0.9.23")
    needed = "needs rosbags>=0.11 (found 0.9.23): pip install 'vlp16emu[ros]'\n"
    (tmp_path / "a.mcap").write_bytes(b"")
    read = cli("verify", tmp_path / "a.mcap", "--for", "all")
    assert (read.code, read.err) == (2, f"error: reading bags {needed}")
    written = cli("record", "static_bench", tmp_path / "b.mcap", "--duration", 0.1)
    assert (written.code, written.err) == (2, f"error: writing bags {needed}")
    assert not (tmp_path / "b.mcap").exists()


@pytest.mark.parametrize(("name", "extra"), [("evo", "score"), ("pillow", "picture"), ("pyarrow", "data")])
def test_doctor_finds_an_old_library(cli, installed, name, extra):
    """The check of an extra is the one of its import: too old is a warning with the command."""
    installed(name, "0.1")
    (check,) = (row for row in cli("doctor", "--json").tree["checks"] if row["name"] == f"extra {extra}")
    assert check["finding"] == "warning"
    assert re.match(rf"without {name}>=[\d.]+ \(found 0\.1\): no ", check["found"])
    assert check["mend"] == f"pip install 'vlp16emu[{extra}]'"


def test_a_library_that_cannot_be_imported_is_missing(monkeypatch):
    """A library whose own dependency is missing names that dependency."""
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with (
        pytest.raises(libraries.MissingExtraError, match=r"a test needs rosbags.rosbag2: pip install"),
        libraries.of_extra("ros", "a test"),
    ):
        import rosbags.rosbag2  # noqa: F401
