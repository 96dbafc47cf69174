"""Truth beside a run: a folder of text files that grow with it and are readable at any time."""

import json
import os
import re
import weakref
from collections.abc import Collection, Mapping
from contextlib import ExitStack, suppress
from io import FileIO
from pathlib import Path
from typing import Any, Self

from vlp16emu.errors import OutputError, RunError, spare
from vlp16emu.output import lock, write_json
from vlp16emu.types import Poses
from vlp16emu.units import S_NS

_FILES = re.compile(
    r"(events|gnss|imu)\.csv|(rig|scenario|time)\.json(\.part)?|(packets|trajectory)(_\d+)?\.tum"
    r"|returns(_\d+)?\.parquet(\.part)?"
)
"""All that a run may write; those of an earlier run are replaced as a whole."""


class TruthFolder:
    """A folder for the truth of one run; a context manager.

    Parameters
    ----------
    path : new, empty, or with nothing in it but the truth of an earlier run, which is then removed
    inputs : files that the run itself reads

    Raises
    ------
    OutputError
        If the folder cannot be made, holds something else or one of the inputs, or another run writes into it
    """

    def __init__(self, path: Path, inputs: Collection[Path] = ()) -> None:
        self.path = path
        self._files: dict[str, FileIO] = {}
        self._failed: RunError | None = None
        self._open = ExitStack()
        try:
            path.mkdir(parents=True, exist_ok=True)
            opened = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
            self._open.callback(weakref.finalize(self, os.close, opened))
            lock(opened, str(path))
            present = sorted(path.iterdir())
            strange = [file.name for file in present if not _FILES.fullmatch(file.name)]
            if not strange and present and not _told_by_us(path / "scenario.json"):
                strange = [present[0].name]
            if strange:
                expected = "a new or empty folder, or one with the truth of an earlier run"
                raise OutputError(str(path), f"holds {strange[0]}", expected)
            for file in present:
                spare(inputs, file)
            for file in present:
                file.unlink()
        except OSError as error:
            raise OutputError(str(path), str(error.strerror), "a folder that can be written") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def append(self, name: str, text: str) -> None:
        """Add whole lines to a file and hand them to the operating system.

        Where they cannot all be written those that fit stay, nothing more is written, and it is a `RunError`.
        """
        if self._failed:
            raise self._failed
        try:
            if name not in self._files:
                self._files[name] = self._open.enter_context((self.path / name).open("wb", buffering=0))
            _append(self._files[name], text.encode())
        except OSError as error:
            self._failed = RunError(f"{self.path / name}: {error.strerror}; it ends with a whole line")
            raise self._failed from error

    def write_json(self, name: str, tree: Mapping[str, Any]) -> None:
        """Write a whole file, in place of the one that is there; `RunError` if it cannot be written."""
        write_json(self.path / name, tree)


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


def tum_rows(poses: Poses) -> str:
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


def _told_by_us(path: Path) -> bool:
    """Whether a file is the scenario of an earlier run, without which a folder of such names is somebody else's."""
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(tree, dict) and "written_by" in tree
