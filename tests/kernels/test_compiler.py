"""Kernels that are compiled side by side before a run."""

import inspect
import json
import os
import subprocess
import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest

from vlp16emu.kernels import compiler, numba_private
from vlp16emu.kernels.compiler import _signature, decode_type, table

PROGRAM = """
from pathlib import Path
from vlp16emu.kernels import compiler
compiler._TABLE = Path("table.json")
for group in ("hall", "hall", None):
    print(*compiler.compile_kernels(group))
"""
ROWS = [
    {"kernel": "trig:in_quarter", "types": ["float64", "float64"], "groups": ["hall"]},
    {"kernel": "trig:cos_sin", "types": ["float64"], "groups": ["hall", "forest"]},
    {"kernel": "trig:in_quarter", "types": ["int64", "float64"], "groups": ["forest"]},
    {"kernel": "trig:gone", "types": [], "groups": ["hall"]},
    {"kernel": "trig:cos_sin", "types": ["none"], "groups": ["hall"]},
]


class Pair(NamedTuple):
    """A pair of arrays."""

    first: np.ndarray
    second: int


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("float64", 1.5),
        ("bool", True),
        ("none", None),
        (["array", "float32", 2, "C", False], np.zeros((2, 2), np.float32)),
        (["array", "int64", 1, "A", True], np.broadcast_to(np.arange(4), 4)[::2]),
        (["tuple", "int64", "float64"], (1, 1.5)),
        ([f"{__name__}:Pair", ["array", "uint8", 1, "C", False], "int64"], Pair(np.zeros(1, np.uint8), 1)),
    ],
)
def test_types_are_those_of_values(monkeypatch, text, value):
    """A type that is read is what numba says of a value of that type."""
    monkeypatch.setitem(sys.modules, __name__, sys.modules[Pair.__module__])
    assert repr(decode_type(text)) == repr(numba.typeof(value))


@pytest.mark.parametrize(
    ("group", "cast"), [("hall", "raycast.kernel:cast_lines"), ("forest", "foliage.march:march_lines")]
)
def test_each_group_has_the_kernels_that_cast_and_detect(group, cast):
    """The table is not empty, and has for each group what costs most."""
    assert {cast, "returns.detect:_detect"} <= {row["kernel"] for row in table(group)}


@pytest.mark.parametrize("row", table(), ids=lambda row: row["kernel"])
def test_the_table_is_of_this_program(row):
    """Each row names a kernel and a type for each of its arguments; `tools/kernel_table` renews it."""
    kernel, types = _signature(row)
    assert len(types) == len(inspect.signature(kernel.py_func).parameters)


KILLS = """
import os
from vlp16emu.kernels import compiler
read, parent = compiler._signature, os.getpid()
compiler._signature = lambda row: read(row) if os.getpid() == parent else os.kill(os.getpid(), 9)
"""


def compiled_by_a_program(tmp_path, folder, before=""):
    """What a program of its own prints that compiles the kernels of two groups, and what it complains of."""
    (tmp_path / "table.json").write_text(json.dumps(ROWS))
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    command = [sys.executable, "-c", before + PROGRAM]
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True)
    return done.stdout.splitlines(), done.stderr


def test_what_lacks_is_compiled_once(tmp_path):
    """Other processes compile the kernels of a group that are neither there nor gone; one that cannot be
    is tried once."""
    printed = compiled_by_a_program(tmp_path, tmp_path / "kernels")
    assert printed == (["(0, 3) (3, 3)", "", "(0, 1) (1, 1)"], "")
    assert len([*tmp_path.rglob("*.kernel")]) == 4


def test_without_a_safe_folder_nothing_is_compiled_before(tmp_path):
    """What other processes compile must be kept: where that cannot be, the run compiles for itself."""
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    assert compiled_by_a_program(tmp_path, tmp_path / "open")[0] == ["(0, 3)", "(0, 3)", "(0, 4)"]


def test_processes_that_are_killed_are_not_waited_for(tmp_path):
    """The system kills a process that has no memory left: the run goes on without it."""
    assert compiled_by_a_program(tmp_path, tmp_path / "kernels", KILLS) == (
        ["(0, 3)", "(0, 3)", "(0, 4)"],
        "",
    )


PLAIN = """
import numpy as np
from vlp16emu.kernels import compiler
from vlp16emu.random import uniform, uniform_pair
from vlp16emu.elementary import cos
print(compiler.is_plain(), type(uniform_pair).__name__)
print(uniform(7, 1, 0, 5).tobytes().hex(), np.asarray(cos(np.linspace(-9.0, 9.0, 7))).tobytes().hex())
"""


def test_without_private_interfaces_the_numbers_are_the_same(tmp_path, capsys):
    """A numba whose private interfaces are unknown compiles kernels in its own way, with the same bits."""
    environment = os.environ | {"VLP16EMU_NUMBA": "plain", "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", PLAIN]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)
    plain = done.stdout.splitlines()
    exec(PLAIN, {})
    usual = capsys.readouterr().out.splitlines()
    assert plain[0] == "True CPUDispatcher"
    assert usual[0] == "False KernelDispatcher"
    assert plain[1] == usual[1]


def test_known_interfaces_are_checked_by_a_kernel(monkeypatch):
    """With a newer numba a kernel is compiled through all interfaces; if it fails, kernels are compiled in
    numba's way."""
    monkeypatch.delenv("VLP16EMU_NUMBA", raising=False)
    numba_private.check_interfaces()
    monkeypatch.setattr(compiler, "_KNOWN", (0, 1))
    assert not compiler.is_plain.__wrapped__()
    monkeypatch.setattr(numba_private, "kernel_bytes", lambda _result: 1 / 0)
    assert compiler.is_plain.__wrapped__()
