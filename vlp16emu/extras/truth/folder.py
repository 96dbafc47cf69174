"""Folder of ground truth beside a run: files that grow with it and are readable at any time."""

import os
import re
import stat
from collections.abc import Collection, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from io import BytesIO, FileIO
from pathlib import Path
from typing import Self

import numpy as np
from numpy.lib.format import dtype_to_descr, write_array_header_1_0

from vlp16emu.errors import InputError, MissingExtraError, OutputError, RunError
from vlp16emu.extras.truth.description import read_json
from vlp16emu.extras.truth.tables import Rows, Table
from vlp16emu.output import Staged, final_name, opening, spare

_FILES = re.compile(
    r"events\.csv|(gnss|imu)\.(csv|npy)|(rig|scenario|time)\.json|(packets|trajectory)(_\d+)?\.(tum|npy)"
    r"|returns(_\d+)?\.parquet"
)  # names of all files of a run


class TruthFolder:
    """A folder for the ground truth of one run; a context manager.

    It is `Staged`, and its files grow at `path`. At the end it replaces the folder of an earlier run as a
    whole. After an error the samples so far stay in `path`.

    Parameters
    ----------
    path : new, empty, or with only the ground truth of an earlier run; missing parents are created
    inputs : files that the run itself reads

    Raises OutputError if the folder cannot be created, contains other files or one of the inputs, or another
    run writes it.
    """

    def __init__(self, path: Path, inputs: Collection[Path] = ()) -> None:
        self._where = str(path)
        self._inputs = inputs
        self._files: dict[str, FileIO] = {}
        self._rows: dict[str, int] = {}
        self._failed: RunError | None = None
        with opening(self._where, "a folder that can be written"):
            final_name(path).parent.mkdir(parents=True, exist_ok=True)
            self._staged = Staged(path, self._where, self._check, is_folder=True)
        self.path = self._staged.path

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        for file in self._files.values():
            file.close()
        if (error is None and not self._failed) or isinstance(error, KeyboardInterrupt):
            self._staged.keep()
        elif isinstance(error, InputError | MissingExtraError | CancelledError):
            self._staged.discard()
        else:
            self._staged.leave()

    def append(self, name: str, text: str) -> None:
        """Append whole lines to a file and pass them to the operating system.

        Raises RunError if that fails; the lines so far stay, and nothing more is written.
        """
        with self._open_file(name, "line") as file:
            _append(file, text.encode())

    def begin_rows(self, name: str, table: Table) -> None:
        """Begin NAME.npy and its text; errors of `append`."""
        self._rows[name] = 0
        self.append(f"{name}{table.suffix}", table.header)
        self.append_rows(name, table, np.zeros(0, table.dtype))

    def append_rows(self, name: str, table: Table, rows: Rows) -> None:
        """Append rows to NAME.npy and lines to its text; errors of `append`.

        Both are readable at any time: the header of NAME.npy counts whole rows.
        """
        self.append(f"{name}{table.suffix}", table.text(rows))
        before = self._rows[name]
        count = before + len(rows)
        header = BytesIO()  # of one length for any number of rows: numpy leaves room for it
        fields = {"descr": dtype_to_descr(table.dtype), "fortran_order": False, "shape": (count,)}
        write_array_header_1_0(header, fields)
        with self._open_file(f"{name}.npy", "row") as file:
            _write_at(file, rows.tobytes(), len(header.getvalue()) + before * rows.itemsize)
            _write_at(file, header.getvalue(), 0)
        self._rows[name] = count

    @contextmanager
    def _open_file(self, name: str, unit: str) -> Iterator[FileIO]:
        if self._failed:
            raise self._failed
        try:
            if name not in self._files:
                self._files[name] = (self.path / name).open("xb", buffering=0)
            yield self._files[name]
        except OSError as error:
            self._failed = RunError(f"{self.path / name}: {error.strerror}; it ends with a whole {unit}")
            raise self._failed from error

    def _check(self, final: Path) -> None:
        """Refuse an existing folder with other files than those of an earlier run, or with an input."""
        if not final.exists():
            return
        if (found := _foreign_entry(final)) is not None:
            expected = "a new or empty folder, or one with the truth of an earlier run"
            raise OutputError(self._where, f"holds {found}", expected)
        for file in final.iterdir():
            spare(self._inputs, file)


def _append(file: FileIO, lines: bytes) -> None:
    """Append lines; if that fails, or is interrupted, the file ends with a whole line."""
    begin = file.tell()
    written = 0
    try:
        while written < len(lines):  # a full disk takes the bytes that fit and refuses the next one
            written += file.write(lines[written:])
    except BaseException:
        with suppress(OSError):  # a device cannot be truncated
            there = os.fstat(file.fileno()).st_size - begin
            file.seek(begin + lines.rfind(b"\n", 0, there) + 1)
            file.truncate()
        raise


def _write_at(file: FileIO, data: bytes, at: int) -> None:
    while data:  # a full disk takes the bytes that fit and refuses the next one
        written = os.pwrite(file.fileno(), data, at)
        data = data[written:]
        at += written


def _foreign_entry(folder: Path) -> str | None:
    """Return the name of an entry that no run writes; None if there is none.

    All entries are foreign in a folder without the scenario of an earlier run.
    """
    present = sorted(folder.iterdir())
    strange = [
        file for file in present if not _FILES.fullmatch(file.name) or not stat.S_ISREG(file.lstat().st_mode)
    ]
    tree = None
    with suppress(InputError):
        tree = read_json(folder / "scenario.json", "the scenario of an earlier run")
    if not strange and not (isinstance(tree, dict) and "written_by" in tree):
        strange = present
    return strange[0].name if strange else None
