"""TOML, JSON or a dictionary to `Scenario`, with errors that name file, key path, what was found and what was expected."""

import json
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from vlp16emu.errors import ScenarioError, readable
from vlp16emu.explain import explain
from vlp16emu.motion import Walk
from vlp16emu.scenario.find import find
from vlp16emu.scenario.model import Scenario
from vlp16emu.scenario.schema import schema
from vlp16emu.settings import DEEPEST, toml

__all__ = ["load"]

_RIVALS = frozenset(Walk.one_of), Walk.either_or
"""Keys that exclude each other: a setting of one takes the place of the others."""
_UNIT_ERRORS = ("eccentricity_deg", "azimuth_noise_deg", "clock_error_ppm")
"""Errors among the keys of `[sensor]` and `[[rig]]`."""


class _Setting(NamedTuple):
    """One value of a scene that is changed."""

    key: str
    value: object
    where: str
    """What error lines call it."""


class _Source(NamedTuple):
    """A scene as a tree, before it is checked."""

    where: str
    """What error lines call it."""
    tree: dict[str, Any]
    folder: Path
    """From which its files are found."""
    is_json: bool
    """JSON has no dates, so they are read from text there."""


def load(
    scene: str | Path | Mapping[str, Any] | Scenario,
    settings: Mapping[str, object] | Sequence[str] = (),
    *,
    ideal: bool = False,
) -> Scenario:
    """Read a scene and apply settings to it.

    Parameters
    ----------
    scene : name or path (one that ends in .json is read as the truth beside a run gives it), the tables of a scene
        file as a dictionary, or a scenario
    settings : values by `key.path`, or `key.path=value` with the value in TOML, in order
    ideal : light without width, in clear air, and sensors without errors, as far as no setting wants otherwise

    Raises
    ------
    ScenarioError
        where the file or a setting is no scene
    """
    if isinstance(scene, Scenario) and not settings and not ideal:
        return scene
    source = _source(scene)
    changes = list(_changes(settings))
    if ideal:
        _take_errors(source.tree)
    for change in changes:
        _apply(source.tree, change)
    _check_depth(source.where, source.tree)
    try:
        return _checked(source)
    except ValidationError as error:
        key, found, expected = explain(error, schema())
        raise ScenarioError(_origin(source.where, changes, key), found, expected) from None


def _source(scene: str | Path | Mapping[str, Any] | Scenario) -> _Source:
    """Read a scene of any kind."""
    if isinstance(scene, Scenario):
        tree = scene.model_dump(mode="json", by_alias=True, exclude_none=True)
        return _Source("scenario", tree, Path.cwd(), is_json=True)
    if isinstance(scene, Mapping):
        _check_depth("scene", scene)
        return _Source("scene", deepcopy(dict(scene)), Path.cwd(), is_json=False)
    path = scene if isinstance(scene, Path) else find(scene)
    return _Source(str(path), _read(path), path.parent.absolute(), is_json=_is_json(path))


def _checked(source: _Source) -> Scenario:
    """Check a tree."""
    context = {"folder": source.folder}  # so that a file is found from wherever it is named again
    if source.is_json:
        source.tree.pop("written_by", None)
        try:
            text = json.dumps(source.tree, default=str, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:  # half a pair of surrogates, which \ud800 may write
            found = f"found {error.object[error.start]!a}"
            raise ScenarioError(source.where, found, "text in Unicode") from None
        return Scenario.model_validate_json(text, context=context)
    return Scenario.model_validate(source.tree, context=context)


def _is_json(path: Path) -> bool:
    """Whether a file is JSON, by its name."""
    return path.suffix == ".json"


def _read(path: Path) -> dict[str, Any]:
    """Parse the file."""
    kind, parse = ("JSON", json.loads) if _is_json(path) else ("TOML", toml)
    with readable(path, "a scene file", ScenarioError):
        text = path.read_text(encoding="utf-8-sig")
    try:
        tree = parse(text)
    except (ValueError, RecursionError) as error:  # the parser's own error, a vast integer, a vast nesting
        raise ScenarioError(str(path), f"no valid {kind}: {error}", f"a {kind} file") from None
    if not isinstance(tree, dict):
        raise ScenarioError(str(path), "no table", f"a {kind} file with the tables of a scene")
    return tree


def _check_depth(where: str, tree: Any) -> None:
    """Refuse a tree that is too deep to be followed."""
    level = [tree]
    for _ in range(DEEPEST):
        inner = [one.values() if isinstance(one, Mapping) else one for one in level]
        level = [one for group in inner for one in group if isinstance(one, Mapping | list)]
        if not level:
            return
    raise ScenarioError(where, f"tables or lists in one another, {DEEPEST} deep", "the tables of a scene")


def _take_errors(tree: dict[str, Any]) -> None:
    """Make a scene's light, air and sensors ideal."""
    tree.update(beam={"model": "none"}, noise={"preset": "ideal"}, weather={})
    units = rig if isinstance(rig := tree.get("rig"), list) else []
    for unit in (tree.setdefault("sensor", {}), *units):
        if isinstance(unit, dict):  # what is no table is found when the scene is checked
            unit.update(dict.fromkeys(_UNIT_ERRORS, 0.0))


def _changes(settings: Mapping[str, object] | Sequence[str]) -> Iterable[_Setting]:
    """Read settings of either kind."""
    if isinstance(settings, Mapping):
        return [_Setting(key, value, f"setting {key} = {value!r}") for key, value in settings.items()]
    return [_parsed(text) for text in settings]


def _parsed(text: str) -> _Setting:
    """Read one `key.path=value`."""
    key, equals, value = text.partition("=")
    if not equals or not value.strip():
        key = ""
    return _Setting(key.strip(), _value(value.strip()), f"--set {text}")


def _apply(tree: dict[str, Any], setting: _Setting) -> None:
    """Put a value into the tree."""
    names = setting.key.split(".")
    if not all(names):
        raise ScenarioError(setting.where, "no assignment", "key.path=value")
    if len(names) > DEEPEST:
        raise ScenarioError(setting.where, f"a key of {len(names)} names", "a key of a scene")
    for name in names[:-1]:
        _drop_rivals(tree, name)
        branch = tree.setdefault(name, {})
        if not isinstance(branch, dict):
            raise ScenarioError(setting.where, f"{name} is no table", "table names before the last dot")
        tree = branch
    _drop_rivals(tree, names[-1])
    tree[names[-1]] = setting.value


def _drop_rivals(tree: dict[str, Any], name: str) -> None:
    """Drop the keys that a key that is set rules out."""
    for rivals in _RIVALS:
        if name in rivals:
            for rival in rivals - {name}:
                tree.pop(rival, None)


def _value(text: str) -> object:
    """Parse a value; what is no TOML is the bare word that was meant."""
    try:
        parsed = toml(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if len(parsed) == 1 else text


def _origin(scene: str, settings: Sequence[_Setting], key: str) -> str:
    """Where a key got its value: the last setting that touched it, or else the scene."""
    for setting in reversed(settings):
        if key == setting.key or key.startswith((f"{setting.key}.", f"{setting.key}[")):
            return setting.where if key == setting.key else f"{setting.where}: {key}"
    return f"{scene}: {key}"
