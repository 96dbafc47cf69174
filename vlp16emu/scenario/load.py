"""TOML to `Scenario`, with errors that name file, key path, what was found and what was expected."""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario.find import find
from vlp16emu.scenario.model import Scenario

__all__ = ["load"]


def load(scene: str, settings: Iterable[str] = ()) -> Scenario:
    """Read a scene and apply settings to it.

    Parameters
    ----------
    scene : name or path
    settings : `key.path=value` with the value in TOML, in order

    Raises
    ------
    ScenarioError
        where the file or a setting is no scene
    """
    path = find(scene)
    tree = _read(path)
    for setting in settings:
        _apply(tree, setting)
    try:
        return Scenario.model_validate(tree)
    except ValidationError as error:
        raise _first(path, error) from None


def _read(path: Path) -> dict[str, Any]:
    """Parse the file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(str(path), error.strerror or "cannot be read", "a readable file") from None
    except UnicodeDecodeError as error:
        raise ScenarioError(str(path), f"no UTF-8 text at byte {error.start}", "a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(str(path), f"no valid TOML: {error}") from None


def _apply(tree: dict[str, Any], setting: str) -> None:
    """Put one `key.path=value` into the tree."""
    key, equals, text = setting.partition("=")
    names = key.strip().split(".")
    if not equals or not all(names):
        raise ScenarioError(f"--set {setting}", "no assignment", "key.path=value")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a bare word is the string that was meant
    for name in names[:-1]:
        branch = tree.setdefault(name, {})
        if not isinstance(branch, dict):
            raise ScenarioError(f"--set {setting}", f"{name} is no table", "a path of table names")
        tree = branch
    tree[names[-1]] = value


def _first(path: Path, error: ValidationError) -> ScenarioError:
    """Say the first of pydantic's findings in one line."""
    finding = error.errors(include_url=False)[0]
    kinds = ("static", "walk", "forest", "hall")  # pydantic puts the union's tag into the path; no file has it
    keys = [str(part) for part in finding["loc"] if part not in kinds]
    found, expected = _told(finding)
    return ScenarioError(f"{path}: {'.'.join(keys) or 'scene'}", found, expected)


def _told(finding: ErrorDetails) -> tuple[str, str | None]:
    """What was found and what was expected."""
    kind, message = finding["type"], finding["msg"]
    if kind == "extra_forbidden":
        return "unknown key", "a key of this table (see `vlp16emu schema`)"
    if kind == "missing":
        return "missing", "a value"
    if kind.startswith("union_tag"):
        return f"found kind {finding['input'].get('kind')!r}" if isinstance(finding["input"], dict) else "no table", message
    if kind == "value_error":
        return message.removeprefix("Value error, "), None
    return f"found {finding['input']!r}", message.removeprefix("Input should be ")
