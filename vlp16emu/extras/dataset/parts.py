"""The folder in which a run makes walks before they take their places."""

import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree

from vlp16emu.errors import InputError
from vlp16emu.inputs import read_text
from vlp16emu.output import opening

PARTS = ".vlp16emu.parts"
"""Folder within the dataset in which walks are made, in a folder of each run."""
_RUN = re.compile("run-[0-9a-f]{16}")  # folder of a run; a run that is killed leaves it
_MARK = "mark"  # file with the name of the folder: a folder without it is not ours


@contextmanager
def parts_of_run(out: Path) -> Iterator[Path]:
    """Make a folder in which walks are made, and remove it at the end; first remove those of killed runs."""
    parts = out / PARTS
    with opening(str(parts), "a folder that can be written"):
        parts.mkdir(exist_ok=True)
        for old in parts.iterdir():
            if _RUN.fullmatch(old.name) and not old.is_symlink() and is_marked(old):
                rmtree(old, ignore_errors=True)
        made = parts / f"run-{secrets.token_hex(8)}"
        made.mkdir()
        (made / _MARK).write_text(made.name, encoding="ascii")
    try:
        yield made
    finally:
        rmtree(made, ignore_errors=True)
        with suppress(OSError):  # somebody else's files stay
            parts.rmdir()


def is_marked(folder: Path) -> bool:
    """Return True for a folder that a run has made, which a worker on another machine may see, too."""
    try:
        return read_text(folder / _MARK, "the mark of a run", InputError) == folder.name
    except InputError:
        return False
