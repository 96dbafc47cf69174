"""A dataset from its file to its manifest: what is missing is made, here or on a cluster."""

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from vlp16emu.dataset.layouts import LAYOUTS, walk_folder
from vlp16emu.dataset.spec import DatasetWalk
from vlp16emu.emulator import Emulator
from vlp16emu.errors import MissingExtraError, OutputError, RunError
from vlp16emu.output import OutputFile, lock

__all__ = ["DatasetResult", "make_dataset"]

_RECORDS = ".records"
_PART = ".part"
_DEATHS = 10
"""Workers that may die over one walk before the walk is held to be the cause."""


@dataclass(frozen=True, slots=True)
class DatasetResult:
    """What a run made of a dataset."""

    manifest: str
    sha256: str
    """Of the manifest."""
    walks: int
    made: int
    """Walks that were not there before."""
    bytes: int
    """Of all files of all walks."""


def make_dataset(
    walks: Sequence[DatasetWalk],
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> DatasetResult:
    """Make the walks of a dataset that are not there yet, and its manifest.

    A walk is there when its record is, and its files have the sizes and sha256 that the record gives.

    Parameters
    ----------
    out : folder, new or of an earlier run; workers of a scheduler see it under the same path
    workers : processes on this machine; 0 is this process alone, which needs no Dask; one per core if left out
    scheduler : address of a Dask scheduler, instead of processes on this machine
    progress : called with the simulated seconds so far, walk by walk

    Raises
    ------
    OutputError
        where the folder cannot be written, or another run writes it
    MissingExtraError
        where Dask is wanted and not installed
    RunError
        where a walk fails, or workers die over one walk again and again
    """
    out = out.absolute()
    with _folder(out):
        there = {walk.number for walk in walks if _is_there(walk, out)}
        missing = [walk for walk in walks if walk.number not in there]
        done_s = sum(walk.scenario.duration_s for walk in walks if walk.number in there)
        progress(done_s)
        run = _here if workers == 0 and scheduler is None else _on_dask
        for walk in run(missing, out, workers, scheduler) if missing else ():
            done_s += walk.scenario.duration_s
            progress(done_s)
        entries = [_read(out / _RECORDS / f"{walk.number}.json") for walk in walks]
        text = json.dumps({"written_by": _written_by(), "walks": entries}, indent=2) + "\n"
        _write(out / "manifest.json", text)
    return DatasetResult(
        manifest=str(out / "manifest.json"),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
        walks=len(walks),
        made=len(missing),
        bytes=sum(file["bytes"] for entry in entries for file in entry["files"]),
    )


@contextmanager
def _folder(out: Path) -> Iterator[None]:
    """Keep other runs off the folder, without what walks that were not finished have left."""
    with ExitStack() as stack:
        try:
            (out / _RECORDS).mkdir(parents=True, exist_ok=True)
            opened = os.open(out / _RECORDS, os.O_RDONLY)
        except OSError as error:
            raise OutputError(str(out), str(error.strerror), "a folder that can be written") from None
        stack.callback(os.close, opened)
        lock(opened, str(out))
        _sweep(out)
        yield
        _sweep(out)


def _sweep(out: Path) -> None:
    """Remove what walks that were not finished have left."""
    for left in out.glob(f"*/*{_PART}"):
        shutil.rmtree(left, ignore_errors=True)


def _here(
    walks: Sequence[DatasetWalk], out: Path, _workers: int | None, _scheduler: str | None
) -> Iterator[DatasetWalk]:
    """Make walks in this process."""
    for walk in walks:
        _make(walk, out, threads=0)
        yield walk


def _on_dask(
    walks: Sequence[DatasetWalk], out: Path, workers: int | None, scheduler: str | None
) -> Iterator[DatasetWalk]:
    """Make walks on the workers of a scheduler, or in processes of this machine; a walk whose worker dies is made again."""
    try:
        import dask

        dask.config.set({"logging.distributed": "critical"})  # read once, when distributed is imported
        from distributed import Client, KilledWorker, LocalCluster, as_completed
    except ImportError:
        raise MissingExtraError("distributed", "cluster", "a dataset made by more than one process") from None
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": _DEATHS}))
        try:
            address = (
                scheduler
                or stack.enter_context(
                    LocalCluster(
                        n_workers=workers or os.cpu_count(),
                        threads_per_worker=1,
                        host="127.0.0.1",
                        dashboard_address="127.0.0.1:0",  # of what serves the health of the scheduler, at a free port
                        scheduler_kwargs={"dashboard": False},
                    )
                )
            )
            client = stack.enter_context(Client(address))
        except (OSError, ValueError) as error:
            raise RunError(f"{scheduler or 'local cluster'}: {error}") from None
        futures = {client.submit(_make, walk, out, threads=1, pure=False): walk for walk in walks}
        try:
            for future in as_completed(futures):
                future.result()
                yield futures[future]
        except KilledWorker as error:
            raise RunError(f"{error.allowed_failures + 1} workers died over one walk") from None


def _make(walk: DatasetWalk, out: Path, *, threads: int) -> None:
    """Write the files of a walk, and then its record."""
    final = out / walk_folder(walk.layout, walk.number)
    try:
        final.parent.mkdir(exist_ok=True)
        part = Path(tempfile.mkdtemp(_PART, f"{final.name}.", final.parent))
        part.chmod(0o755)
        emulator = Emulator(walk.scenario, threads=threads)
        LAYOUTS[walk.layout](emulator, part)
        entry = _identity(walk) | {
            "beams": len(emulator.parts.units[0].head.beams.elevation_deg),
            "files": [_described(path, part) for path in sorted(part.rglob("*")) if path.is_file()],
        }
        shutil.rmtree(final, ignore_errors=True)
        part.rename(final)
    except OSError as error:
        raise RunError(f"walk {walk.name}: {error.strerror}; what is made so far is kept") from None
    _write(out / _RECORDS / f"{walk.number}.json", json.dumps(entry))


def _identity(walk: DatasetWalk) -> dict[str, Any]:
    """All that decides the bytes of a walk."""
    tree = walk.scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    return {
        "name": walk.name,
        "folder": walk_folder(walk.layout, walk.number),
        "split": walk.split,
        "stand": walk.stand,
        "seed": walk.scenario.seed,
        "path": walk.path,
        "sensor": walk.sensor,
        "layout": walk.layout,
        "written_by": _written_by(),
        "scenario_sha256": hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest(),
    }


def _is_there(walk: DatasetWalk, out: Path) -> bool:
    """Whether all files of a walk are as its record says, and its record as this run would write it."""
    try:
        entry = _read(out / _RECORDS / f"{walk.number}.json")
        folder = out / entry["folder"]
        found = [_described(path, folder) for path in sorted(folder.rglob("*")) if path.is_file()]
    except (OSError, ValueError, KeyError):
        return False
    return entry["files"] == found and entry.items() >= _identity(walk).items()


def _described(path: Path, folder: Path) -> dict[str, Any]:
    """Name, size and sha256 of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"path": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size, "sha256": digest}


def _written_by() -> str:
    """Program and version."""
    return f"vlp16emu {version('vlp16emu')}"


def _read(path: Path) -> dict[str, Any]:
    """Read a record."""
    tree: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return tree


def _write(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with OutputFile(path) as file, file.writing() as opened:
        opened.write(text.encode())
