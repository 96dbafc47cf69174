"""What is kept on disk, shown and cleared."""

import numpy as np
import pytest

from vlp16emu.kernels.cache import user_kernels
from vlp16emu.store import user_store


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """A store of one bundle, and a folder of a kernel and one not written to its end; with foreign files
    in them."""
    world, kernels = tmp_path / "world", tmp_path / "vlp16emu-kernels"
    monkeypatch.setenv("VLP16EMU_CACHE_DIR", str(world))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    user_store.cache_clear()
    user_store().keep("a.world", np.zeros(10))
    user_store().flush()
    user_kernels.cache_clear()
    for name in ("one.kernel", "two.kernel.7.part"):
        user_kernels().write(name, bytes(36))
    (kernels / "room.kernel").write_text("mine")
    (world / "notes.txt").write_text("mine")
    yield world, kernels
    user_store.cache_clear()
    user_kernels.cache_clear()


def test_what_is_kept_is_counted(cli, folders):
    """Files and bytes of worlds and kernels, as JSON and as lines."""
    tree = cli("cache", "--json").tree
    assert tree["cleared"] is False
    assert tree["worlds"]["files"] == 1
    assert tree["worlds"]["folder"] == str(folders[0])
    assert tree["worlds"]["most_bytes"] == 1_000_000_000
    assert tree["kernels"] == {"folder": str(folders[1]), "files": 2, "bytes": 200, "most_bytes": 200_000_000}
    kept = f"1 files, {tree['worlds']['bytes'] / 1e3:.1f} kB of at most 1000.0 MB"
    assert kept in cli("cache").out


def test_clearing_leaves_what_is_not_ours(cli, folders, tmp_path):
    """Our own files go, foreign ones stay."""
    tree = cli("cache", "--clear", "--json").tree
    assert (tree["cleared"], tree["worlds"]["files"], tree["kernels"]["files"]) == (True, 1, 2)
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert left == ["vlp16emu-kernels/room.kernel", "world/notes.txt"]
    assert cli("cache", "--json").tree["worlds"]["files"] == 0


def test_no_folder_is_said(cli, monkeypatch):
    """Where nothing is kept the verb says so."""
    monkeypatch.setenv("VLP16EMU_CACHE_DIR", "off")
    user_store.cache_clear()
    assert "nothing is kept" in cli("cache").out


def test_kernels_are_compiled_before_they_are_needed(cli, monkeypatch):
    """`--compile` compiles all that the table of kernels has, on request alone, and does not go with
    `--clear`."""
    groups = []
    monkeypatch.setattr("vlp16emu.cli.about.compile_first", groups.append)
    cli("cache")
    assert groups == []
    cli("cache", "--compile")
    assert groups == [None]
    assert cli("cache", "--compile", "--clear").code == 2
    assert groups == [None]
