"""Compiled kernels are kept by content."""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from types import FunctionType
from typing import NamedTuple

import numba
import pytest

from vlp16emu import store
from vlp16emu.kernels.cache import (
    KernelCache,
    library_versions,
    modules_of,
    source_digest,
    state_digest,
    user_kernels,
)
from vlp16emu.kernels.compiler import target_for


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "base"))
    user_kernels.cache_clear()
    yield user_kernels().usable_folder
    user_kernels.cache_clear()


@pytest.fixture
def package(tmp_path):
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
    return folder


def digest(package, *modules):
    """Part of the names of the kernels of a package's modules that stands for their sources."""
    return source_digest(frozenset(f"vlp16emu.{module}" for module in modules), package)


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


def kernel(module="vlp16emu.room", packaged=None):
    """Make a kernel of a module, which is not compiled yet in this process; a package may carry it."""
    function = FunctionType(twice.__code__, {}, "twice")
    function.__module__ = module
    KEPT.append(numba.njit(cache=True)(function))
    if packaged is not None:
        KEPT[-1].kept = KernelCache(function, packaged)
    return KEPT[-1]


def is_compiled_anew(packaged=None):
    """Whether a call of the kernel compiles it."""
    function = kernel(packaged=packaged)
    assert function(3) == 6
    return bool(sum(function.stats.cache_misses.values()))


def test_time_and_place_change_nothing(package, tmp_path):
    """Neither a `touch` nor another folder of the same files has kernels of its own: the second
    installation compiles nothing."""
    second = Path(shutil.copytree(package, tmp_path / "second"))
    for path in second.rglob("*.py"):
        os.utime(path, (1.0, 1.0))
    assert digest(second, "near.kernel") == digest(package, "near.kernel")


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
def test_content_changes_what_is_made_of_it(package, tmp_path, name, near, far):
    """A change of a file renames the kernels of its module and of all that import it, also inside
    functions, and no others."""
    changed = Path(shutil.copytree(package, tmp_path / "changed"))
    (changed / name).write_text("x = 2\n")
    near_modules = ("near.kernel",)
    far_modules = ("near.kernel", "far.medium")
    assert (digest(changed, *near_modules) != digest(package, *near_modules)) == near
    assert (digest(changed, *far_modules) != digest(package, *far_modules)) == far


class Passage(NamedTuple):
    """A type whose module orders its fields."""

    x: int


def test_types_bring_their_modules():
    """The module of a named tuple among the arguments, however deep, decides what a kernel is."""
    kind = numba.typeof((1, (Passage(2), 3.0)))
    assert list(modules_of((kind, numba.int64))) == [__name__]


@pytest.mark.parametrize("library", ["numba", "llvmlite", "numpy", "python"])
def test_libraries_change_all(folder, library):
    """Kernels compiled by another version of a library are kept apart; a file's name begins with them."""
    versions = library_versions()
    other = {**versions, library: "1.2.3"}
    assert versions[library] != "1.2.3"
    assert state_digest(other) != state_digest(versions)
    is_compiled_anew()
    (file,) = folder.glob("*.kernel")
    assert file.name.startswith(f"{state_digest(versions)}-")


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


def test_kernels_of_a_wheel_are_read_and_left_as_they_are(folder, tmp_path):
    """Kernels that lie in the package serve without anything written elsewhere, and a damaged one is
    compiled."""
    is_compiled_anew()
    carried = folder.rename(tmp_path / "carried")
    (file,) = carried.iterdir()
    shutil.rmtree(tmp_path / "base")
    user_kernels.cache_clear()
    assert not is_compiled_anew(carried)
    assert not (tmp_path / "base").exists()
    file.write_bytes(bytes(100))
    assert is_compiled_anew(carried)
    assert file.read_bytes() == bytes(100)


def test_kernels_of_others_are_left_to_numba(folder):
    """A program that calls us keeps its own kernels where numba does; ours lie in our folder."""
    assert Path(kernel().stats.cache_path) == folder
    theirs = Path(kernel("their.module").stats.cache_path)
    assert folder not in (theirs, *theirs.parents)


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


PSABI = {  # features of the levels of the x86-64 psABI beyond those below, in LLVM's names
    "x86-64-v2": {"cx16", "sahf", "popcnt", "sse3", "ssse3", "sse4.1", "sse4.2"},
    "x86-64-v3": {"avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"},
}


def test_kernels_are_for_a_level_that_the_processor_has():
    """The target is the highest level of the x86-64 psABI all of whose features are there, else generic."""
    third = dict.fromkeys(PSABI["x86-64-v2"] | PSABI["x86-64-v3"], True)
    assert target_for(third) == "x86-64-v3"
    assert target_for({**third, "fma": False}) == "x86-64-v2"
    assert target_for(dict.fromkeys(PSABI["x86-64-v2"], True)) == "x86-64-v2"
    assert target_for({**third, "ssse3": False, "fma": False}) == "generic"
    assert target_for({}) == "generic"


@pytest.mark.parametrize("chosen", ["x86-64", ""])
def test_the_target_is_that_of_the_environment(chosen):
    """Numba compiles for the level of `VLP16EMU_TARGET`, without it for that of the processor."""
    program = """
import vlp16emu.kernels.compiler as compiler
from llvmlite import binding
from numba.core.registry import cpu_target
host = compiler.target_for(binding.get_host_cpu_features())
print(*cpu_target.target_context.codegen().magic_tuple()[1:], host)
"""
    environment = {**os.environ, "VLP16EMU_TARGET": chosen}
    found = subprocess.check_output([sys.executable, "-c", program], text=True, env=environment).split()
    assert found[0] == (chosen or found[-1])
