"""What decides a byte is computed by sums, products, quotients and square roots alone: they round alike on
every processor."""

import ast
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vlp16emu.engine import Engine
from vlp16emu.motion.gnss import Receiver
from vlp16emu.scenario import load

PACKAGE = Path(__file__).resolve().parents[1] / "vlp16emu"

ROOMS = (
    *("extras/clouds/scan.py", "extras/imu", "extras/live", "extras/meshes", "extras/splines.py"),
    *("extras/walk", "engine", "foliage", "forest", "motion", "packets", "raycast", "returns"),
    *("run/stream.py", "sensor", "world"),
    *("elementary.py", "random.py", "trig.py", "types.py", "units.py"),
)
"""Folders and files on the way from a scene to its packets."""

ALLOWED = {
    "forest/stand/tree_models.py": "scipy",  # which corners are joined; lengths of hulls are for reports
    "forest/stand/given_stand.py": "scipy",  # finds trees at one place, to refuse them
    "forest/ground/dem.py": "scipy",  # the nearest cell, by squares of whole numbers
    "forest/stand/inventory.py": "scipy",  # which corners span a crown
    "forest/stand/twin.py": "**",  # colours for other programs
    "extras/walk/pack.py": "**",  # powers of a whole number
}
"""What decides no byte, by file."""

_ELEMENTARY = "sin cos tan sinh cosh tanh exp exp2 expm1 log log2 log10 log1p hypot cbrt"
MATH = frozenset(
    f"{_ELEMENTARY} asin acos atan atan2 asinh acosh atanh pow dist erf erfc gamma lgamma sumprod".split()
)
NUMPY = frozenset(
    f"{_ELEMENTARY} arcsin arccos arctan arctan2 arcsinh arccosh arctanh power float_power logaddexp "
    "sinc geomspace"
    " logspace dot vdot vecdot matvec vecmat inner matmul einsum tensordot convolve correlate cov "
    "corrcoef polyfit"
    " linalg fft".split()
)
"""What libraries compute by one of several variants; `linalg` and `fft` with all that they have."""
DRAWS = frozenset(
    [
        "binomial",
        "chisquare",
        "dirichlet",
        "exponential",
        "geometric",
        "gumbel",
        "laplace",
        "logistic",
        "lognormal",
        "logseries",
        "multinomial",
        "multivariate_normal",
        "negative_binomial",
        "pareto",
        "standard_cauchy",
        "standard_gamma",
        "standard_t",
        "triangular",
        "vonmises",
        "wald",
        "weibull",
        "zipf",
    ]
)
"""Numbers that numpy draws by functions of libm, and `vlp16emu.random.generator` not by its own."""
LIBRARIES = ("scipy", "pymap3d", "cmath", "statistics", "numpy.linalg", "numpy.fft")


def not_ieee(tree: ast.AST) -> Iterator[str]:
    """Yield what is called, imported or written in a module that processors do not all compute alike."""
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        match node:
            case ast.Attribute(value=ast.Name(id="math"), attr=name) if name in MATH:
                yield f"line {line}: math.{name}"
            case ast.Attribute(value=ast.Name(id="np"), attr=name) if name in NUMPY:
                yield f"line {line}: np.{name}"
            case ast.keyword(arg="fastmath", value=value) if not (
                isinstance(value, ast.Constant) and value.value is False
            ):
                yield f"line {value.lineno}: fastmath"
            case ast.Attribute(attr=name) if name in DRAWS:
                yield f"line {line}: .{name}"
            case ast.Call(func=ast.Attribute(attr="argsort"), keywords=words) if not _is_stable(words):
                yield f"line {line}: an order of ties by chance"
            case ast.Attribute(attr="dot"):
                yield f"line {line}: .dot"
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                yield f"line {line}: @"
            case ast.BinOp(left=base, op=ast.Pow()) if not isinstance(base, ast.Constant):
                yield f"line {line}: ** of what is no literal"
            case ast.AugAssign(op=ast.Pow()):
                yield f"line {line}: **="
            case ast.Import(names=names):
                yield from (f"line {line}: {name.name}" for name in names if name.name.startswith(LIBRARIES))
            case ast.ImportFrom(module=module) if f"{module}".startswith(LIBRARIES) or module in (
                "math",
                "numpy",
            ):
                yield f"line {line}: from {module}"


