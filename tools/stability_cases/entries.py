"""NaN and infinity in every key of a scene, options and spans, and settings at random."""

import io
import math
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from stability_cases.case import Row, case, refusal
from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.packets import data_fields
from vlp16emu.scenario import Scenario, load
from vlp16emu.scenario.model import schema
from vlp16emu.types import PacketKind, Semantic

_VALUES = (math.nan, math.inf, -math.inf)
_WORDS = ("nan", "inf", "-inf")
_MAY_BE_INFINITE = "near_m"  # the only key that takes infinity
_OPTIONS = (
    "record static_bench OUT --start",
    "record static_bench OUT --duration",
    "record static_bench OUT --threads",
    "record static_bench OUT --truth OUT --truth-rate",
    "stream static_bench --duration",
    "stream static_bench --start",
    "stream static_bench --speed",
    "stream static_bench --data-port",
    "points static_bench OUT.npz --start",
    "points static_bench OUT.npz --duration",
    "points static_bench OUT.npz --unit",
    "decode OUT --unit",
    "forest static_bench --radius",
)
_REACH_M = 131.07


def _error_line(*words: str) -> str:
    """Return the line with which the command line refuses its words; empty if not with exit code 2."""
    out = io.StringIO()
    err = io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run(words)
    line = err.getvalue().strip()
    is_one = code == 2 and line.startswith("error: ") and "\n" not in line and not out.getvalue()
    return line if is_one else ""


