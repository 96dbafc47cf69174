"""TOML or JSON to `Scenario`, with errors that name file, key path, what was found and what was expected."""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from vlp16emu.errors import ScenarioError
from vlp16emu.motion import Walk
from vlp16emu.scenario.explain import explain
from vlp16emu.scenario.find import find
from vlp16emu.scenario.model import Scenario

__all__ = ["load"]

_RIVALS = frozenset(Walk.one_of), Walk.either_or
"""Keys of which a scene has one, so that a setting takes the place of the one that the scene has."""
_UNIT_ERRORS = ("eccentricity_deg", "azimuth_noise_deg", "clock_error_ppm")
"""Errors among the keys of `[sensor]` and `[[rig]]`."""


def load(scene: str, settings: Sequence[str] = (), *, ideal: bool = False) -> Scenario:
    """Read a scene and apply settings to it.

    Parameters
    ----------
    scene : name or path; a path that ends in .json is read as the truth beside a run gives it
    settings : `key.path=value` with the value in TOML, in order
    ideal : light without width, in clear air, and sensors without errors, as far as no setting wants otherwise

    Raises
    ------
    ScenarioError
        where the file or a setting is no scene
    """
    path = find(scene)
    tree = _read(path)
    if ideal:
        _take_errors(tree)
    for setting in settings:
        _apply(tree, setting)
    try:
        return _checked(path, tree)
    except ValidationError as error:
        key, found, expected = explain(error)
        raise ScenarioError(_origin(path, settings, key), found, expected) from None


def _checked(path: Path, tree: dict[str, Any]) -> Scenario:
    """Check a tree; JSON has no dates, so theirs are read from text there."""
    context = {"folder": path.parent.absolute()}  # so that a file is found from wherever it is named again
    if _is_json(path):
        tree.pop("written_by", None)
        return Scenario.model_validate_json(json.dumps(tree, default=str), context=context)
    return Scenario.model_validate(tree, context=context)


def _is_json(path: Path) -> bool:
    """Whether a file is JSON, by its name."""
    return path.suffix == ".json"


def _read(path: Path) -> dict[str, Any]:
    """Parse the file."""
    kind, parse = ("JSON", json.loads) if _is_json(path) else ("TOML", tomllib.loads)
    try:
        tree = parse(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ScenarioError(str(path), str(error.strerror), "a scene file") from None
    except UnicodeDecodeError as error:
        raise ScenarioError(str(path), f"no UTF-8 text at byte {error.start}", f"a {kind} file") from None
    except (ValueError, RecursionError) as error:  # the parser's own error, a vast integer, a vast nesting
        raise ScenarioError(str(path), f"no valid {kind}: {error}", f"a {kind} file") from None
    if not isinstance(tree, dict):
        raise ScenarioError(str(path), "no table", f"a {kind} file with the tables of a scene")
    return tree


def _take_errors(tree: dict[str, Any]) -> None:
    """Make a scene's light, air and sensors ideal."""
    tree.update(beam={"model": "none"}, noise={"preset": "ideal"}, weather={})
    units = rig if isinstance(rig := tree.get("rig"), list) else []
    for unit in (tree.setdefault("sensor", {}), *units):
        if isinstance(unit, dict):  # what is no table is found when the scene is checked
            unit.update(dict.fromkeys(_UNIT_ERRORS, 0.0))


def _apply(tree: dict[str, Any], setting: str) -> None:
    """Put one `key.path=value` into the tree."""
    where = f"--set {setting}"
    key, equals, text = setting.partition("=")
    names = key.strip().split(".")
    if not equals or not all(names) or not text.strip():
        raise ScenarioError(where, "no assignment", "key.path=value")
    for name in names[:-1]:
        _drop_rivals(tree, name)
        branch = tree.setdefault(name, {})
        if not isinstance(branch, dict):
            raise ScenarioError(where, f"{name} is no table", "table names before the last dot")
        tree = branch
    _drop_rivals(tree, names[-1])
    tree[names[-1]] = _value(text.strip())


def _drop_rivals(tree: dict[str, Any], name: str) -> None:
    """Drop the keys that a key that is set rules out."""
    for rivals in _RIVALS:
        if name in rivals:
            for rival in rivals - {name}:
                tree.pop(rival, None)


def _value(text: str) -> object:
    """Parse a value; what is no TOML is the bare word that was meant."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if len(parsed) == 1 else text


def _origin(path: Path, settings: Sequence[str], key: str) -> str:
    """Where a key got its value: the last setting that touched it, or else the file."""
    for setting in reversed(settings):
        name = setting.partition("=")[0].strip()
        if key == name or key.startswith((f"{name}.", f"{name}[")):
            return f"--set {setting}" if key == name else f"--set {setting}: {key}"
    return f"{path}: {key}"
