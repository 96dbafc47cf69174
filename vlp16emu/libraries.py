"""Libraries of the extras: what each extra needs is read from the metadata of this package."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec

from vlp16emu.errors import MissingExtraError

_REQUIREMENT = re.compile(
    r"(?P<name>[\w.-]+)(\[(?P<brought>[\w.-]+)\])?(>=(?P<bound>[\d.]+))?"
    r"[^;]*; extra == ['\"](?P<extra>\w+)['\"]"
)
"""Requirement in the metadata (PEP 508), as the build backend writes it; an extra of a library in brackets
has the name of the library that it brings."""
_RELEASE = re.compile(r"\d+(\.\d+)*")
_MODULES = {"pillow": "PIL"}  # modules whose name is not their distribution's


@cache
def bounds_of(extra: str) -> Mapping[str, str]:
    """Return the lowest version of each library of an extra by its name; empty if it has no bound.

    Without metadata, as in a bare copy of the source, there are none.
    """
    try:
        lines = requires("vlp16emu") or []
    except PackageNotFoundError:
        return {}
    found = [row for row in map(_REQUIREMENT.fullmatch, lines) if row and row["extra"] == extra]
    brought = {row["brought"]: "" for row in found if row["brought"]}
    return {row["name"]: row["bound"] or "" for row in found} | brought


def lacking(extra: str, *names: str) -> list[str]:
    """Return the libraries of an extra that are missing or too old, as in `rosbags>=0.11 (found 0.9.23)`.

    Parameters
    ----------
    extra : name of the extra
    names : those of its libraries that are needed, all by default
    """
    bounds = bounds_of(extra)
    texts = (_fault(name, bounds.get(name, "")) for name in names or bounds)
    return [text for text in texts if text]


def _fault(name: str, bound: str) -> str:
    if find_spec(_MODULES.get(name, name)) is None:
        return name
    try:
        found = version(name)
    except PackageNotFoundError:  # a library in another form than that of an index
        return ""
    return f"{name}>={bound} (found {found})" if _release(found) < _release(bound) else ""


def _release(text: str) -> list[int]:
    """Return the numbers of a version before suffixes such as rc1 (PEP 440, release segment)."""
    release = _RELEASE.match(text)
    return [int(number) for number in release[0].split(".")] if release else []


def check_extra(extra: str, purpose: str, *names: str) -> None:
    """Raise MissingExtraError if a library of an extra is missing or too old, without importing it.

    Parameters
    ----------
    extra, names : as in `lacking`
    purpose : what needs the extra
    """
    if faults := lacking(extra, *names):
        raise MissingExtraError(", ".join(faults), extra, purpose)


@contextmanager
def of_extra(extra: str, purpose: str, *names: str) -> Iterator[None]:
    """Check the libraries of an extra before the block, which imports them.

    Parameters are those of `check_extra`. Raises MissingExtraError if one is missing, too old or cannot be
    imported.
    """
    check_extra(extra, purpose, *names)
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(error.name or extra, extra, purpose) from None
