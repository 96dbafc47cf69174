"""Ground truth beside a run: a folder of text files that grow with it and are readable at any time."""

import json
import os
import re
import stat
from collections.abc import Collection
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Any, Self

from vlp16emu.errors import InputError, MissingExtraError, RunError, readable
from vlp16emu.extras.outputs import OutputFolder
from vlp16emu.motion.pose import Kinematics
from vlp16emu.types import Poses
from vlp16emu.units import S_NS

_FILES = re.compile(
    r"(events|gnss|imu)\.csv|(rig|scenario|time)\.json|(packets|trajectory)(_\d+)?\.tum"
    r"|returns(_\d+)?\.parquet"
)  # names of all files that a run may write


class TruthFolder:
    """A folder for the truth of one run; a context manager.

    Its files grow in `path`, an `OutputFolder`, which takes its name at the end. After an error the samples so far stay in
    `path`, without that name.

    Parameters
    ----------
    path : new, empty, or with nothing in it but the truth of an earlier run, which this one then replaces as a whole
    inputs : files that the run itself reads

    Raises OutputError if the folder cannot be made, holds something else or one of the inputs, or another run writes
    it.
    """

    def __init__(self, path: Path, inputs: Collection[Path] = ()) -> None:
        expected = "a new or empty folder, or one with the truth of an earlier run"
        self._folder = OutputFolder(path, stranger=_stranger, expected=expected, inputs=inputs)
        self.path = self._folder.path
        self._files: dict[str, FileIO] = {}
        self._failed: RunError | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        for file in self._files.values():
            file.close()
        if (error is None and not self._failed) or isinstance(error, KeyboardInterrupt):
            self._folder.keep()
        elif not isinstance(error, InputError | MissingExtraError):
            self._folder.leave()
        self._folder.discard()

    def append(self, name: str, text: str) -> None:
        """Add whole lines to a file and hand them to the operating system.

        If that fails, the lines so far stay, nothing more is written, and it is a `RunError`.
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


def read_json(path: Path, expected: str) -> Any:
    """Read a JSON file of a folder with truth; InputError if it cannot be read or is none."""
    with readable(path, expected, InputError):
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise InputError(str(path), "no JSON", expected) from None


def _append(file: FileIO, lines: bytes) -> None:
    """Add lines; where that fails, or is interrupted, the file ends with a whole one."""
    begin, written = file.tell(), 0
    try:
        while written < len(lines):  # a full disk takes what fits and refuses only the next byte
            written += file.write(lines[written:])
    except BaseException:
        with suppress(OSError):  # a device has no end that could be cut
            there = os.fstat(file.fileno()).st_size - begin
            file.seek(begin + lines.rfind(b"\n", 0, there) + 1)
            file.truncate()
        raise


def seconds_text(t_ns: int) -> str:
    """Write an instant in seconds with all nine decimals, which a float does not hold."""
    return f"{t_ns // S_NS}.{t_ns % S_NS:09d}"


def tum_rows(poses: Poses | Kinematics) -> str:
    """Write poses as lines `t x y z qx qy qz qw` of the TUM RGB-D benchmark, qw never negative.

    UTC seconds, metres, and the rotation that takes coordinates of the body to those of the world.
    """
    from scipy.spatial.transform import Rotation  # here: it takes 0.1 s, and few runs need it

    quaternions = Rotation.from_matrix(poses.world_R_body).as_quat(canonical=True)
    lines = [
        f"{seconds_text(t_ns)} {x:.9f} {y:.9f} {z:.9f} {qx:.12f} {qy:.12f} {qz:.12f} {qw:.12f}\n"
        for t_ns, (x, y, z), (qx, qy, qz, qw) in zip(
            poses.t_ns.tolist(), poses.world_p_body_m.tolist(), quaternions.tolist(), strict=True
        )
    ]
    return "".join(lines)


def _stranger(folder: Path) -> str | None:
    """Name an entry that is none of ours; without the scenario of an earlier run the folder is somebody else's."""
    present = sorted(folder.iterdir())
    strange = [file for file in present if not _FILES.fullmatch(file.name) or not stat.S_ISREG(file.lstat().st_mode)]
    tree = None
    with suppress(OSError, ValueError):
        tree = json.loads((folder / "scenario.json").read_text(encoding="utf-8"))
    if not strange and not (isinstance(tree, dict) and "written_by" in tree):
        strange = present
    return strange[0].name if strange else None
