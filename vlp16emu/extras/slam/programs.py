"""The table of SLAM programs, `programs.toml`: the values of their configurations and what they need of a bag."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from vlp16emu.errors import InputError


class Value(NamedTuple):
    """A value of a configuration under its path in the file; if ours differs the program's own, why, and where that is read."""

    key: str
    value: Any
    """A text {name} is a value of the rig."""
    default: Any = None
    why: str = ""
    source: str = ""


class ConfigFile(NamedTuple):
    """A file of a configuration, whose ending is its format; a .launch file includes one of a package."""

    name: str
    values: tuple[Value, ...]
    root: str = ""
    """Path under which all keys are."""
    include: str = ""


class Program(NamedTuple):
    """A SLAM program: where it is on GitHub, and what was read there; in Markdown how to start it, and what is compiled in."""

    name: str
    repository: str
    read: list[str]
    start: str
    compiled: str
    files: list[ConfigFile]
    needs: Mapping[str, str]
    """What to set, and what happens otherwise, by the rule of `fitness`."""
    rest_s: float = 0.0
    """Rest at the start that it needs."""


@cache
def programs() -> Mapping[str, Program]:
    """Return all programs by name, in the order of the table."""
    table = tomllib.loads(files(__package__).joinpath("programs.toml").read_text(encoding="utf-8"))
    for row in table.values():
        row["files"] = [ConfigFile(**one | {"values": tuple(Value(*v) for v in one["values"])}) for one in row["files"]]
    return {name: Program(name, **row) for name, row in table.items()}


def chosen(name: str, *, where: str = "--for") -> list[Program]:
    """Return a program by name, or all of them; InputError if there is none."""
    if name != "all" and name not in programs():
        raise InputError(where, f"found {name}", f"{', '.join(programs())} or all")
    return [program for program in programs().values() if name in ("all", program.name)]
