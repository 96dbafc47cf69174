"""Objects that are loaded by name when a scene, a command or an option needs them.

They are from this and other packages.

Other packages add entry points to the groups `vlp16emu.worlds`, `.motions`, `.sensors`, `.scenes`, `.clouds`
and `.verbs`. Entry points are searched only for names that this package lacks: reading the metadata of all
packages takes 20 ms.
"""

import logging
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

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
        "puck-hi-res": "vlp16emu.sensor.settings:Sensor",
        "puck-lite": "vlp16emu.sensor.settings:Sensor",
        "vlp-16": "vlp16emu.sensor.settings:Sensor",
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

    Those that fail to load are skipped.
    """
    for name, entry in _entry_points(group).items():
        try:
            yield name, _load(entry)
        except InputError as error:
            _log.info("%s", error)  # a scene or command that names it gets the line as an error


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
    from importlib.metadata import entry_points  # here: see above

    return {
        entry.name: entry
        for entry in entry_points(group=f"vlp16emu.{group}")
        if entry.name not in DOORS[group]
    }


def _load(entry: "EntryPoint") -> Any:
    try:
        return entry.load()
    except Exception as error:  # another package may raise anything
        package = entry.dist.name if entry.dist else "a package"
        found = f"{type(error).__name__}: {error}"
        where = f"{package}: entry point {entry.name} of {entry.group}"
        raise InputError(where, found, f"{entry.value}, which can be imported") from error
