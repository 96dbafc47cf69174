"""Comparison of the output that a document shows with the output that its commands print."""

import re
from itertools import zip_longest

TIMES = ("run time", "ran at")
"""Rows whose value depends on the machine; all other rows are functions of the scene and its seed."""
_TIME = re.compile(rf"(  (?:{'|'.join(TIMES)}) {{2,}})\S.*")


def shown_block(document, first):
    """Return the indented block of a document whose first line is `first`, without its indent."""
    lines = document.splitlines()
    start = lines.index(f"    {first}")
    stop = next(i for i in range(start, len(lines)) if not lines[i].startswith("    "))
    return "\n".join(line.removeprefix("    ") for line in lines[start:stop])


def differences(shown, printed):
    """Return pairs of shown and printed lines that differ in more than a time, as text."""
    pairs = zip_longest(shown.splitlines(), printed.splitlines(), fillvalue="no line")
    return [f"{a!r} in the document, {b!r} printed" for a, b in pairs if _without_time(a) != _without_time(b)]


def _without_time(line):
    return _TIME.sub(r"\1a time", line)
