"""Loading of a `Scenario` from a name, TOML, JSON or a dictionary.

Errors name file, key, finding and expectation.
"""

import difflib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from functools import cache
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from pydantic import ValidationError

from vlp16emu.doors import Part, plug_ins
from vlp16emu.errors import ScenarioError
from vlp16emu.explain import explain
from vlp16emu.inputs import parse_json, read_text
from vlp16emu.scenario.model import Scenario, schema
from vlp16emu.sensor.settings import Lidar
from vlp16emu.settings import DEEPEST, LazySection, OneOf, Preset, SceneFile, Section, toml
from vlp16emu.trees import Table, Tree

FIELD = Part[Callable[[Tree], Tree]]("vlp16emu.extras.field:in_the_field")
"""Function that adds the tables of `conditions = "field"` to a scene."""
_UNIT_ERRORS = dict.fromkeys((*Lidar.presets["unit"], "eccentricity_deg", "clock_error_ppm"), 0.0)
"""Values that switch off the errors in `[sensor]` and `[[rig]]`."""


class _Setting(NamedTuple):
    """A changed value of a scene."""

    key: str
    value: object
    where: str  # Its name in errors
    rivals: Sequence[Iterable[str]] = ()  # For each name of the key, the keys that it excludes and replaces


class _Source(NamedTuple):
    """A scene as a tree, before it is checked."""

    where: str  # Its name in errors
    tree: Tree
    folder: Path  # Base folder of its relative paths
    is_json: bool  # JSON has no dates; they are read from text


def load(
    scene: str | Path | Table | Scenario,
    settings: Mapping[str, object] | Sequence[str] = (),
    *,
    ideal: bool = False,
    folder: Path | None = None,
) -> Scenario:
    """Read a scene and apply settings to it.

    Parameters
    ----------
    scene : name or path (.json is the form of a run's ground truth folder), the tables of a scene
        file as a dictionary, or a scenario
    settings : values by `key.path`, or `key.path=value` with the value in TOML, in order; their files are
        relative to the current folder, words may have any case, and 600.0 is the whole number 600
    ideal : beams without width, clear air, and sensors without errors, unless settings change them
    folder : base of relative paths in a dictionary; by default the current folder

    Raises ScenarioError if the file or a setting is not valid.
    """
    if isinstance(scene, Scenario) and not settings and not ideal:
        return scene
    source = _source(scene, folder)
    changes = _settings(settings)
    if ideal:
        _without_errors(source.tree)
    try:
        return _validate(_with_settings(source, changes))
    except ValidationError as error:
        fault = explain(error, schema())
        raise ScenarioError(_origin(source, changes, fault), *fault[1:]) from None


def rewrite(tree: Tree, settings: Mapping[str, object] | Sequence[str], *, folder: Path, to: Path) -> None:
    """Apply settings to the tables of a scene file in place, and name its relative files from another folder.

    Parameters
    ----------
    tree : tables of the file, of any subclass of `dict`; what does not change keeps its form
    settings : as in `load`
    folder : of the file now
    to : folder where it is to stand

    Raises ScenarioError if a setting is no assignment.
    """
    before, after = Path(os.path.realpath(folder)), os.path.realpath(to)
    if str(before) != after:
        _move_files(tree, [Scenario], before, after)
    for setting in _settings(settings):
        _apply(tree, setting)


def _move_files(tree: Any, kinds: Sequence[Any], before: Path, after: str) -> None:
    """Change the relative files in tables or a list of some kinds to paths from the folder `after`."""
    is_table = isinstance(tree, dict)
    for name, value in [*(tree.items() if is_table else enumerate(tree))]:
        own = _kinds_of(kinds, name) if is_table else kinds
        if isinstance(value, dict | list):
            _move_files(value, own, before, after)
        elif isinstance(value, str) and SceneFile in own and value and not Path(value).is_absolute():
            tree[name] = os.path.relpath(before / value, after)


def _settings(settings: Mapping[str, object] | Sequence[str]) -> list[_Setting]:
    given = settings.items() if isinstance(settings, Mapping) else ()
    read = [_Setting(key, value, f"setting {key} = {value!r}") for key, value in given] or [
        *map(_parse_setting, settings)
    ]
    return [_convert(one) for one in read]


def _with_settings(source: _Source, changes: Iterable[_Setting]) -> _Source:
    source = source._replace(tree=deepcopy(source.tree))
    for change in changes:
        _apply(source.tree, change)
    _check_depth(source.where, source.tree)
    return (
        source._replace(tree=FIELD.load()(source.tree))
        if source.tree.get("conditions") == "field"
        else source
    )