def _resolve(node: Any) -> Any:
    return schema()["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node


def _trees(node: Any, value: float) -> Iterator[tuple[str, Any]]:
    """Yield the path of each number below a node of the schema, and the smallest tree with a value there."""
    node = _resolve(node)
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
    """Return True if the check of a scene finds the NaN or infinity in a tree."""
    try:
        Scenario.model_validate(tree)
    except ValidationError as error:
        inputs = (finding["input"] for finding in error.errors(include_url=False))
        return any(isinstance(value, float) and not math.isfinite(value) for value in inputs)
    return False


@case("refusal")
def numbers_that_are_none() -> Iterator[Row]:
    """NaN and infinity in every key of a scene that takes a number, and in spans in Python."""
    tried = [
        (path, tree)
        for value in _VALUES
        for path, tree in _trees(schema(), value)
        if not (path.endswith(_MAY_BE_INFINITE) and value == math.inf)
    ]
    missed = sum(not _is_found(tree) for _, tree in tried)
    keys = len({path for path, _ in tried})
    yield Row(f"keys that take it, of {keys}", missed, 0, "found nan, inf or -inf in each")
    emulator = Emulator(load("static_bench"))
    for span_s in ((math.nan, 1.0), (0.0, math.nan), (0.0, math.inf)):
        name = f"a span from {span_s[0]:g} to {span_s[1]:g} s"
        yield refusal(name, partial(emulator.packets, *span_s), "a finite number")


@case("refusal")
def options_that_are_none() -> Iterator[Row]:
    """NaN and infinity in options of the command line, which must leave no file."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [
            _error_line(*option.replace("OUT", f"{folder}/out").split(), word)
            for option in _OPTIONS
            for word in _WORDS  # in each place
        ]
        left = len(list(Path(folder).iterdir()))
    yield Row(f"command lines that take it, of {len(lines)}", lines.count(""), 0, lines[-1])
    yield Row("files left", left, 0)


_SECTIONS = "sensor", "beam", "detector", "noise", "weather"


def _limits(node: Any) -> tuple[float, float] | None:
    """Return the least and the greatest value of a number, None for anything else."""
    if "anyOf" in node:
        node = next((choice for choice in node["anyOf"] if choice.get("type") in ("number", "integer")), {})
    low = node.get("minimum", node.get("exclusiveMinimum"))
    high = node.get("maximum", node.get("exclusiveMaximum"))
    if node.get("type") not in ("number", "integer") or low is None or high is None:
        return None
    return float(low), float(high)


def _draw(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number at one of its ends, close to it, or in between, uniform or by decades."""
    span = high - low
    kind = rng.integers(5)
    inside = low + span * float([0.0, 1e-9, rng.uniform(), 10 ** rng.uniform(-9, 0), 1.0][kind])
    return min(max(inside, low), high)


def _random_settings(rng: np.random.Generator) -> dict[str, object]:
    settings = dict[str, object]()
    for section in _SECTIONS:
        for key, node in schema()["$defs"][section.capitalize()]["properties"].items():
            limits = _limits(node)
            if limits is None or key.endswith("port") or key == "seed" or rng.uniform() < 0.5:
                continue
            value = _draw(rng, *limits)
            if key == "rpm":
                settings[f"{section}.{key}"] = 60 * round(value / 60)
            elif key == "rays":
                settings[f"{section}.{key}"] = min(int(value), 64)
            else:
                settings[f"{section}.{key}"] = value
    settings["sensor.return_mode"] = ["strongest", "last", "dual"][rng.integers(3)]
    settings["beam.model"] = ["adaptive", "fixed", "none", "angle", "offset"][rng.integers(5)]
    settings["seed"] = int(rng.integers(2**31))
    for axis in ("yaw_deg", "pitch_deg", "roll_deg"):
        angles = [-180.0, -90.0, 0.0, 90.0, 180.0, rng.uniform(-180, 180)]
        settings[f"motion.{axis}"] = float(rng.choice(angles))
    return settings


def _random_scenes(count: int) -> Iterator[Row]:
    rng = np.random.default_rng(8)
    ran = keys = 0
    # Three in four draws are refused: ends that a key excludes, keys that exclude others.
    for _ in range(20 * count):
        if ran == count:
            break
        settings = _random_settings(rng)
        try:
            scenario = load("static_bench", settings)
        except Exception as error:  # noqa: BLE001  # any other than a refusal fails the row below
            is_other = type(error).__name__ != "ScenarioError"
            yield Row("scenes that end otherwise than by a refusal", int(is_other), 0)
            continue
        ran += 1
        keys = max(keys, len(settings))
        emulator = Emulator(scenario, threads=1)
        packets = [p for p in emulator.packets(0.0, 0.003) if p.kind is PacketKind.DATA]
        payloads = np.frombuffer(b"".join(p.payload for p in packets), np.uint8).reshape(len(packets), -1)
        fields = data_fields(payloads)
        codes = fields["blocks"]["records"]["distance_lsb"]
        yield Row("codes nearer than 0.5 m", int(np.count_nonzero((codes > 0) & (codes < 250))), 0)
        beyond = fields["blocks"]["azimuth_cdeg"] > 35_999
        yield Row("azimuths beyond 35999", int(np.count_nonzero(beyond)), 0)
        yield Row("stamps beyond the hour", int(np.count_nonzero(fields["timestamp_us"] >= 3_600_000_000)), 0)
        for returns in emulator.returns(0.0, 0.001, truth=True):
            yield from _limits_of(returns)
    yield Row(f"scenes that did not run, of {count} with up to {keys} keys", count - ran, 0)


def _limits_of(returns: Any) -> Iterator[Row]:
    """Rows of values that no return may have."""
    far_m = returns.distance_m
    sound = np.isfinite(far_m) & (far_m >= 0) & (far_m <= _REACH_M + 0.2)
    yield Row("distances that are NaN, negative or too far", int((~sound).sum()), 0)
    seen = returns.surface[(returns.surface < len(returns.surfaces)) & (returns.distance_m > 0)]
    semantic = returns.surfaces["semantic"][seen]
    yield Row("labels of no class", int((semantic > max(Semantic)).sum()), 0)
    unit = np.abs(np.linalg.norm(returns.firings.direction, axis=-1) - 1).max()
    yield Row("length of directions, less one", float(unit), 1e-14)


@case("limits of the protocol")
def random_scenes() -> Iterator[Row]:
    """Five scenes with about half of all keys of sensor, light and detector at random, many at their ends."""
    yield from _random_scenes(5)


@case("limits of the protocol", is_slow=True)
def many_random_scenes() -> Iterator[Row]:
    """Two hundred scenes with half of the keys of sensor, light and detector at random, or at their ends."""
    yield from _random_scenes(200)
