"""Tables from users: lists of stems, waypoints and poses, as written by spreadsheets and statistics programs.

Columns are separated by semicolons, tabs, commas or blanks, and cells may have quotation marks. Unless commas
separate columns, a decimal comma is accepted as well as a point.
"""

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from decimal import Decimal
from difflib import get_close_matches
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from vlp16emu.errors import InputError
from vlp16emu.inputs import read_bytes
from vlp16emu.types import F8
from vlp16emu.units import S_NS

LARGEST = 1e8
"""Upper limit of map coordinates (EPSG:4647, with the zone in front, has 3.4e7 m), with squares far from
overflow."""
_LARGEST_NS = 2**62
_MARKS = (";", "\t", ",", " ")  # column separators; if two fit equally well, the first is taken
_MISSING = frozenset(("", "na", "n/a", "#n/a", "<na>", "nan", "null", "none", "#nv", "non reliable"))
"""Cells without a value, in lower case, as R, pandas, Excel (`#NV` in German) and 3DFin write them."""
_ALIKE = 0.8  # least `difflib` ratio at which an unknown name counts as a misspelt known one


@dataclass(frozen=True, slots=True)
class Column:
    """A column that a table may have."""

    units: Mapping[str, float]
    """Possible names in lower case, each with the factor to the unit of returned values."""
    low: float = -LARGEST
    high: float = LARGEST
    """Limits in the unit of returned values: beyond them a wrong unit is more likely."""
    is_needed: bool = True  # True if the table must have it
    is_filled: bool = True  # True if each row must have a value
    zero_is_missing: bool = False  # True if 0 means that there is no value


def optional(*names: str) -> Column:
    """Column that may be missing, and whose cells may be empty."""
    return Column(dict.fromkeys(names, 1.0), is_needed=False, is_filled=False)


@dataclass(slots=True)
class Table:
    """Cells of a file by column; errors name file, line and column.

    Parameters
    ----------
    path : path of the file, for messages
    error : class of error for a wrong cell
    columns : columns by the caller's names
    names : names of columns in the file, without missing columns
    lines : (n,) line of each row, from 1
    cells : (n,) texts of each column in `names`; empty for a missing value
    """

    path: Path
    error: type[InputError]
    columns: Mapping[str, Column]
    names: Mapping[str, str]
    lines: list[int]
    cells: Mapping[str, list[str]]
    _has_commas: bool
    _decimal: str = field(default="", init=False)

    def __len__(self) -> int:
        return len(self.lines)

    def where(self, row: int, column: str = "") -> str:
        """Return the location of a row, or of a cell, for messages."""
        name = self.names.get(column)
        return f"{self.path}, line {self.lines[row]}" + (f", column {name}" if name else "")

    def texts(self, column: str) -> list[str]:
        """Return the cells of a column (n,); empty if a value is missing."""
        cells = [
            "" if cell.lower() in _MISSING else cell for cell in self.cells.get(column, [""] * len(self))
        ]
        if self.columns[column].is_filled and "" in cells:
            found = self.cells[column][row := cells.index("")]
            raise self.error(self.where(row, column), f"found {found}" if found else "nothing", "a value")
        return cells

    def numbers(self, *columns: str) -> F8:
        """Return columns of numbers (n, c), or a single one (n,); NaN if a value is missing."""
        table = np.full((len(self), len(columns)), np.nan)
        for place, column in enumerate(columns):
            for row, cell in enumerate(self.cells.get(column, ())):
                table[row, place] = self._number(row, column, cell)
        return table if len(columns) > 1 else table[:, 0]

    def times_ns(self, column: str) -> list[int]:
        """Return times in seconds as nanoseconds (n,), with all digits.

        Numbers of float64 would keep UTC to a microsecond only.
        """
        times_ns = []
        for row, cell in enumerate(self.cells[column]):
            try:  # `Decimal` alone would allow underscores
                t_ns = Decimal(self._with_point(row, column, cell).replace("_", "?")).scaleb(9)
            except ArithmeticError:
                raise self.error(self.where(row, column), f"found {cell!r}", "a time in seconds") from None
            if not t_ns.is_finite() or abs(t_ns) > _LARGEST_NS:
                raise self.error(self.where(row, column), f"found {cell}", f"at most {_LARGEST_NS // S_NS} s")
            times_ns.append(int(t_ns.to_integral_value()))
        return times_ns

    def _number(self, row: int, column: str, cell: str) -> float:
        units = self.columns[column].units
        low = self.columns[column].low
        high = self.columns[column].high
        factor = units[self.names[column]]
        expected = "a number" if high == LARGEST else f"a number from {low / factor:g} to {high / factor:g}"
        if cell.lower() in _MISSING:
            if self.columns[column].is_filled:
                raise self.error(self.where(row, column), f"found {cell}" if cell else "nothing", expected)
            return math.nan
        number = _float(self._with_point(row, column, cell))
        if math.isnan(number):
            has_unit = not math.isnan(_float(cell.partition(" ")[0].replace(",", ".")))
            raise self.error(
                self.where(row, column), f"found {cell!r}", expected + " without a unit" * has_unit
            )
        if number == 0 and self.columns[column].zero_is_missing:
            return math.nan
        if not low <= number * factor <= high:
            meant = "".join(f"; is it {name}?" for name in units if low <= number * units[name] <= high)
            limit = f" of at most {LARGEST:g}" if high == LARGEST else ""
            raise self.error(self.where(row, column), f"found {cell}", expected + limit + meant)
        return number * factor

    def _with_point(self, row: int, column: str, cell: str) -> str:
        """Return a number with a decimal point.

        A table has one decimal mark, as the other one may group thousands.
        """
        marks = {mark for mark in ".," if mark in cell} | {*self._decimal}
        if self._has_commas and marks == {","}:
            expected = "a decimal point; decimal commas need ; or a tab between columns"
            raise self.error(self.where(row, column), f"found {cell!r}", expected)
        if len(marks) > 1 or (self._has_commas and "," in marks):
            raise self.error(
                self.where(row, column), f"found {cell!r}", "one decimal mark, and none between thousands"
            )
        self._decimal = "".join(marks)
        return cell.replace(",", ".")


