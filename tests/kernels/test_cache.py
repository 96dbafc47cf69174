"""Compiled kernels are kept by content."""

import os
import pickle
import shutil
import subprocess
import sys
from types import FunctionType
from typing import NamedTuple

import numba
import pytest
from llvmlite import binding
from numba.core.caching import FunctionCache
from numba.core.registry import cpu_target

from vlp16emu import store
from vlp16emu.kernels import cache, compiler
from vlp16emu.kernels.cache import KernelCache, user_kernels
from vlp16emu.kernels.numba_private import KernelDispatcher


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "base"))
    for name in ("_state", "_content", "_files_of", "_read"):
        monkeypatch.setattr(cache, name, getattr(cache, name).__wrapped__)  # what they read changes in a test
    user_kernels.cache_clear()
    yield user_kernels().usable_folder
    user_kernels.cache_clear()


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of a caster that takes a kernel, two ways, and settings with a table, of a medium that it
    knows nothing of, and of a verb."""
    folder = tmp_path / "package"
    texts = {
        "near/__init__.py": "",
        "near/kernel.py": "from vlp16emu.near import (\n    trig as t,\n)\n\ndef late():\n    from "
        "vlp16emu.settings import x\n",
        "near/trig.py": "x = 1\n",
        "settings.py": "x = 1\n",
        "units.toml": "x = 1\n",
        "far/medium.py": "from vlp16emu.near.kernel import x\n",
        "cli/verb.py": "from vlp16emu.far.medium import x\n",
    }
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.setattr(cache, "PACKAGE", folder)
    return folder


def named(*modules):
    return cache._content(frozenset(f"vlp16emu.{module}" for module in modules))


KEPT = []  # a kernel of no module can be loaded while the one that was compiled is alive
TWO_KERNELS = """@numba.njit(cache=True)
def inner(x):
    if x < 0:
        raise ValueError("below zero")
    return 2 * x
@numba.njit(cache=True)
def outer(x):
    return inner(x) + 1
"""


def twice(x):
    return 2 * x


def kernel(module="vlp16emu.room"):
    """Make a kernel of a module, which is not compiled yet in this process."""
    function = FunctionType(twice.__code__, {}, "twice")
    function.__module__ = module
    KEPT.append(numba.njit(cache=True)(function))
    return KEPT[-1]


def is_compiled_anew():
    """Whether a call of the kernel compiles it."""
    function = kernel()
    assert function(3) == 6
    return bool(sum(function.stats.cache_misses.values()))


def test_time_and_place_change_nothing(package, tmp_path, monkeypatch):
    """Neither a `touch` nor another folder of the same files has kernels of its own: the second
    installation compiles nothing."""
    before = named("near.kernel")
    for path in package.rglob("*.py"):
        os.utime(path, (1.0, 1.0))
    assert named("near.kernel") == before
    monkeypatch.setattr(cache, "PACKAGE", shutil.copytree(package, tmp_path / "second"))
    assert named("near.kernel") == before


@pytest.mark.parametrize(
    ("name", "near", "far"),
    [
        ("near/kernel.py", True, True),
        ("near/trig.py", True, True),
        ("near/__init__.py", True, True),
        ("settings.py", True, True),
        ("units.toml", True, True),
        ("far/medium.py", False, True),
        ("cli/verb.py", False, False),
    ],
)
def test_content_changes_what_is_made_of_it(package, name, near, far):
    """A change of a file renames the kernels of its module and of all that import it, also inside
    functions, and no others."""
    before = named("near.kernel"), named("near.kernel", "far.medium")
    (package / name).write_text("x = 2\n")
    assert (named("near.kernel") != before[0], named("near.kernel", "far.medium") != before[1]) == (near, far)


class Passage(NamedTuple):
    """A type whose module orders its fields."""

    x: int


def test_types_bring_their_modules():
    """The module of a named tuple among the arguments, however deep, decides what a kernel is."""
    kind = numba.typeof((1, (Passage(2), 3.0)))
    assert list(cache._modules((kind, numba.int64))) == [__name__]


@pytest.mark.parametrize("library", ["numba", "llvmlite", "numpy"])
def test_libraries_change_all(monkeypatch, library):
    """Kernels compiled by another version of a library are kept apart."""
    before = cache._state()
    monkeypatch.setattr(f"{library}.__version__", "1.2.3")
    assert cache._state() != before


def test_a_kernel_is_compiled_once(folder):
    """A kernel that one dispatcher compiled is loaded by another one."""
    assert is_compiled_anew()
    assert not is_compiled_anew()
    (file,) = folder.glob("*.kernel")
    assert f"-room.twice-{twice.__code__.co_firstlineno}-" in file.name


def test_other_types_have_files_of_their_own(folder):
    """A kernel is kept for each types of its arguments."""
    assert (kernel()(3), kernel()(1.5)) == (6, 3.0)
    assert len(list(folder.glob("*.kernel"))) == 2


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:], lambda _: b""]
)
def test_a_damaged_file_is_compiled_again(folder, damage):
    """A file with a flipped bit and an empty one are known, and replaced without a word."""
    is_compiled_anew()
    (file,) = folder.glob("*.kernel")
    file.write_bytes(damage(file.read_bytes()))
    assert is_compiled_anew()
    assert not is_compiled_anew()


def test_two_processes_may_fill_one_folder(folder):
    """Two programs at once compile the same kernel, and leave one whole file and no other."""
    program = "from vlp16emu.trig import in_quarter; in_quarter(1.0, 0.5)"
    both = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(2)]
    assert [process.wait() for process in both] == [0, 0]
    files = list(folder.iterdir())
    assert files
    assert all("-trig." in path.name and store.content_of(path.read_bytes(), path.name) for path in files)


class Planted:
    """Makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (os.mkdir, (self.path,))


