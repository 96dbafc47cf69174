"""`vlp16emu dataset`: many walks from one file."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli.arguments import MOST_THREADS, AsJson
from vlp16emu.cli.printer import finish
from vlp16emu.cli.terminal import Progress
from vlp16emu.options import Option


def dataset(
    spec: Annotated[Path, Option("File that describes the dataset.", name="SPEC.toml")],
    out: Annotated[Path, Option("Folder: new, or of an earlier run.", name="OUT")],
    *,
    workers: Annotated[
        int | None,
        Option(
            "Processes on this machine, one per core if left out; 0 is this process alone. Never changes a byte.",
            "N",
            ge=0,
            le=MOST_THREADS,
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        Option(
            "A Dask scheduler, such as tcp://127.0.0.1:8786, whose workers have this version and see OUT under the same path.",
            "ADDRESS",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a dataset: stands, seeds, paths and sensors from one file.

    Walks that an earlier run has finished are kept, after a check of their sha256; the others are made.
    OUT/manifest.json names every file with its sha256, and the split of its stand.
    """
    from vlp16emu.extras.dataset import load_spec, make_dataset, walks_of

    walks = walks_of(load_spec(spec), spec.absolute().parent)
    with Progress(sum(walk.scenario.duration_s for walk in walks)) as bar:
        show = lambda done_s: bar.show("making walks", done_s)  # noqa: E731
        result = make_dataset(walks, out, workers=workers, scheduler=scheduler, progress=show)
    finish(result, as_json=as_json)