def _is_stable(words: list[ast.keyword]) -> bool:
    """Whether a sort is asked to be stable: processors sort ties in different ways."""
    return any(word.arg == "kind" and ast.unparse(word.value) == "'stable'" for word in words)


def files() -> list[Path]:
    """List the files of the rooms."""
    found = []
    for room in ROOMS:
        path = PACKAGE / room
        assert path.exists(), room
        found += [path] if path.is_file() else sorted(path.rglob("*.py"))
    return found


def test_no_library_decides_a_byte() -> None:
    """No file on the way to a packet calls an elementary function of a library, BLAS or LAPACK, or raises
    to a power."""
    for path in files():
        allowed = ALLOWED.get(str(path.relative_to(PACKAGE)), "\n")
        found = not_ieee(ast.parse(path.read_text(encoding="utf-8")))
        assert [finding for finding in found if allowed not in finding] == [], path


def test_the_scan_finds() -> None:
    """Each kind of forbidden call, operator and import is found."""
    calls = (
        "math.sin(x)",
        "np.exp(x)",
        "np.linalg.norm(x)",
        "a @ b",
        "a.dot(b)",
        "x**2",
        "np.argsort(x)",
        "rng.wald(1)",
    )
    lines = (
        "a @= b",
        "x **= 0.5",
        "from scipy.interpolate import CubicSpline",
        "import pymap3d",
        "from math import exp",
    )
    for line in (*(f"y = {call}" for call in calls), *lines, "f = numba.njit(fastmath={'contract'})(f)"):
        assert len(list(not_ieee(ast.parse(line)))) == 1, line


WALK = {
    "schema": 1,
    "title": "A walk in a hall, with all that moves and disturbs",
    "seed": 3,
    "duration_s": 10.0,
    "sensor": {"return_mode": "dual"},
    "motion": {
        "kind": "walk",
        "way_points_m": [[0, 0], [3, 4], [6, 3], [7, -2], [0, 0]],
        "harness": {},
        "mount": {"pitch_deg": 50.0, "spin_hz": 0.5, "lever_arm_m": [0.1, 0.2, 0.3]},
    },
    "weather": {"visibility_m": 200.0, "rain_mm_h": 20.0},
    "noise": {"warm_up_m": 0.05},
    "imu": {},
    "world": {"kind": "hall", "length_m": 60.0, "width_m": 60.0, "height_m": 10.0},
}


def _walked() -> tuple[bytes, tuple[float, float]]:
    """Walk for a tenth of a second: all packets, and a place on earth."""
    chain = Engine.of(load(WALK), threads=1)
    sent = b"".join(packet.payload for packet in chain.packets(2.0, 2.1))
    receiver = Receiver(
        chain.parts.units[0].motion, chain.scenario.gps, seed=1, sky=lambda _t_ns, _place_m: 0.6
    )
    fix = receiver.fix(chain.scenario.start_ns // 10**9 * 10**9)
    assert chain.parts.imu is not None
    chain.parts.imu.read(0, 10)
    return sent, (fix.latitude_deg, fix.course_deg)


def _guarded(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> None:
    """Let a function of a library raise where it is called from a file of the rooms."""
    true = getattr(owner, name, None)
    if not callable(true):
        return
    called_from = tuple(str(PACKAGE / room) for room in ROOMS)

    def guard(*arguments: Any, **options: Any) -> Any:
        file = sys._getframe(1).f_code.co_filename
        assert not file.startswith(called_from), f"{file} calls {name}"
        return true(*arguments, **options)

    monkeypatch.setattr(owner, name, guard)


def test_a_walk_calls_no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Packets, fixes and inertial readings of a walk come out the same where all those functions raise."""
    expected = _walked()
    for name in MATH:
        _guarded(monkeypatch, math, name)
    for owner, names in ((np, NUMPY), (np.linalg, dir(np.linalg))):
        for name in names:
            if not name.startswith("_"):
                _guarded(monkeypatch, owner, name)
    assert _walked() == expected
