"""Numbers that are none: in keys of scenes, options and arguments in Python; tests of readers have those in files."""

import io
import math
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from stability_cases.row import Row, refused
from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.scenario import Scenario, load, schema

_VALUES = (math.nan, math.inf, -math.inf)
_WORDS = ("nan", "inf", "-inf")
_MAY_BE_INFINITE = "near_m"
"""The only key that takes infinity."""
_OPTIONS = (
    "record static_bench OUT --start",
    "record static_bench OUT --duration",
    "record static_bench OUT --threads",
    "record static_bench OUT --truth OUT --truth-rate",
    "stream static_bench --duration",
    "stream static_bench --start",
    "stream static_bench --speed",
    "stream static_bench --data-port",
    "stream static_bench --position-port",
    "points static_bench OUT.npz --start",
    "points static_bench OUT.npz --duration",
    "points static_bench OUT.npz --unit",
    "decode OUT --unit",
    "forest static_bench --radius",
)


def turned_down(*arguments: str) -> str:
    """Line with which the command line turns something down; empty where it does not, with one line and exit code 2."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run(arguments)
    line = err.getvalue().strip()
    return line if code == 2 and line.startswith("error: ") and "\n" not in line and not out.getvalue() else ""


def _resolved(node: Any) -> Any:
    return schema()["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node


def _trees(node: Any, value: float) -> Iterator[tuple[str, Any]]:
    """Path of each number below a node of the schema, and the smallest tree with a value there."""
    node = _resolved(node)
    if "anyOf" in node:
        for choice in node["anyOf"]:
            yield from _trees(choice, value)
    elif "discriminator" in node:
        name = node["discriminator"]["propertyName"]
        for tag, reference in node["discriminator"]["mapping"].items():
            for path, tree in _trees({"$ref": reference}, value):
                yield path, {name: tag} | tree
    elif node.get("type") == "object":
        for key, child in node.get("properties", {}).items():
            for path, tree in _trees(child, value):
                yield f".{key}{path}", {key: tree}
    elif node.get("type") == "array":
        places = node.get("prefixItems") or [node["items"]]
        for place, child in enumerate(places):
            for path, tree in _trees(child, value):
                others = [1.0] * (len(places) - 1)
                yield f"[{place}]{path}", [*others[:place], tree, *others[place:]]
    elif node.get("type") in ("number", "integer"):
        yield "", value


def _is_found(tree: Any) -> bool:
    """Whether the check of a scene finds the number that is none in a tree."""
    try:
        Scenario.model_validate(tree)
    except ValidationError as error:
        inputs = (finding["input"] for finding in error.errors(include_url=False))
        return any(isinstance(value, float) and not math.isfinite(value) for value in inputs)
    return False


def _is_meant(path: str, value: float) -> bool:
    return path.endswith(_MAY_BE_INFINITE) and value == math.inf


def every_key() -> Iterator[Row]:
    """All keys of the schema that take a number, each in a scene with nothing else in it."""
    tried = [
        (path.lstrip("."), tree)
        for value in _VALUES
        for path, tree in _trees(schema(), value)
        if not _is_meant(path, value)
    ]
    missed = [path for path, tree in tried if not _is_found(tree)]
    line = f"{missed[0]} took it" if missed else "found nan, inf or -inf in each"
    name = f"NaN and infinity in {len({path for path, _ in tried})} keys of scenes"
    yield Row(name, "not refused", len(missed), 0, line)


def options() -> Iterator[Row]:
    """Numbers of the command line."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [
            turned_down(*option.replace("OUT", f"{folder}/out").split(), word) for option in _OPTIONS for word in _WORDS
        ]
        left = len(list(Path(folder).iterdir()))
    yield Row(f"NaN or infinity in {len(lines)} command lines", "not refused", lines.count(""), 0, lines[-1])
    yield Row("command lines that were refused", "files they left", left, 0)


def python() -> Iterator[Row]:
    """Spans that are handed to the emulator itself."""
    emulator = Emulator(load("static_bench"))
    spans_s = {"from NaN": (math.nan, 1.0), "to NaN": (0.0, math.nan), "to infinity": (0.0, math.inf)}
    for name, span_s in spans_s.items():
        yield refused(f"span of packets {name}", partial(emulator.packets, *span_s), "a finite number")
