"""`vlp16emu score`: what a pipeline under test made of a run, against its truth."""

import json
from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli.arguments import AsJson, checked
from vlp16emu.cli.terminal import make_folder, print_json, print_rows
from vlp16emu.errors import InputError
from vlp16emu.output import OutputFile

TruthFolder = Annotated[
    Path, typer.Argument(metavar="TRUTH_DIR", help="Folder that `record --truth` has written.", show_default=False)
]
Found = Annotated[
    Path | None, typer.Option("--trajectory", metavar="FILE", help="Estimated poses, TUM; KITTI with --times.")
]
Times = Annotated[
    Path | None,
    typer.Option("--times", metavar="FILE", help="A time in seconds for each pose of KITTI, one to a line."),
]
Align = Annotated[
    str,
    typer.Option("--align", metavar="none|yaw|se3", help="How the poses are laid on the truth; nothing else is moved."),
]
MapFile = Annotated[
    Path | None,
    typer.Option("--map", metavar="FILE", help="Points in the world: .ply, .npz, .csv, .pcd, .las or .laz."),
]
Labelled = Annotated[
    Path | None,
    typer.Option("--points", metavar="FILE", help="Points with labels `leaf_wood`, `instance` (or `treeID`)."),
]
Stems = Annotated[
    Path | None, typer.Option("--stems", metavar="FILE.csv", help="Stems found: x, y, dbh (m) or dbh_cm, number.")
]
Inventory = Annotated[
    Path | None, typer.Option("--inventory", metavar="FILE.csv", help="True trees, of `forest --inventory`.")
]
TruthPoints = Annotated[
    Path | None, typer.Option("--truth-points", metavar="FILE", help="True points, of `points --truth`.")
]
Radius = Annotated[
    float,
    typer.Option(
        "--radius",
        metavar="M",
        parser=checked("--radius", float, lambda m: 0 < m <= 10, "a number above 0 and at most 10"),
        help="Within which a stem is one of the truth.",
        show_default="0.5",
    ),
]
Unit = Annotated[
    int,
    typer.Option(
        "--unit",
        metavar="N",
        parser=checked("--unit", int, lambda n: n >= 1, "a whole number from 1"),
        help="Which sensor of a rig.",
    ),
]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write score.json and score.html; needs the extra 'score'.")
]
Require = Annotated[
    list[str] | None,
    typer.Option("--require", metavar="SCORE<NUMBER", help="A threshold; exit code 1 where it is missed. Repeatable."),
]


def score(
    truth: TruthFolder,
    *,
    trajectory: Found = None,
    times: Times = None,
    align: Align = "none",
    map_file: MapFile = None,
    points: Labelled = None,
    stems: Stems = None,
    inventory: Inventory = None,
    truth_points: TruthPoints = None,
    radius: Radius = 0.5,
    unit: Unit = 1,
    out: Out = None,
    require: Require = None,
    as_json: AsJson = False,
) -> None:
    """Score a pipeline's trajectory, map, labels and stems against the truth of a run.

    Scores what is given, from files of any tool. Exit code 1 where a threshold is missed.
    """
    from vlp16emu.extras.plots import check_matplotlib
    from vlp16emu.extras.score.card import ScoreInputs, limits_of, make_card
    from vlp16emu.extras.score.page import page
    from vlp16emu.extras.score.paths import ALIGNMENTS

    if align not in ALIGNMENTS:
        raise InputError("--align", f"found {align}", ", ".join(ALIGNMENTS))
    limits = limits_of(require or ())
    if out is not None:
        check_matplotlib()
    card = make_card(
        ScoreInputs(truth, trajectory, times, map_file, points, stems, inventory, truth_points, unit, align, radius)
    )
    missed = card.missed(limits)
    tree = {**card.tree(), "missed": missed}
    if out is not None:
        make_folder(out)
        texts = {"score.json": json.dumps(tree, indent=2) + "\n", "score.html": page(card, missed)}
        for name, text in texts.items():
            with OutputFile(out / name) as output, output.writing() as file:
                file.write(text.encode())
    if as_json:
        print_json(tree)
    else:
        print_rows("scores", {name: f"{value:.6g}" for name, value in card.scores.items()})
        for line in missed:
            print(f"missed: {line}")
    if missed:
        raise typer.Exit(1)