def read_table(
    path: Path,
    columns: Mapping[str, Column],
    expected: str,
    error: type[InputError],
    *,
    has_header: bool = True,
) -> Table:
    """Read a table of UTF-8 text.

    The header has the columns in any order and case; other columns are ignored. It may have one name less
    than rows have cells, as R writes it with row names. Without a header, rows have all columns in order.
    Lines that are empty or begin with `#` are ignored.

    Parameters
    ----------
    columns : columns by the caller's names
    expected : description of the file, for messages
    error : class of error for a wrong file, header or cell
    """
    content = read_bytes(path, expected, error)
    lines = _decode(path, content, error).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    records = partial(_records, path, lines, expected, error)
    if has_header:
        layout = _layout_of_header(path, records, columns, expected, error)
        if lines[layout.header - 1].lstrip().startswith("#"):
            layout = replace(layout, mark=_mark_of_rows(records, layout))
    else:
        layout = _layout_of_rows(records, columns)
    rows = [row for row in records(layout.mark) if row[0] > layout.header and not row[1][0].startswith("#")]
    if rows and has_header and len(rows[0][1]) == len(layout.names) + 1 and rows[0][1][-1]:
        layout = replace(layout, names=["", *layout.names])  # the column of row names has no name
    for line, cells in rows:
        if fault := layout.fault_of(cells, expected):
            raise error(f"{path}, line {line}", f"found {len(cells)} cells", fault)
    places = {column: layout.names.index(name) for column, name in layout.called.items()}
    cells_of = {column: [cells[place] for _, cells in rows] for column, place in places.items()}
    line_of = [line for line, _ in rows]
    return Table(path, error, columns, layout.called, line_of, cells_of, _has_commas=layout.mark == ",")


@dataclass(frozen=True)
class _Layout:
    """How the rows of a file are cut into columns.

    Parameters
    ----------
    mark : separator of columns
    header : line of the header, from 1; 0 if there is none
    names : names of all columns in the file
    called : name in the file by the caller's name, for the columns that are read
    """

    mark: str
    header: int
    names: Sequence[str]
    called: Mapping[str, str]

    @cached_property
    def _needed(self) -> int:
        """Least number of cells of a row."""
        return 1 + max(map(self.names.index, self.called.values()))

    def fault_of(self, cells: Sequence[str], expected: str) -> str:
        """Return what is expected of a row that has too few cells or too many; empty if it is right."""
        # Excel leaves out cells at the ends of rows that are empty for long (Microsoft KB 77295).
        if len(cells) >= self._needed and not any(cells[len(self.names) :]):
            return ""
        as_in = f", as in line {self.header}" if self.header else f": {expected}"
        is_cut = self.mark == "," and len(cells) > self._needed
        hint = "; decimal commas need ; or a tab between columns" if is_cut else ""
        return f"{len(self.names)}{as_in}{hint}"


