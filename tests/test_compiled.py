"""Where compiled kernels are kept."""

import os
import time
from pathlib import Path

import pytest

from vlp16emu import compiled
from vlp16emu.compiled import keep_compiled


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of a kernel in one file that calls one in another, with no folder chosen."""
    folder = tmp_path / "package"
    (folder / "room").mkdir(parents=True)
    for name in ("__init__.py", "room/caller.py", "room/callee.py"):
        (folder / name).write_text("x = 1\n")
    monkeypatch.setattr(compiled, "_PACKAGE", str(folder))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setitem(compiled.sys.modules, "numba", __import__("types").SimpleNamespace(config=os))
    monkeypatch.setattr(os, "CACHE_DIR", "", raising=False)
    return folder


def kept():
    """Folder that is chosen now."""
    keep_compiled()
    assert os.environ["NUMBA_CACHE_DIR"] == os.CACHE_DIR
    return Path(os.CACHE_DIR)


def test_a_change_of_any_file_has_a_folder_of_its_own(package):
    """Kernels are compiled anew when a file changes whose kernels they call, and only then."""
    before = kept()
    assert before.parent == package / "__pycache__"
    assert kept() == before
    (package / "room" / "callee.py").write_text("x = 2 + 2\n")
    assert kept() != before


def test_what_cannot_be_written_is_passed_over(package, monkeypatch, tmp_path):
    """A package that may not be written is followed by the user's cache, that by a folder for temporary files."""
    closed = {str(package)}
    access = os.access
    monkeypatch.setattr(
        os, "access", lambda p, mode: not any(str(p).startswith(c) for c in closed) and access(p, mode)
    )
    assert kept().parent == tmp_path / "cache" / "vlp16emu"
    closed.add(str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert kept().parent == tmp_path / "temporary" / f"vlp16emu-{os.getuid()}"


def test_a_chosen_folder_comes_first(package, monkeypatch, tmp_path):
    """NUMBA_CACHE_DIR is used, by programs that are called from here too."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert kept().parent == tmp_path / "mine"
    assert kept().parent == tmp_path / "mine"


def test_the_folder_of_somebody_else_is_not_trusted(package, monkeypatch):
    """What was compiled is code: a folder that belongs to another user is not read from."""
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)
    keep_compiled()
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_folders_of_other_states_go_after_a_day(package):
    """What was not used for a day is removed, what was used today is kept."""
    old, today = (package / "__pycache__" / f"kernels-{name}" for name in ("old", "today"))
    for folder in (old, today):
        folder.mkdir(parents=True)
        (folder / "kernel.nbc").touch()
    os.utime(old, (time.time() - 100_000,) * 2)
    kept()
    assert not old.exists()
    assert today.exists()
