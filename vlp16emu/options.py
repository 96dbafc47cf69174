"""Options of a run, each declared once at a field of a frozen dataclass: name, unit, limits and help.

Python reads the dataclasses as they are; `vlp16emu.cli.verb` makes command-line options of the same fields.
"""

import math
import operator
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields
from types import NoneType
from typing import Annotated, Any, NamedTuple, get_args, get_origin

from vlp16emu.errors import InputError

_UNITS = ("_s", "_hz", "_m", "_deg", "_px")
"""Units at the end of field names; the names of command-line options have none."""


@dataclass(frozen=True, slots=True)
class Option:
    """Meaning of a value, and which values are right.

    Parameters
    ----------
    help : one or two sentences
    metavar : what stands for the value in help; None for a flag or a choice
    name : on the command line; made of the field's name, without its unit, if left out. One without dashes is an argument
    ge, gt, le, lt : limits of a number
    words : the texts that are admitted
    parse : reads the text of the command line, ValueError if it cannot; the type of the field if left out
    expected : says in words what is right; made of limits and words if left out
    shown : whether help shows the default, or what it shows instead
    """

    help: str
    metavar: str | None = None
    name: str | None = None
    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    words: tuple[str, ...] = ()
    parse: Callable[[str], Any] | None = None
    expected: str | None = None
    shown: bool | str = True

    def check(self, where: str, kind: type, value: Any, found: object = None) -> None:
        """Raise InputError, in the name of `where`, if `value` is not right."""
        limits = (operator.ge, self.ge), (operator.gt, self.gt), (operator.le, self.le), (operator.lt, self.lt)
        if kind in (int, float):
            kept = [holds(value, limit) for holds, limit in limits if limit is not None]
            is_right = math.isfinite(value) and all(kept)
        else:
            is_right = not self.words or value in self.words
        if not is_right:
            raise InputError(where, f"found {value if found is None else found}", self._expected(kind))

    def read(self, where: str, kind: type, text: str) -> Any:
        """Return the value of a text of the command line; InputError, in the name of `where`, if it is not right."""
        try:
            value = (self.parse or kind)(text)
        except ValueError:
            raise InputError(where, f"found {text}", self._expected(kind)) from None
        self.check(where, kind, value, text)
        return value

    def _expected(self, kind: type) -> str:
        if self.expected:
            return self.expected
        if self.words:
            return f"{', '.join(self.words[:-1])} or {self.words[-1]}"
        number = "a whole number" if kind is int else "a number"
        if self.ge is not None and self.le is not None:
            return f"{number} from {self.ge:.12g} to {self.le:.12g}"
        limits = {"at least": self.ge, "above": self.gt, "at most": self.le, "below": self.lt}
        words = " and ".join(f"{word} {limit:.12g}" for word, limit in limits.items() if limit is not None)
        return f"{number} {words}".rstrip()


class Declared(NamedTuple):
    """A field that is an option."""

    field: str
    name: str  # on the command line: with dashes, or the word of an argument
    kind: type  # of the value, without None; `list` if the option can be repeated
    default: Any  # MISSING if there is none
    option: Option


def declared(name: str, annotation: Any, default: Any = MISSING) -> Declared | None:
    """Return the option that `Annotated[kind, Option(...)]` declares; None if it declares none."""
    if get_origin(annotation) is not Annotated:
        return None
    inner, *others = get_args(annotation)
    option = next((other for other in others if isinstance(other, Option)), None)
    if option is None:
        return None
    kinds = [kind for kind in get_args(inner) if kind is not NoneType] if NoneType in get_args(inner) else [inner]
    bare = next((name.removesuffix(unit) for unit in _UNITS if name.endswith(unit)), name)
    of_field = option.name or f"--{bare.replace('_', '-')}"
    return Declared(name, of_field, get_origin(kinds[0]) or kinds[0], default, option)


class Options:
    """Base of frozen dataclasses of options. InputError if a value is not right, in the name of its field."""

    def __post_init__(self) -> None:
        for one in options_of(type(self)):
            if (value := getattr(self, one.field)) is not None:
                one.option.check(one.field, one.kind, value)


def options_of(owner: type) -> Iterator[Declared]:
    """Yield the options that the fields of a dataclass declare, without those of dataclasses inside it."""
    for field in fields(owner):
        if one := declared(field.name, field.type, field.default):
            yield one
