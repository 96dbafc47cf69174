"""A dataset from its walks to its manifest."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from vlp16emu.errors import InputError
from vlp16emu.extras.dataset.cluster import connect
from vlp16emu.extras.dataset.manifest import (
    MANIFEST,
    check_manifest,
    complete_entry,
    take_place,
    write_manifest,
)
from vlp16emu.extras.dataset.parts import parts_of_run
from vlp16emu.extras.dataset.processes import make_here
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.extras.dataset.walk import Made, forget_worlds
from vlp16emu.extras.options import DatasetOptions
from vlp16emu.output import lock, opening

Progress = Callable[[float], None]
Maker = Callable[[Sequence[DatasetWalk], Path], Iterator[Made]]
"""Makes walks in folders inside a folder, and yields each when it is done."""


@dataclass(frozen=True, slots=True)
class DatasetResult:
    """Result of a run."""

    manifest: str
    sha256: str  # sha256 of the manifest
    walks: int
    made: int  # new walks
    bytes: int  # size of all files of all walks


def make_dataset(
    walks: Sequence[DatasetWalk], out: Path, *, progress: Progress = lambda _: None, **options: Any
) -> DatasetResult:
    """Make the missing walks of a dataset, and its manifest.

    A walk is complete if its folder has a list, and its files have the sizes and sha256 of that list.

    Parameters
    ----------
    out : folder, new or from an earlier run
    progress : called with the simulated seconds so far, walk by walk
    options : fields of `DatasetOptions`

    Raises InputError for wrong options, or a scheduler that has no fit workers; OutputError
    if the folder cannot be written, another run writes it, or the folder of a walk has an unlisted file;
    MissingExtraError for a scheduler without Dask; RunError if a walk fails, workers die repeatedly over one
    walk, or the scheduler is lost.
    """
    out = out.absolute()
    asked = DatasetOptions.from_fields(options)
    check_options(asked)
    path = out / MANIFEST
    with ExitStack() as stack:
        make: Maker = partial(make_here, workers=asked.workers)
        if asked.scheduler is not None:
            make = stack.enter_context(connect(asked.scheduler)).make
        stack.enter_context(_locked(out))
        check_manifest(path)
        entries = {walk.number: entry for walk in walks if (entry := complete_entry(out, walk))}
        missing = [walk for walk in walks if walk.number not in entries]
        done_s = sum(walk.scenario.duration_s for walk in walks if walk.number in entries)
        progress(done_s)
        try:
            with parts_of_run(out) as parts:
                for walk, made, entry in make(missing, parts):
                    take_place(made, out / walk.folder)
                    entries[walk.number] = entry
                    done_s += walk.scenario.duration_s
                    progress(done_s)
        finally:
            sha256 = write_manifest(path, [entry for _, entry in sorted(entries.items())])
    size = sum(file["bytes"] for entry in entries.values() for file in entry["files"])
    return DatasetResult(str(path), sha256, walks=len(walks), made=len(missing), bytes=size)


def check_options(options: DatasetOptions) -> None:
    """Raise InputError for options that exclude each other."""
    if options.scheduler is not None and options.workers is not None:
        found = f"found {options.workers} beside a scheduler"
        raise InputError("workers", found, "only one of the two: a scheduler has workers of its own")


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    """Keep other runs out of a folder, which is made if it does not exist."""
    with opening(str(out), "a folder that can be written"):
        out.mkdir(parents=True, exist_ok=True)
        opened = os.open(out, os.O_RDONLY | os.O_DIRECTORY)
    try:
        lock(opened, str(out))
        yield
    finally:
        os.close(opened)
        forget_worlds()