def test_a_planted_kernel_does_not_run(folder, tmp_path):
    """A kernel in a folder that others can write is not run; the same file in a private folder is."""
    is_compiled_anew()
    (file,) = folder.glob("*.kernel")
    user_kernels().write(file.name, pickle.dumps((Planted(str(tmp_path / "proof")), None)))
    folder.chmod(0o777)
    user_kernels.cache_clear()
    is_compiled_anew()
    assert not (tmp_path / "proof").exists()
    folder.chmod(0o700)
    user_kernels.cache_clear()
    with pytest.raises(TypeError):  # what was planted is no kernel
        is_compiled_anew()
    assert (tmp_path / "proof").exists()


def test_kernels_of_a_wheel_are_read_and_left_as_they_are(folder, monkeypatch, tmp_path):
    """Kernels that lie in the package serve without anything written elsewhere, and a damaged one is
    compiled."""
    is_compiled_anew()
    carried = folder.rename(tmp_path / "carried")
    (file,) = carried.iterdir()
    monkeypatch.setattr(cache, "_PACKAGED", carried)
    shutil.rmtree(tmp_path / "base")
    user_kernels.cache_clear()
    assert not is_compiled_anew()
    assert not (tmp_path / "base").exists()
    file.write_bytes(bytes(100))
    assert is_compiled_anew()
    assert file.read_bytes() == bytes(100)


def test_kernels_of_others_are_left_to_numba():
    """A program that calls us keeps its own kernels as it did."""
    assert isinstance(kernel("their.module")._cache, FunctionCache)
    assert not isinstance(kernel("their.module"), KernelDispatcher)
    assert isinstance(kernel()._cache, KernelCache)


def test_a_kernel_of_another_one_is_no_file_until_it_is_called(folder):
    """A kernel that only another one calls is compiled into that one; called from Python it is compiled
    for itself."""
    module = {"numba": numba, "__name__": "vlp16emu.room"}
    exec(TWO_KERNELS, module)
    inner, outer = module["inner"], module["outer"]
    assert outer(3) == 7
    assert {path.name.split("-")[1] for path in folder.glob("*.kernel")} == {"room.outer"}
    with pytest.raises(ValueError, match="below zero"):
        outer(-1)
    assert inner(3) == 6
    with pytest.raises(ValueError, match="below zero"):
        inner(-1)
    assert {path.name.split("-")[1] for path in folder.glob("*.kernel")} == {"room.outer", "room.inner"}
    assert outer(4.0) == 9.0
    assert outer.overloads.keys() == inner.overloads.keys()


def test_a_kernel_from_a_file_is_compiled_into_another_one(folder):
    """A kernel that was loaded can be called by one that is compiled later, ours or a program's own, and
    from Python as before."""
    for _ in range(2):  # the second time `inner` is loaded
        module = {"numba": numba, "__name__": "vlp16emu.room"}
        exec(TWO_KERNELS, module)
        assert module["inner"](3) == 6
    inner = module["inner"]
    assert sum(inner.stats.cache_hits.values()) == 1
    assert numba.njit(lambda x: inner(x) + 2)(3) == 8
    assert (module["outer"](3), inner(4)) == (7, 8)
    with pytest.raises(ValueError, match="below zero"):
        module["inner"](-1)


def test_a_loaded_kernel_needs_no_compiler():
    """A program that finds its kernels on disk does not load the part of numba that types and lowers
    functions."""
    program = "import sys; from vlp16emu.random import normal; normal(1, 2, 0, 2); print(*sys.modules)"
    runs = [subprocess.check_output([sys.executable, "-c", program], text=True) for _ in range(2)]
    assert ["numba.np.npyimpl" in modules.split() for modules in runs] == [True, False]


INTERRUPTED_LOAD = """
import signal
from numba.core.codegen import JITCodeLibrary
from vlp16emu.random import normal

class Interrupted:
    def __set__(self, library, code):
        pass
    def __get__(self, library, owner):
        del JITCodeLibrary._compiled_object
        signal.raise_signal(signal.SIGINT)

JITCodeLibrary._compiled_object = Interrupted()
try:
    normal(1, 2, 0, 2)
except KeyboardInterrupt:
    print("interrupted", normal(1, 2, 0, 2).shape)
"""


def test_a_signal_while_a_kernel_is_loaded_interrupts():
    """Ctrl-C in LLVM's call for a kernel's code, which cannot propagate it, raises KeyboardInterrupt; the
    kernel can be loaded again."""
    for program in ("from vlp16emu.random import normal; normal(1, 2, 0, 2)", INTERRUPTED_LOAD):
        said = subprocess.check_output([sys.executable, "-c", program], text=True, stderr=subprocess.DEVNULL)
    assert said == "interrupted (2,)\n"


def test_the_target_is_fixed(monkeypatch):
    """Kernels are for a level of the x86-64 psABI that the processor has, for another one where that is
    named."""
    assert cpu_target.target_context.codegen().magic_tuple()[1:] == compiler._target()
    has = dict.fromkeys([feature for needs in compiler._TARGETS.values() for feature in needs], True)
    monkeypatch.setattr(binding, "get_host_cpu_features", lambda: has)
    assert compiler._target() == ("x86-64-v3", "")
    has["fma"] = False
    assert compiler._target() == ("x86-64-v2", "")
    has.clear()
    assert compiler._target() == ("generic", "")
    monkeypatch.setenv("VLP16EMU_TARGET", "x86-64")
    assert compiler._target() == ("x86-64", "")
