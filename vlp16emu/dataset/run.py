"""A dataset from its file to its manifest: what is missing is made, here or on a cluster."""

import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

from vlp16emu.dataset.layouts import LAYOUTS, walk_folder
from vlp16emu.dataset.spec import DatasetWalk
from vlp16emu.emulator import Emulator
from vlp16emu.engine import in_one_world
from vlp16emu.errors import MissingExtraError, OutputError, RunError
from vlp16emu.output import OutputFile, lock
from vlp16emu.scenario import Scenario
from vlp16emu.units import seconds_to_ns

_RECORDS = ".records"
_STRETCHES = ".stretches"
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
    stretch_s: float = 30.0,
    progress: Callable[[float], None] = lambda _: None,
) -> DatasetResult:
    """Make the walks of a dataset that are not there yet, and its manifest.

    A walk is there when its record is, and its files have the sizes and sha256 that the record gives.

    Parameters
    ----------
    out : folder, new or of an earlier run; workers of a scheduler see it under the same path
    workers : processes on this machine; 0 is this process alone, which needs no Dask; one per core if left out
    scheduler : address of a Dask scheduler, instead of processes on this machine
    stretch_s : walks that are longer are made in stretches, which are all that a killed worker or run loses; never changes
        a byte
    progress : called with the simulated seconds so far, stretch by stretch

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
        jobs = [_Job(walk, out, stretch_s) for walk in missing]
        run = _here(jobs) if workers == 0 and scheduler is None else _on_dask(jobs, workers, scheduler)
        for piece_s in run if jobs else ():
            done_s += piece_s
            progress(done_s)
        entries = [_read(out / _RECORDS / f"{walk.number}.json") for walk in walks]
        _LAST.clear()
        text = json.dumps({"written_by": _written_by(), "walks": entries}, indent=2) + "\n"
        _write(out / "manifest.json", text)
        shutil.rmtree(
            out / _STRETCHES, ignore_errors=True
        )  # what is left is of walks that are no longer wanted
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
    for left in out.glob(f"*/*{_PART}"):
        shutil.rmtree(left, ignore_errors=True)


_LAST = list[Emulator]()
"""Of this process, at most one."""


def _emulator(scenario: Scenario, threads: int) -> Emulator:
    if _LAST and not in_one_world(scenario, _LAST[0].scenario):
        _LAST.clear()
    _LAST[:] = [Emulator(scenario, threads=threads, like=next(iter(_LAST), None))]
    return _LAST[0]


@dataclass(frozen=True, slots=True)
class _Job:
    """A walk that is to be made; sent to workers."""

    walk: DatasetWalk
    out: Path
    stretch_s: float

    @property
    def spans_s(self) -> list[tuple[float, float]]:
        """Begin and end of each stretch."""
        end_s = self.walk.scenario.duration_s
        begins_s = [i * self.stretch_s for i in range(math.ceil(end_s / self.stretch_s))]
        return list(pairwise([*begins_s, end_s]))

    def stretch(self, span_s: tuple[float, float]) -> Path:
        """Folder of a stretch, by all that decides its bytes."""
        begin_ns, end_ns = map(seconds_to_ns, span_s)
        return self.out / _STRETCHES / f"{_digest(_identity(self.walk))}.{begin_ns}.{end_ns}"

    def cut(self, span_s: tuple[float, float], threads: int) -> None:
        """Make a stretch, if it is not there yet."""
        if not self.stretch(span_s).exists():
            with self._folder(self.stretch(span_s)) as part:
                LAYOUTS[self.walk.layout].stretch(_emulator(self.walk.scenario, threads), span_s, part)

    def join(self, _cuts: Sequence[None], threads: int) -> None:
        """Write the files of the walk, and then its record; all stretches are there."""
        stretches = [self.stretch(span_s) for span_s in self.spans_s]
        final = self.out / walk_folder(self.walk.layout, self.walk.number)
        emulator = _emulator(self.walk.scenario, threads)
        with self._folder(final) as part:
            LAYOUTS[self.walk.layout].walk(emulator, stretches, part)
            entry = _identity(self.walk) | {
                "beams": len(emulator.parts.units[0].head.beams.elevation_deg),
                "files": [_described(path, part) for path in sorted(part.rglob("*")) if path.is_file()],
            }
        _write(self.out / _RECORDS / f"{self.walk.number}.json", json.dumps(entry))

    def clear(self) -> None:
        """Remove the stretches."""
        for span_s in self.spans_s:
            shutil.rmtree(self.stretch(span_s), ignore_errors=True)

    @contextmanager
    def _folder(self, final: Path) -> Iterator[Path]:
        """Give a folder that takes its name when it is whole."""
        try:
            final.parent.mkdir(exist_ok=True)
            part = Path(tempfile.mkdtemp(_PART, f"{final.name}.", final.parent))
            part.chmod(0o755)
            yield part
            shutil.rmtree(final, ignore_errors=True)
            part.rename(final)
        except OSError as error:
            raise RunError(f"walk {self.walk.name}: {error.strerror}; what is made so far is kept") from None


def _here(jobs: Sequence[_Job]) -> Iterator[float]:
    """Make walks in this process, and give the simulated seconds of each piece."""
    for job in jobs:
        for begin_s, end_s in job.spans_s:
            job.cut((begin_s, end_s), threads=0)
            yield end_s - begin_s
        job.join([], threads=0)
        job.clear()


def _on_dask(jobs: Sequence[_Job], workers: int | None, scheduler: str | None) -> Iterator[float]:
    """Make walks on the workers of a scheduler, or in processes of this machine, and give the simulated seconds of each piece.

    A piece whose worker dies is made again.
    """
    with _client(workers, scheduler) as client:
        from distributed import KilledWorker, as_completed

        piece_s: dict[Any, float] = {}
        joins: dict[Any, tuple[_Job, list[Any]]] = {}
        for job in jobs:
            cuts = [client.submit(job.cut, span_s, threads=1, pure=False) for span_s in job.spans_s]
            piece_s |= {cut: end_s - begin_s for cut, (begin_s, end_s) in zip(cuts, job.spans_s, strict=True)}
            join = client.submit(job.join, cuts, threads=1, pure=False)
            piece_s[join] = 0.0
            joins[join] = job, cuts
        try:
            for future in as_completed(list(piece_s)):
                if future in joins:
                    future.result()
                    job, cuts = joins[future]
                    for done in (*cuts, future):
                        done.release()  # or the death of a worker that has held it would have it made again
                    job.clear()
                yield piece_s[future]
        except KilledWorker as error:
            raise RunError(f"{error.allowed_failures + 1} workers died over one walk") from None


@contextmanager
def _client(workers: int | None, scheduler: str | None) -> Iterator[Any]:
    """Open a scheduler, or processes of this machine."""
    try:
        import dask

        dask.config.set({"logging.distributed": "critical"})  # read once, when distributed is imported
        from distributed import Client, LocalCluster
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
        yield client


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
        "scenario_sha256": _digest(tree),
    }


def _digest(tree: Mapping[str, Any]) -> str:
    """Give the sha256 of a tree."""
    return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()


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
    return f"vlp16emu {version('vlp16emu')}"


def _read(path: Path) -> dict[str, Any]:
    tree: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return tree


def _write(path: Path, text: str) -> None:
    with OutputFile(path) as file, file.writing() as opened:
        opened.write(text.encode())
