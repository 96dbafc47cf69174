"""`vlp16emu dataset`: many walks from one file."""

from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli.arguments import AsJson, checked
from vlp16emu.cli.terminal import Progress, count, print_json, print_rows, size, tree_of
from vlp16emu.errors import InputError

SpecFile = Annotated[
    Path, typer.Argument(metavar="SPEC.toml", help="File that describes the dataset.", show_default=False)
]
Folder = Annotated[Path, typer.Argument(metavar="OUT", help="Folder: new, or of an earlier run.", show_default=False)]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        parser=checked("--workers", int, lambda n: 0 <= n <= 1024, "a whole number from 0 to 1024"),
        help="Processes on this machine, one per core if left out; 0 is this process alone. Never changes a byte.",
    ),
]
Cluster = Annotated[
    bool,
    typer.Option("--cluster", help="Let Dask keep the processes on this machine; they talk over TLS, on loopback."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="A Dask scheduler, such as tcp://127.0.0.1:8786, whose workers have this version and see OUT under the same path.",
    ),
]


def dataset(
    spec: SpecFile,
    out: Folder,
    *,
    workers: Workers = None,
    cluster: Cluster = False,
    scheduler: Scheduler = None,
    as_json: AsJson = False,
) -> None:
    """Make a dataset: stands, seeds, paths and sensors from one file.

    Walks that an earlier run has finished are kept, after a check of their sha256; the others are made.
    OUT/manifest.json names every file with its sha256, and the split of its stand.
    """
    from vlp16emu.extras.dataset import load_spec, make_dataset, walks_of

    if cluster and scheduler:
        raise InputError("--cluster", "found beside --scheduler", "one of both")
    walks = walks_of(load_spec(spec), spec.absolute().parent)
    total_s = sum(walk.scenario.duration_s for walk in walks)
    with Progress(total_s) as progress:
        result = make_dataset(
            walks,
            out,
            workers=workers,
            cluster=cluster,
            scheduler=scheduler,
            progress=lambda done_s: progress.show("making walks", done_s),
        )
    if as_json:
        print_json(tree_of(result))
        return
    print_rows(
        f"wrote {result.manifest}",
        {
            "walks": f"{count(result.walks)}, {count(result.made)} of them new",
            "size": size(result.bytes),
            "sha256": result.sha256,
        },
    )
