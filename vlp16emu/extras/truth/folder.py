"""Folder of ground truth beside a run: text files that grow with it and are readable at any time."""

import ctypes
import json
import os
import re
import shutil
import stat
import weakref
from collections.abc import Collection
from concurrent.futures import CancelledError
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Any, Self

from vlp16emu.errors import InputError, MissingExtraError, OutputError, RunError, readable
from vlp16emu.motion.pose import Kinematics
from vlp16emu.output import claim, final_name, opening, part_beside, spare, take_rights
from vlp16emu.types import Poses
from vlp16emu.units import S_NS

_FILES = re.compile(
    r"(events|gnss|imu)\.csv|(rig|scenario|time)\.json|(packets|trajectory)(_\d+)?\.tum"
    r"|returns(_\d+)?\.parquet"
)  # names of all files of a run
# arguments of renameat2(2). Source: linux/fcntl.h and linux/fs.h.
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


class TruthFolder:
    """A folder for the ground truth of one run; a context manager.

    It is created as NAME.xxxxxxxx.part, at `path`, and its files grow there. At the end it gets its name in
    one step, like an `OutputFile`: an earlier folder of this name is unchanged until then and is then
    replaced as a whole. After an error the samples so far stay in `path`.

    Parameters
    ----------
    path : new, empty, or with only the ground truth of an earlier run; missing parents are created
    inputs : files that the run itself reads

    Raises OutputError if the folder cannot be created, contains other files or one of the inputs, or another
    run writes it.
    """

    def __init__(self, path: Path, inputs: Collection[Path] = ()) -> None:
        self._where = str(path)
        with opening(self._where, "a folder that can be written"):
            self._final = final_name(path)
            if self._final.is_mount() or self._final == Path.cwd():  # these cannot be renamed, or must not be
                raise OutputError(self._where, "is a mount point or the working folder", "a folder in it")
            self._check()
            for file in self._final.iterdir() if self._final.exists() else ():
                spare(inputs, file)
            self._final.parent.mkdir(parents=True, exist_ok=True)
            self.path = part_beside(self._final)
            self.path.mkdir()
            opened = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            self._close = weakref.finalize(self, os.close, opened)
            try:
                claim(opened, self.path, self._final, self._where)
            except (OutputError, OSError):
                self.path.rmdir()
                self._close()
                raise
            if self._final.exists():
                take_rights(opened, self._final.stat())
        self._files: dict[str, FileIO] = {}
        self._failed: RunError | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        for file in self._files.values():
            file.close()
        try:
            if (error is None and not self._failed) or isinstance(error, KeyboardInterrupt):
                self._keep()
            elif isinstance(error, InputError | MissingExtraError | CancelledError):
                shutil.rmtree(self.path, ignore_errors=True)
        finally:
            self._close()

    def append(self, name: str, text: str) -> None:
        """Append whole lines to a file and pass them to the operating system.

        Raises RunError if that fails; the lines so far stay, and nothing more is written.
        """
        if self._failed:
            raise self._failed
        try:
            if name not in self._files:
                self._files[name] = (self.path / name).open("xb", buffering=0)
            _append(self._files[name], text.encode())
        except OSError as error:
            self._failed = RunError(f"{self.path / name}: {error.strerror}; it ends with a whole line")
            raise self._failed from error

    def _keep(self) -> None:
        try:
            self._check()
            if self._final.exists():
                _exchange(self.path, self._final)
                with suppress(
                    OSError
                ):  # files of the earlier run that cannot be removed stay beside the new folder
                    for file in self.path.iterdir():
                        file.unlink()
                    self.path.rmdir()
            else:
                self.path.rename(self._final)
        except (OSError, OutputError) as error:
            found = error.strerror if isinstance(error, OSError) else error.found
            raise RunError(f"{self._where}: {found}; it is left as {self.path}") from error

    def _check(self) -> None:
        if self._final.exists() and (found := _foreign_entry(self._final)) is not None:
            expected = "a new or empty folder, or one with the truth of an earlier run"
            raise OutputError(self._where, f"holds {found}", expected)


def read_json(path: Path, expected: str) -> Any:
    """Read a JSON file of a folder with ground truth; InputError if it cannot be read or is no JSON."""
    with readable(path, expected, InputError):
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise InputError(str(path), "no JSON", expected) from None


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


def seconds_text(t_ns: int) -> str:
    """Return an instant in seconds with all nine decimals, which a float cannot represent."""
    return f"{t_ns // S_NS}.{t_ns % S_NS:09d}"


def tum_rows(poses: Poses | Kinematics) -> str:
    """Return poses as lines `t x y z qx qy qz qw` of the TUM RGB-D benchmark, qw never negative.

    UTC seconds, metres, and the rotation from body axes to world axes.
    """
    from scipy.spatial.transform import Rotation  # here: the import takes 0.1 s, and few runs need it

    quaternions = Rotation.from_matrix(poses.world_R_body).as_quat(canonical=True)
    lines = [
        f"{seconds_text(t_ns)} {x:.9f} {y:.9f} {z:.9f} {qx:.12f} {qy:.12f} {qz:.12f} {qw:.12f}\n"
        for t_ns, (x, y, z), (qx, qy, qz, qw) in zip(
            poses.t_ns.tolist(), poses.world_p_body_m.tolist(), quaternions.tolist(), strict=True
        )
    ]
    return "".join(lines)


def _foreign_entry(folder: Path) -> str | None:
    """Return the name of an entry that no run writes, if any; a folder without the scenario of an earlier run is not ours."""
    present = sorted(folder.iterdir())
    strange = [
        file for file in present if not _FILES.fullmatch(file.name) or not stat.S_ISREG(file.lstat().st_mode)
    ]
    tree = None
    with suppress(OSError, ValueError):
        tree = json.loads((folder / "scenario.json").read_text(encoding="utf-8"))
    if not strange and not (isinstance(tree, dict) and "written_by" in tree):
        strange = present
    return strange[0].name if strange else None


def _exchange(one: Path, other: Path) -> None:
    """Swap two names in one step, or in three on a file system that cannot."""
    swap = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if swap and swap(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return
    aside = part_beside(other)
    other.rename(aside)
    try:
        one.rename(other)
    except OSError:
        aside.rename(other)
        raise
    aside.rename(one)
