"""Writing of a scene file with changed keys, which keeps the user's comments."""

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

from vlp16emu.errors import OutputError, ScenarioError
from vlp16emu.inputs import parse_json, read_text
from vlp16emu.libraries import of_extra
from vlp16emu.output import OutputFile, spare
from vlp16emu.scenario import load, rewrite
from vlp16emu.settings import toml

_ONE_LINE = 6  # way points that are written on one line; more have one each


def check_place(to: Path, inputs: Iterable[Path]) -> None:
    """Raise OutputError if a place is not for a scene file: another ending, no folder, or an input."""
    where = f"--save {to}"
    if to.suffix != ".toml":
        raise OutputError(where, f"found the ending {to.suffix!r}", "a file that ends in .toml")
    if not to.parent.is_dir():
        raise OutputError(where, "no such folder", "a file in a folder that exists")
    spare(inputs, to)


def write_scene(
    to: Path,
    scene: Path,
    settings: Sequence[str],
    changed: Mapping[str, object],
    *,
    inputs: Iterable[Path] = (),
) -> None:
    """Write a scene with settings and changed keys into a file.

    Comments and other keys stay as they are. Relative files are found from the folder of the new file.

    Parameters
    ----------
    to : file to write; an earlier one is replaced
    scene : the scene's own file, TOML or JSON
    settings : of the command line, as `key.path=value`
    changed : values by `key.path`, which override the settings
    inputs : files that must not be replaced

    Raises ScenarioError if the result is no scene; OutputError if the file cannot be written, or is an input.
    """
    with of_extra("viewer", "writing a scene file", "tomlkit"):
        import tomlkit

    check_place(to, inputs)
    text = read_text(scene, "a scene file", ScenarioError)
    document = tomlkit.document()
    if scene.suffix == ".json":
        document.update({key: value for key, value in parse_json(text).items() if key != "written_by"})
    else:
        document = tomlkit.parse(text)
    rewrite(document, settings, folder=scene.parent, to=to.parent)
    # Their values follow, in a form of their own; this removes the keys that they exclude.
    rewrite(document, dict.fromkeys(changed, 0), folder=to.parent, to=to.parent)
    for key, value in changed.items():
        *tables, name = key.split(".")
        reduce(getitem, tables, document)[name] = _toml_value(value)
    new_text = tomlkit.dumps(document)
    load(toml(new_text), folder=to.parent)  # what is written can be read
    with OutputFile(to, inputs=inputs) as output, output.writing() as file:
        file.write(new_text.encode())


def _toml_value(value: object) -> Any:
    """Return a list as a TOML array; other values as they are.

    The array has inline tables, and one row to a line if it is long.
    """
    import tomlkit

    if not isinstance(value, list):
        return value
    rows = tomlkit.array()
    for row in value:
        if isinstance(row, dict):
            rows.append(tomlkit.inline_table())
            rows[-1].update(row)
        else:
            rows.append(row)
    return rows.multiline(len(value) > _ONE_LINE)
