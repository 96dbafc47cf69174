"""A run straight into a bag."""

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from vlp16emu.bag.of_capture import write_bag
from vlp16emu.errors import OutputError, RunError
from vlp16emu.run.options import TruthTo
from vlp16emu.run.record import Recording
from vlp16emu.sinks.bag import check_bag


def record_bag(path: Path, truth: TruthTo | None, record: Callable[[Path, TruthTo], Recording]) -> Recording:
    """Record a run as a bag, by way of a capture in a hidden folder beside it; what was recorded until a stop is in it.

    Parameters
    ----------
    path : as `BagFile` takes it
    truth : where the truth stays; it is in the bag in any case
    record : writes a capture and its truth

    Raises
    ------
    OutputError, MissingExtraError
        as `BagFile`
    RunError
        where the disk is full; the capture so far is kept, under the name of the bag
    """
    check_bag(path)
    try:
        beside = tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise OutputError(str(path), str(error.strerror), "a place that can be written") from error
    with beside as folder:
        capture, to = Path(folder) / "run.pcap", truth or TruthTo(Path(folder) / "truth")
        try:
            recording = record(capture, to)
            made = write_bag(capture, path, to.folder)
        except RunError as error:
            if capture.exists():
                capture.replace(kept := path.with_suffix(".pcap"))
                raise RunError(f"{error}; its packets are in {kept}") from error
            raise
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return replace(
        recording,
        file=str(path),
        bytes=sum(file.stat().st_size for file in files),
        sha256=", ".join(_sha256(file) for file in files),
        messages=made.messages,
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