def _source(scene: str | Path | Table | Scenario, folder: Path | None) -> _Source:
    if isinstance(scene, Scenario):
        tree = scene.model_dump(mode="json", by_alias=True, exclude_none=True)
        return _Source("scenario", tree, Path.cwd(), is_json=True)
    if isinstance(scene, Mapping):
        _check_depth("scene", scene)
        return _Source("scene", deepcopy(dict(scene)), folder or Path.cwd(), is_json=False)
    path = scene if isinstance(scene, Path) else find(scene)
    tree = {"title": path.stem} | _read(path)
    _check_depth(str(path), tree)
    return _Source(str(path), tree, path.parent.absolute(), is_json=path.suffix == ".json")


def _validate(source: _Source) -> Scenario:
    context = {"folder": source.folder}  # so that relative paths stay valid
    if source.is_json:
        source.tree.pop("written_by", None)
        try:
            text = json.dumps(source.tree, default=str, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:  # a lone surrogate, as from \ud800
            found = f"found {error.object[error.start]!a}"
            raise ScenarioError(source.where, found, "text in Unicode") from None
        return Scenario.model_validate_json(text, context=context)
    return Scenario.model_validate(source.tree, context=context)


def _read(path: Path) -> Tree:
    kind, parse = ("JSON", parse_json) if path.suffix == ".json" else ("TOML", toml)
    text = read_text(path, "a scene file", ScenarioError)
    try:
        tree = parse(text)
    except (ValueError, RecursionError) as error:  # the parser's error, a huge integer, too deep nesting
        raise ScenarioError(str(path), f"no valid {kind}: {error}", f"a {kind} file") from None
    if not isinstance(tree, dict):
        raise ScenarioError(str(path), "no table", f"a {kind} file with the tables of a scene")
    return tree


def _check_depth(where: str, tree: Any) -> None:
    level = [tree]
    for _ in range(DEEPEST):
        inner = [one.values() if isinstance(one, Mapping) else one for one in level]
        level = [one for group in inner for one in group if isinstance(one, Mapping | list)]
        if not level:
            return
    raise ScenarioError(where, f"tables or lists in one another, {DEEPEST} deep", "the tables of a scene")


def _without_errors(tree: Tree) -> None:
    """Make a scene's beam, air and sensors ideal."""
    tree.update(beam={"model": "none"}, noise={"preset": "ideal"}, weather={}, capture={"preset": "ideal"})
    units = rig if isinstance(rig := tree.get("rig"), list) else []
    for unit in (tree.setdefault("sensor", {}), *units):
        if isinstance(unit, dict):  # other types are reported when the scene is checked
            unit.update({"preset": "steady"} | _UNIT_ERRORS)


def _convert(setting: _Setting) -> _Setting:
    """Return a setting with its value converted for its key.

    Keys that it excludes are those of the tables on its path.
    """
    kinds = list[Any]([Scenario])
    rivals = list[set[str]]()
    for name in setting.key.split("."):
        tables = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Section)]
        groups = [
            {*group}
            for table in tables
            for group in (table.either_or, getattr(table, "one_of", ()))
            if name in group
        ]
        rivals.append({*chain(*groups)} - {name})
        kinds = _kinds_of(kinds, name)
    return setting._replace(value=_converted_value(setting.value, kinds), rivals=rivals)


@cache
def _hints(section: type[Section]) -> Tree:
    return get_type_hints(section, include_extras=True)


def _kinds_of(kinds: Iterable[Any], key: str) -> list[Any]:
    """List the possible types of a key in tables of some kinds."""
    found = []
    for kind in kinds:
        if isinstance(kind, type) and issubclass(kind, Section):
            hints = _hints(kind)
            names = (name for name, field in kind.model_fields.items() if key == (field.alias or name))
            found += [part for name in names for part in _parts_of(hints[name])]
    return found


def _parts_of(kind: Any) -> list[Any]:
    if isinstance(kind, OneOf | LazySection):
        return list(kind.sections().values()) if isinstance(kind, OneOf) else [kind.section]
    parts = () if get_origin(kind) is Literal else get_args(kind)
    return [kind, *(inner for part in parts for inner in _parts_of(part))]


