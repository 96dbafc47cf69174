"""`vlp16emu dataset`: many walks from one file."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli.arguments import AsJson, argument, number, option
from vlp16emu.cli.terminal import Progress, count, finish, size, tree_of


def dataset(
    spec: Annotated[Path, argument("SPEC.toml", "File that describes the dataset.")],
    out: Annotated[Path, argument("OUT", "Folder: new, or of an earlier run.")],
    *,
    workers: Annotated[
        int | None,
        number(
            "--workers",
            "Processes on this machine, one per core if left out; 0 is this process alone. Never changes a byte.",
            "N",
            0,
            1024,
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        option(
            "--scheduler",
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
    total_s = sum(walk.scenario.duration_s for walk in walks)
    with Progress(total_s) as progress:
        result = make_dataset(
            walks,
            out,
            workers=workers,
            scheduler=scheduler,
            progress=lambda done_s: progress.show("making walks", done_s),
        )
    rows = {
        "walks": f"{count(result.walks)}, {count(result.made)} of them new",
        "size": size(result.bytes),
        "sha256": result.sha256,
    }
    finish(tree_of(result), result.manifest, rows, as_json=as_json)
