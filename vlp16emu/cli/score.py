"""`vlp16emu score`: what a pipeline under test made of a run, against its ground truth."""

import json
from contextlib import nullcontext
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.printer import print_json, print_rows, tree_of
from vlp16emu.extras.options import ScoreInputs
from vlp16emu.options import Option


def score(
    inputs: ScoreInputs,
    *,
    out: Annotated[Path | None, Option("Write score.json and score.html; needs the extra 'score'.", "DIR")] = None,
    require: Annotated[
        list[str] | None, Option("A threshold; exit code 1 if it is missed. Repeatable.", "SCORE<NUMBER")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score a pipeline's trajectory, map, labels and stems against the truth of a run.

    Scores what is given, from files of any tool. Exit code 1 if a threshold is missed.
    """
    from vlp16emu.extras.plots import check_matplotlib
    from vlp16emu.extras.score.card import limits_of, make_card, page
    from vlp16emu.output import report

    limits = limits_of(require or ())
    if out is not None:
        check_matplotlib()
    with report(out, ("score.json", "score.html")) if out else nullcontext() as files:
        card = make_card(inputs)
        missed = card.missed(limits)
        tree = {"written_by": f"vlp16emu {version('vlp16emu')}", "inputs": card.inputs, "scores": card.scores}
        tree = tree_of({**tree, "notes": card.notes, "trees": card.trees, "missed": missed})
        if files:
            files[0].write(f"{json.dumps(tree, indent=2)}\n".encode())
            files[1].write(page(card, missed).encode())
    if as_json:
        print_json(tree)
    else:
        print_rows("scores", {name: f"{value:.6g}" for name, value in card.scores.items()})
        for line in missed:
            print(f"missed: {line}")
    if missed:
        raise typer.Exit(1)