_Records = Callable[[str], Iterator[tuple[int, list[str]]]]
"""Line and cells of the records of a file whose columns a separator is taken to separate."""


def _layout_of_header(
    path: Path, records: _Records, columns: Mapping[str, Column], expected: str, error: type[InputError]
) -> _Layout:
    """Return the layout with which most columns of the header are known."""
    known = {name for column in columns.values() for name in column.units}
    headers = {mark: _header(records(mark), known) for mark in _MARKS}
    mark = max(_MARKS, key=lambda mark: len(known & {*headers[mark][1]}))
    first, names = headers[mark]
    if not known & {*names}:  # a file of another kind is not quoted
        raise error(f"{path}, line 1", "none of the columns", expected)
    return _Layout(mark, first, names, _columns_of(names, columns, f"{path}, line {first}", error))


def _layout_of_rows(records: _Records, columns: Mapping[str, Column]) -> _Layout:
    """Return the layout of a file without header, with which its first row has all columns."""
    for mark in _MARKS:
        _, cells = _header(records(mark), frozenset())
        if len(cells) == len(columns) and not any(" " in cell for cell in cells):
            break
    else:
        mark = " "
    return _Layout(mark, 0, list(columns), {name: name for name in columns})


def _records(
    path: Path, lines: Sequence[str], expected: str, error: type[InputError], mark: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield line and cells of each non-empty record."""
    if mark == " ":
        lines = [" ".join(line.split()) for line in lines]
    reader = csv.reader(lines, delimiter=mark, skipinitialspace=True)
    try:
        for cells in reader:
            if any(stripped := [cell.strip() for cell in cells]):
                yield reader.line_num, stripped
    except csv.Error as fault:
        where = f"{path}, line {reader.line_num}"
        raise error(where, str(fault), f"{expected}, with each quotation mark closed") from None


def _mark_of_rows(records: _Records, layout: _Layout) -> str:
    """Return the separator of the rows below a header of `numpy.savetxt`, which may have another."""
    for mark in (layout.mark, *_MARKS):
        row = next((cells for line, cells in records(mark) if line > layout.header), [])
        if len(row) == len(layout.names):
            return mark
    return layout.mark


def _header(records: Iterator[tuple[int, list[str]]], known: AbstractSet[str]) -> tuple[int, list[str]]:
    """Return line and names of the first record with a known name.

    Without one, it is the first that is no comment and no separator for Excel.
    """
    for line, (first, *others) in records:
        names = [name.lower() for name in (first.lstrip("# "), *others)]  # numpy.savetxt begins it with #
        if first == "#":  # between blanks it is a cell of its own
            names = names[1:]
        if known & {*names} or not first.lower().startswith(("#", "sep=")):
            return line, names
    return 0, []


def _columns_of(
    names: Sequence[str], columns: Mapping[str, Column], where: str, error: type[InputError]
) -> dict[str, str]:
    """Return the header's name for each of the caller's columns that it has."""
    called = dict[str, str]()
    for column, of in columns.items():
        found = [name for name in names if name in of.units]
        if len(found) > 1:
            raise error(where, f"found {' and '.join(found)}", f"one of {' or '.join(of.units)}")
        if not found and of.is_needed:
            raise error(where, f"no column {' or '.join(of.units)}", f"it among {', '.join(names)}")
        if found:
            called[column] = found[0]
    absent = [name for column in columns.keys() - called.keys() for name in columns[column].units]
    known = {name for of in columns.values() for name in of.units}
    for name in names:
        if name not in known and (alike := get_close_matches(name, absent, 1, _ALIKE)):
            raise error(where, f"unknown column {name!r}", f"{alike[0]}, the nearest, or a name unlike it")
    return called


def _decode(path: Path, content: bytes, error: type[InputError]) -> str:
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise error(str(path), "is UTF-16 text", "UTF-8 (in Excel: save as CSV UTF-8)")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        line = content.count(b"\n", 0, fault.start) + 1
        byte = content[fault.start : fault.start + 1]
        found = f"no UTF-8 text: byte {byte.hex()}, in Windows-1252 '{byte.decode('cp1252', 'replace')}'"
        raise error(f"{path}, line {line}", found, "UTF-8 (in Excel: save as CSV UTF-8)") from None


def _float(text: str) -> float:
    """Parse a number as files write it, NaN if it is none; Python's own syntax would allow underscores."""
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan
