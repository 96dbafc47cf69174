"""`vlp16emu dataset`: many walks from one file."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.printer import finish
from vlp16emu.cli.terminal import Progress
from vlp16emu.extras.options import DatasetOptions
from vlp16emu.options import Option


def dataset(
    spec: Annotated[Path, Option("File that describes the dataset.", name="SPEC.toml")],
    out: Annotated[Path, Option("Folder: new, or of an earlier run.", name="OUT")],
    options: DatasetOptions,
    *,
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
        result = make_dataset(walks, out, progress=show, **vars(options))
    finish(result, as_json=as_json)
