"""Reading what the user brings to a motion: lines and columns, each error with its line."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from vlp16emu.errors import TrajectoryError, readable

__all__ = ["finite", "named_cells", "words"]


def finite(where: str, text: str) -> float:
    """Read a number that is finite."""
    try:
        number = float(text)
    except ValueError:
        raise TrajectoryError(where, f"found {text!r}", "a number") from None
    if not math.isfinite(number):
        raise TrajectoryError(where, f"found {text}", "a finite number")
    return number


def words(path: Path, count: int, expected: str) -> list[tuple[str, list[str]]]:
    """Where each line stands, and its words; lines that are empty or begin with # are left out.

    Parameters
    ----------
    count : words in a line
    expected : what a line holds

    Raises
    ------
    TrajectoryError
        where the file cannot be read or a line has another number of words
    """
    with readable(path, expected, TrajectoryError):
        text = path.read_text(encoding="utf-8-sig")
    lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells, where = line.split(), f"{path}, line {number}"
        if len(cells) != count:
            raise TrajectoryError(where, f"found {len(cells)} words", expected)
        lines.append((where, cells))
    return lines


def named_cells(
    path: Path, needed: Sequence[str], optional: Sequence[str]
) -> list[tuple[str, dict[str, str]]]:
    """Where each line of a CSV with a header stands, and its cells by the name of their column.

    The delimiter is a semicolon or a tab where the header has one, and a comma otherwise.

    Raises
    ------
    TrajectoryError
        where the file cannot be read, a column is missing, unknown or there twice, or a line has more or
        fewer cells than the header
    """
    expected = f"a CSV with the columns {', '.join(needed)}"
    with readable(path, expected, TrajectoryError), path.open(encoding="utf-8-sig", newline="") as file:
        header = file.readline()
        delimiter = next(mark for mark in ";\t," if mark in header or mark == ",")
        names = [name.strip().lower() for name in next(csv.reader([header], delimiter=delimiter), [])]
        known = [*needed, *optional]
        for name in [*names, *needed]:
            if names.count(name) != 1 or name not in known:
                found = (
                    f"{names.count(name)} columns {name!r}" if name in known else f"unknown column {name!r}"
                )
                raise TrajectoryError(f"{path}, line 1", found, f"each of {', '.join(known)} once")
        reader = csv.reader(file, delimiter=delimiter)
        rows = []
        for cells in reader:
            where = f"{path}, line {reader.line_num + 1}"
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(names):
                raise TrajectoryError(where, f"found {len(cells)} cells", f"{len(names)}, as in line 1")
            rows.append((where, dict(zip(names, (cell.strip() for cell in cells), strict=True))))
    return rows
