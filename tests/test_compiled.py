"""Where compiled kernels are kept."""

import os
import pickle
import subprocess
import sys
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


@pytest.mark.parametrize("mode", [0o770, 0o707])
@pytest.mark.parametrize("level", ["base", "folder"])
def test_where_others_can_write_nothing_is_kept(package, monkeypatch, tmp_path, level, mode):
    """What was compiled is code: neither the folder nor the one that it is in may be writable for others."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "open"))
    open_folder = kept()
    (open_folder if level == "folder" else open_folder.parent).chmod(mode)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "open"))
    assert kept().parent == package / "__pycache__"


def test_a_link_is_not_followed(package, monkeypatch, tmp_path):
    """A folder that is a symbolic link, to wherever, is passed over."""
    (tmp_path / "there").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "there")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "link"))
    assert kept().parent == package / "__pycache__"


def test_without_a_folder_of_our_own_one_is_made_for_the_run(package, monkeypatch):
    """Where all folders belong to somebody else kernels go to a new private one, and it goes with the program."""
    ends = []
    monkeypatch.setattr("atexit.register", ends.append)
    monkeypatch.setattr(compiled, "_bases", list)
    folder = kept()
    assert folder.stat().st_mode & 0o777 == folder.parent.stat().st_mode & 0o777 == 0o700
    (end,) = ends
    end()
    assert not folder.parent.exists()


def test_a_planted_kernel_does_not_run(tmp_path):
    """Where others can write, a compiled kernel that was put there is not run; it would be where nobody else can."""
    base, proof = tmp_path / "base", tmp_path / "proof"
    runs_a_kernel = "from vlp16emu.trig import in_quarter; in_quarter(1.0, 0.5)"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(base)}

    def run():
        subprocess.run([sys.executable, "-c", runs_a_kernel], env=environment, check=True)
        return proof.exists()

    assert not run()
    indexes = list(base.glob("kernels-*/*/*.nbi"))
    for index in indexes:
        index.write_bytes(pickle.dumps(_Planted(str(proof))))
    assert indexes
    base.chmod(0o777)
    assert not run()
    base.chmod(0o700)
    assert run()


class _Planted:
    """Creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (self.path, "w"))


def test_folders_of_other_states_go_after_a_day(package):
    """What was not used for a day is removed; what was used today is kept, and what has such a name and is not ours."""
    package.chmod(0o755)
    old, today, foreign = (package / "__pycache__" / f"kernels-{digit * 16}" for digit in "012")
    for folder in (old, today, foreign):
        (folder / "room").mkdir(parents=True)
        (folder / "room" / "kernel.nbc").touch()
    for folder in (old, today):
        (folder / "made-by-vlp16emu").touch()
    for folder in (old, foreign):
        os.utime(folder, (time.time() - 100_000,) * 2)
    kept()
    assert not old.exists()
    assert today.exists()
    assert foreign.exists()
