"""Objects that are loaded by name when a scene, a command or an option needs them.

They are from this and other packages.

Other packages add entry points to the groups `vlp16emu.worlds`, `.motions`, `.sensors`, `.scenes`, `.clouds`
and `.verbs`. Entry points are searched only for names that this package lacks: reading the metadata of all
packages takes 20 ms. What they load is checked against its group: a broken one is an error where it is named,
and is left out elsewhere.
"""

import inspect
import logging
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, get_args, get_type_hints

from vlp16emu.errors import InputError
from vlp16emu.models import MODEL_NAMES

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class Part(Generic[_T]):
    """A function or class outside the core that the core uses.

    Its type `_T` is declared by the core beside its use.

    It is imported when it is used. `tests/test_parts.py` lists all parts, and mypy compares them with
    their types there.

    Parameters
    ----------
    place : module:name
    """

    def __init__(self, place: str) -> None:
        self.place = place

    @property
    def is_installed(self) -> bool:
        """True if its module is installed."""
        return _is_installed(self.place)

    def load(self) -> _T:
        """Return the function or class; raises InputError if this part of the package is not installed."""
        loaded: _T = _imported(self.place)
        return loaded


DOORS: dict[str, dict[str, str]] = {  # groups of names, each name with its object as module:name
    "worlds": {
        "forest": "vlp16emu.forest.settings:Forest",
        "hall": "vlp16emu.world.settings:Hall",
        "plot": "vlp16emu.forest.settings:Plot",
    },
    "motions": {
        "live": "vlp16emu.extras.live.settings:Live",
        "recorded": "vlp16emu.extras.recorded.settings:Recorded",
        "static": "vlp16emu.motion.settings:Static",
        "walk": "vlp16emu.extras.walk.settings:Walk",
    },
    "sensors": {
        "free": "vlp16emu.extras.free_sensor:FreeSensor",
        **dict.fromkeys(MODEL_NAMES, "vlp16emu.sensor.settings:Sensor"),
    },
    "scenes": {},  # folders of scene files
    "clouds": {
        ".csv": "vlp16emu.extras.clouds.cloud:CsvFile",
        ".npz": "vlp16emu.extras.clouds.cloud:NpzFile",
        ".ply": "vlp16emu.extras.clouds.cloud:PlyFile",
        ".pcd": "vlp16emu.extras.clouds.cloud:PcdFile",
        ".las": "vlp16emu.extras.clouds.las:LasFile",
        ".laz": "vlp16emu.extras.clouds.las:LazFile",
    },
    "verbs": {  # in the order of the help
        "record": "vlp16emu.cli.record:record",
        "stream": "vlp16emu.cli.stream:stream",
        "replay": "vlp16emu.cli.stream:replay",
        "decode": "vlp16emu.cli.record:decode",
        "verify": "vlp16emu.cli.check:verify",
        "scenes": "vlp16emu.cli.about:scenes",
        "schema": "vlp16emu.cli.about:schema",
        "plan": "vlp16emu.cli.about:plan",
        "doctor": "vlp16emu.cli.about:doctor",
        "cache": "vlp16emu.cli.about:cache",
        "truth": "vlp16emu.cli.write:truth",
        "points": "vlp16emu.cli.write:points",
        "bag": "vlp16emu.cli.write:bag",
        "picture": "vlp16emu.cli.write:picture",
        "images": "vlp16emu.cli.write:images",
        "view": "vlp16emu.cli.write:view",
        "dataset": "vlp16emu.cli.write:dataset",
        "score": "vlp16emu.cli.check:score",
        "compare": "vlp16emu.cli.check:compare",
        "fit": "vlp16emu.cli.check:fit",
        "forest": "vlp16emu.cli.about:forest",
        "accuracy": "vlp16emu.cli.about:accuracy",
        "plot": "vlp16emu.cli.check:plot",
    },
}


def door(name: str, group: str) -> Any:
    """Return the object behind a name of a group.

    Raises InputError if this part of the package is not installed or another package's entry point cannot be
    loaded; KeyError if the group has no such name.
    """
    if name not in DOORS[group]:
        return _load(_entry_points(group)[name])
    return _imported(DOORS[group][name])


def has_door(name: str, group: str) -> bool:
    """Return whether a group has a name whose module is installed."""
    if name not in DOORS[group]:
        return name in _entry_points(group)
    return _is_installed(DOORS[group][name])


def plug_ins(group: str) -> Iterator[tuple[str, Any]]:
    """Yield name and object of each entry point of other packages in a group.

    Those that fail to load, or are not what the group takes, are left out, each with a warning.
    """
    for name, entry in _entry_points(group).items():
        try:
            found = _load(entry)
        except InputError as error:
            _log.warning("%s; it is left out", error)
            continue
        yield name, found


def _is_installed(place: str) -> bool:
    module, _, _ = place.partition(":")
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def _imported(place: str) -> Any:
    module, _, name = place.partition(":")
    try:
        return getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("vlp16emu"):
            raise
        raise InputError(name, f"no module {error.name}", "a complete installation") from None


@cache
def _entry_points(group: str) -> dict[str, "EntryPoint"]:
    from importlib.metadata import distributions  # here: see above

    found: dict[str, EntryPoint] = {}
    for package in distributions():
        try:
            entries = package.entry_points.select(group=f"vlp16emu.{group}")
        except Exception as error:  # noqa: BLE001  # of the parser, for a damaged list
            _log.warning("%s: entry points that cannot be read (%s)", _name_of(package), _summary(error))
            continue
        for entry in entries:
            if entry.name not in DOORS[group]:
                found.setdefault(entry.name, entry)  # as for modules, the first one on the path counts
    return found


@cache
def _load(entry: "EntryPoint") -> Any:
    """Return the object of an entry point; InputError if it cannot be loaded or is not of its group."""
    group = entry.group.rpartition(".")[2]
    where = f"{_name_of(entry.dist)}: entry point {entry.name} of {entry.group}"
    try:
        found = entry.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # another package may raise anything, and may exit
        raise InputError(where, _summary(error), f"{entry.value}, which can be imported") from error
    try:
        expected = _CHECKS[group](found, entry.name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise InputError(where, _summary(error), f"an object that {entry.group} takes") from error
    if expected is not None:
        raise InputError(where, f"found {_shown(found)}", expected)
    return found


def _name_of(package: "Distribution | None") -> str:
    try:
        return str(package.name) if package else "a package"
    except Exception:  # noqa: BLE001  # its metadata may be damaged or missing
        return "a package"


def _shown(found: object) -> str:
    """Return a text in quotes, the name of a class, or that of the class of another object."""
    if isinstance(found, str | Path):
        return f"'{found}'"
    return f"the class {found.__name__}" if isinstance(found, type) else f"a {type(found).__name__}"


def _summary(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _section_check(base: str, tag: str) -> Callable[[object, str], str | None]:
    """Return the check of a group of sections: of the class `base`, selected by the key `tag`."""

    def check(found: object, name: str) -> str | None:
        """Return what was expected of a class that is not a section of its kind; None if it is one."""
        section = _imported(base)
        if not (isinstance(found, type) and issubclass(found, section)):
            return f"a class on {base}"
        field = found.model_fields.get(tag)  # type: ignore[attr-defined]  # a model, as its base
        if field is None or name not in get_args(field.annotation):
            return f'a class with {tag}: Literal["{name}"]'
        found.model_json_schema()  # type: ignore[attr-defined]  # raises if a key has no schema
        return None

    return check


def _cloud_check(found: object, _name: str) -> str | None:
    base = "vlp16emu.extras.clouds.cloud:PointWriter"
    is_writer = isinstance(found, type) and issubclass(found, _imported(base))
    return None if is_writer else f"a class on {base}"


def _verb_check(found: object, _name: str) -> str | None:
    if not callable(found):
        return "a function"
    inspect.signature(found, eval_str=True)  # raises if it has none, or an annotation is no expression
    get_type_hints(found)  # what builds the command needs them
    return None


def _folder_check(found: object, _name: str) -> str | None:
    is_folder = isinstance(found, str | Path) and Path(found).is_dir()
    return None if is_folder else "the path of a folder"


_CHECKS: dict[str, Callable[[object, str], str | None]] = {
    "worlds": _section_check("vlp16emu.world.settings:WorldSection", "kind"),
    "motions": _section_check("vlp16emu.motion.settings:MotionSection", "kind"),
    "sensors": _section_check("vlp16emu.sensor.settings:Lidar", "model"),
    "scenes": _folder_check,
    "clouds": _cloud_check,
    "verbs": _verb_check,
}
"""For each group, a check of an object and its name: None, or what the group expects."""
