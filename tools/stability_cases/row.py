"""What a case says of itself."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from vlp16emu.errors import InputError


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    case: str
    quantity: str
    """What is measured, and its unit."""
    error: float
    bound: float
    refusal: str = ""
    """The line with which the case was turned down; empty where it was carried out."""

    @property
    def held(self) -> bool:
        """Whether the error is within its bound; what is not a number is not."""
        return self.error <= self.bound

    @property
    def verdict(self) -> str:
        """One word."""
        if not self.held:
            return "failed"
        return "refused" if self.refusal else "held"


Case = Callable[[], Iterable[Row]]


def refused(case: str, act: Callable[[], object], says: str) -> Row:
    """Row of what must be turned down in one line.

    Parameters
    ----------
    act : what to try
    says : words of that line
    """
    try:
        act()
    except InputError as error:
        line = str(error)
        return Row(case, "not refused", 0.0 if says in line else math.inf, 0.0, line)
    return Row(case, "not refused", math.inf, 0.0)


def check(cases: Iterable[Case]) -> Iterator[Row]:
    """Carry out cases, one after the other."""
    for case in cases:
        yield from case()
