"""What a case of numerical stability is, and how one is carried out."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from vlp16emu.errors import Vlp16emuError


class Row(NamedTuple):
    """One quantity of a case: its largest error, and the bound that the error must not exceed."""

    quantity: str  # with its unit; the error and the bound are in this unit
    error: float
    bound: float
    refusal: str = ""  # error message of input that is refused; empty if the case was computed

    @property
    def share(self) -> float:
        """Error over bound; infinite for NaN, and for any error where the bound is 0."""
        if math.isnan(self.error):
            return math.inf
        if self.bound == 0:
            return math.inf if self.error else 0.0
        return self.error / self.bound

    def holds(self, tighten: float = 1.0) -> bool:
        """Return True if the error is within the bound over `tighten`; NaN is never within it."""
        return self.error <= self.bound / tighten


Run = Callable[[], Iterable[Row]]


@dataclass(frozen=True, slots=True)
class Case:
    """A stiff or extreme case."""

    run: Run  # carries the case out
    authority: str  # what gives the true values: a closed form, high precision, another program
    is_slow: bool  # True if it takes more than some three seconds, or a fast case asks the same of less
    name: str = field(init=False)
    extreme: str = field(init=False)  # what is stiff or extreme about it

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.run.__name__.replace("_", "-"))
        object.__setattr__(self, "extreme", " ".join((self.run.__doc__ or "").split()))


@dataclass(frozen=True, slots=True)
class Result:
    """Rows of a case that was carried out, and the CPU time of the process for them."""

    case: Case
    rows: list[Row]
    cpu_s: float

    def holds(self, tighten: float = 1.0) -> bool:
        """Return True if there are rows and all of them hold."""
        return bool(self.rows) and all(row.holds(tighten) for row in self.rows)


CASES = list[Case]()
"""All cases, in the order in which their modules are imported."""


def case(authority: str, *, is_slow: bool = False) -> Callable[[Run], Run]:
    """Add a function to the cases; its docstring says what is extreme, and its name is that of the case."""

    def add(run: Run) -> Run:
        CASES.append(Case(run, authority, is_slow))
        return run

    return add


def carry_out(cases: Iterable[Case]) -> Iterator[Result]:
    """Carry out cases, one after the other."""
    for one in cases:
        began_s = time.process_time()
        rows = worst(one.run())
        yield Result(one, rows, time.process_time() - began_s)


def worst(rows: Iterable[Row]) -> list[Row]:
    """Return the row of each quantity with the largest error over its bound; NaN is the largest error."""
    found = dict[str, Row]()
    for row in rows:
        so_far = found.setdefault(row.quantity, row)
        if row.share > so_far.share:
            found[row.quantity] = row
    return list(found.values())


def refusal(what: str, act: Callable[[], object], says: str) -> Row:
    """Return the row of input that must be refused.

    Parameters
    ----------
    what : the input, in words
    act : what must raise an error of vlp16emu
    says : part of the message that it must have
    """
    quantity = f"{what} is refused"
    try:
        act()
    except Vlp16emuError as error:
        message = str(error)
        return Row(quantity, 0.0 if says in message else math.inf, 0.0, message)
    return Row(quantity, math.inf, 0.0)
