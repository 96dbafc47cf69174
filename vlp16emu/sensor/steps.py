"""Spans of time, and piecewise constant functions of time."""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from operator import itemgetter
from typing import Generic, Self, TypeVar

from vlp16emu.units import FOREVER_NS

Span = tuple[int, int]
"""Instants of the begin and after the end."""
_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class Spans:
    """Separate spans of time, in order; a query takes the logarithm of their number."""

    spans: tuple[Span, ...] = ()

    @classmethod
    def union(cls, spans: Iterable[Span]) -> Self:
        """Return the union of spans, without empty ones."""
        out = list[Span]()
        for begin, end in sorted(span for span in spans if span[0] < span[1]):
            if out and begin <= out[-1][1]:
                out[-1] = out[-1][0], max(end, out[-1][1])
            else:
                out.append((begin, end))
        return cls(tuple(out))

    def __iter__(self) -> Iterator[Span]:
        return iter(self.spans)

    def at(self, t_ns: int) -> Span | None:
        """Return the span that contains an instant; None if there is none."""
        place = bisect_right(self.spans, t_ns, key=itemgetter(0))
        return self.spans[place - 1] if place and t_ns < self.spans[place - 1][1] else None

    def before(self, t_ns: int) -> Span | None:
        """Return the last span that is over at an instant; None if there is none."""
        place = bisect_right(self.spans, t_ns, key=itemgetter(1))
        return self.spans[place - 1] if place else None


NEVER = Spans()


@dataclass(frozen=True, slots=True)
class Steps(Generic[_Value]):
    """A piecewise constant function of time."""

    steps: tuple[tuple[int, _Value], ...]
    """Instants from which values hold, in order, and these values; the first holds at all times before it,
    and of several at one instant the last one."""

    def at(self, t_ns: int) -> _Value:
        """Return the value at an instant."""
        place = bisect_right(self.steps, t_ns, key=itemgetter(0))
        return self.steps[max(place - 1, 0)][1]

    def spans(self) -> Iterator[tuple[int, int, _Value]]:
        """Yield begin, end and value of each step."""
        ends_ns = [begin_ns for begin_ns, _ in self.steps[1:]] + [FOREVER_NS]
        for (begin_ns, value), end_ns in zip(self.steps, ends_ns, strict=True):
            yield begin_ns, end_ns, value

    def where(self, is_wanted: Callable[[_Value], bool]) -> Spans:
        """Return the spans in which the value is wanted."""
        return Spans.union((begin, end) for begin, end, value in self.spans() if is_wanted(value))
