"""The table of SLAM programs, `programs.toml`: the values of their configurations and what they need of a bag."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from vlp16emu.errors import InputError


class Value(NamedTuple):
    """A value of a configuration."""

    key: str
    """Path in the file, parts separated by slashes."""
    value: Any
    """A text {name} is a value of the rig."""
    default: Any = None
    """The program's own value, if ours differs."""
    why: str = ""
    """Why it does."""
    source: str = ""
    """Where the program says so; the first file that was read if left out."""


class ConfigFile(NamedTuple):
    """A file of a configuration."""

    name: str
    """Its ending is the format."""
    root: str
    """Path under which all keys are."""
    include: str
    """Package and launch file that a .launch includes."""
    values: tuple[Value, ...]


class Program(NamedTuple):
    """A SLAM program."""

    name: str
    repository: str
    """On GitHub."""
    read: tuple[str, ...]
    """Files of the repository that say what the program reads."""
    start: str
    """How to start it with the configuration, in Markdown."""
    compiled: str
    """What is compiled in, and cannot be configured."""
    rest_s: float
    """Rest at the start that it needs."""
    files: tuple[ConfigFile, ...]
    needs: Mapping[str, str]
    """What to set, and what happens otherwise, by the rule of `fitness`."""


@cache
def programs() -> Mapping[str, Program]:
    """Return all programs by name, in the order of the table."""
    table = tomllib.loads(files(__package__).joinpath("programs.toml").read_text(encoding="utf-8"))
    made = {}
    for name, row in table.items():
        of = tuple(
            ConfigFile(
                one["name"], one.get("root", ""), one.get("include", ""), tuple(Value(*v) for v in one["values"])
            )
            for one in row["files"]
        )
        about = row["repository"], tuple(row["read"]), row["start"], row["compiled"], row.get("rest_s", 0.0)
        made[name] = Program(name, *about, of, row["needs"])
    return made


def chosen(name: str, *, where: str = "--for") -> list[Program]:
    """Return a program by name, or all of them; InputError if there is none."""
    if name != "all" and name not in programs():
        raise InputError(where, f"found {name}", f"{', '.join(programs())} or all")
    return [program for program in programs().values() if name in ("all", program.name)]