def _converted_value(value: object, kinds: Sequence[Any]) -> object:
    """Convert a value to the types of a key.

    It becomes a whole number, a path relative to this folder, or a word with correct case.
    """
    if isinstance(value, dict):
        return {key: _converted_value(inner, _kinds_of(kinds, key)) for key, inner in value.items()}
    if isinstance(value, list):
        return [_converted_value(inner, kinds) for inner in value]
    if isinstance(value, float) and value.is_integer() and int in kinds and float not in kinds:
        return int(value)
    if isinstance(value, str) and value and SceneFile in kinds:
        return str(Path.cwd() / value)
    if isinstance(value, str) and any(isinstance(kind, type) and issubclass(kind, Preset) for kind in kinds):
        return {"preset": value}
    if isinstance(value, str):
        words = [word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
        return next((word for word in words if str(word).lower() == value.lower()), value)
    return value


def _parse_setting(text: str) -> _Setting:
    """Parse `key.path=value`; a value that is not TOML is taken as a bare word."""
    key, _, value = (part.strip() for part in text.partition("="))
    try:
        parsed = toml(f"value = {value}")
    except (ValueError, RecursionError):
        parsed = {}
    # A line break in the value could start another key.
    return _Setting(key if value else "", parsed["value"] if len(parsed) == 1 else value, f"--set {text}")


def _apply(tree: Tree, setting: _Setting) -> None:
    names = setting.key.split(".")
    if not all(names):
        raise ScenarioError(setting.where, "no assignment", "key.path=value")
    if len(names) > DEEPEST:
        raise ScenarioError(setting.where, f"a key of {len(names)} names", "a key of a scene")
    for place, (name, rivals) in enumerate(zip(names, setting.rivals, strict=True), start=1):
        for rival in rivals:
            tree.pop(rival, None)
        if place == len(names):
            tree[name] = setting.value
            return
        tree = tree.setdefault(name, {})
        if not isinstance(tree, dict):
            raise ScenarioError(setting.where, f"{name} is no table", "table names before the last dot")


def _origin(source: _Source, settings: Sequence[_Setting], fault: tuple[str, str, str]) -> str:
    """Return the origin of a fault: the last setting of its key, the setting that causes it, or the scene."""
    key, _, _ = fault
    for setting in reversed(settings):
        if key == setting.key or key.startswith((f"{setting.key}.", f"{setting.key}[")):
            return setting.where if key == setting.key else f"{setting.where}: {key}"
    for count in reversed(range(len(settings))):
        try:
            _validate(_with_settings(source, settings[:count]))
        except ValidationError as error:
            if explain(error, schema()) == fault:
                continue
        return f"{settings[count].where}: {key}"
    return f"{source.where}: {key}"


def _folders() -> Iterator[Path]:
    """Yield the folders of scenes, in order of precedence."""
    if own := os.environ.get("VLP16EMU_SCENES"):
        yield Path(own)
    package = Path(str(resources.files("vlp16emu")))
    # A checkout has scenes/ beside the package; a copy inside would be outdated.
    checkout = package.parent / "scenes"
    yield checkout if (package.parent / "pyproject.toml").is_file() else package / "scenes"


def scene_files() -> dict[str, Path]:
    """Return all scenes by name, sorted: files, and folders that contain a file of the same name.

    Scenes of other packages, in the folders of their entry points `vlp16emu.scenes`, come last.
    """
    found = _scenes_in(_folders())
    return dict(sorted((_scenes_in(Path(folder) for _, folder in plug_ins("scenes")) | found).items()))


def _scenes_in(folders: Iterable[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for folder in folders:
        own = (path for path in folder.glob("*/*.toml") if path.stem == path.parent.name)
        for path in (*folder.glob("*.toml"), *own):
            found.setdefault(path.stem, path)
    return found


def find(scene: str) -> Path:
    """Return the path of a scene from its name, with _ or -, or its path, which is not checked.

    Raises ScenarioError for an unknown name.
    """
    path = Path(scene)
    if path.suffix in (".toml", ".json") or path.parent != Path():
        return path
    known = _scenes_in(_folders())
    name = scene if scene in known else scene.replace("-", "_")
    if name not in known:
        known = scene_files()
        name = scene if scene in known else name
    if name not in known:
        near = difflib.get_close_matches(name.lower(), known, n=1)
        names = f"{near[0]}, the nearest of `vlp16emu scenes`" if near else ", ".join(known)
        raise ScenarioError(f"scene '{scene}'", "unknown name", f"{names}, or a path ending in .toml")
    return known[name]


def named_files(scenario: object) -> list[Path]:
    """Return the files named in a scenario or a part of it: poses, waypoints, heights, trees, meshes."""
    own = list[Path]()
    parts = list(scenario) if isinstance(scenario, list | tuple) else []
    if isinstance(scenario, Section):
        kinds = _hints(type(scenario))
        parts = [inner for _, inner in scenario]
        named = (key for key, inner in scenario if isinstance(inner, str))
        own = [
            Path(getattr(scenario, key)) for key in named if SceneFile in (kinds[key], *get_args(kinds[key]))
        ]
    return [*own, *(file for part in parts for file in named_files(part))]
