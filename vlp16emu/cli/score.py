"""`vlp16emu score`: what a pipeline under test made of a run, against its ground truth."""

import json
from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.printer import print_json, print_rows
from vlp16emu.cli.terminal import make_folder
from vlp16emu.options import Option
from vlp16emu.output import OutputFile
from vlp16emu.run.options import WhichUnit


def score(
    truth: Annotated[Path, Option("Folder that `record --truth` has written.", name="TRUTH_DIR")],
    *,
    trajectory: Annotated[Path | None, Option("Estimated poses, TUM; KITTI with --times.", "FILE")] = None,
    times: Annotated[Path | None, Option("A time in seconds for each pose of KITTI, one to a line.", "FILE")] = None,
    align: Annotated[
        str, Option("How the poses are laid on the truth; nothing else is moved.", words=("none", "yaw", "se3"))
    ] = "none",
    map_file: Annotated[
        Path | None, Option("Points in the world: .ply, .npz, .csv, .pcd, .las or .laz.", "FILE", "--map")
    ] = None,
    points: Annotated[Path | None, Option("Points with labels `leaf_wood`, `instance` (or `treeID`).", "FILE")] = None,
    stems: Annotated[Path | None, Option("Stems found: x, y, dbh (m) or dbh_cm, number.", "FILE.csv")] = None,
    inventory: Annotated[Path | None, Option("True trees, of `forest --inventory`.", "FILE.csv")] = None,
    truth_points: Annotated[Path | None, Option("True points, of `points --truth`.", "FILE")] = None,
    radius_m: Annotated[float, Option("Farthest that a found stem is from a true one.", "M", gt=0, le=10)] = 0.5,
    unit: WhichUnit = 1,
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
    from vlp16emu.extras.score.card import ScoreInputs, limits_of, make_card
    from vlp16emu.extras.score.page import page

    limits = limits_of(require or ())
    if out is not None:
        check_matplotlib()
    card = make_card(
        ScoreInputs(truth, trajectory, times, map_file, points, stems, inventory, truth_points, unit, align, radius_m)
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
