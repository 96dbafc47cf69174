"""`vlp16emu score`: what a pipeline under test made of a run, against its truth."""

import json
from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli.arguments import AsJson, WhichUnit, argument, checked, one_of, option
from vlp16emu.cli.terminal import make_folder, print_json, print_rows
from vlp16emu.output import OutputFile


def score(
    truth: Annotated[Path, argument("TRUTH_DIR", "Folder that `record --truth` has written.")],
    *,
    trajectory: Annotated[
        Path | None, option("--trajectory", "Estimated poses, TUM; KITTI with --times.", "FILE")
    ] = None,
    times: Annotated[
        Path | None, option("--times", "A time in seconds for each pose of KITTI, one to a line.", "FILE")
    ] = None,
    align: Annotated[
        str, one_of("--align", "How the poses are laid on the truth; nothing else is moved.", "none", "yaw", "se3")
    ] = "none",
    map_file: Annotated[
        Path | None, option("--map", "Points in the world: .ply, .npz, .csv, .pcd, .las or .laz.", "FILE")
    ] = None,
    points: Annotated[
        Path | None, option("--points", "Points with labels `leaf_wood`, `instance` (or `treeID`).", "FILE")
    ] = None,
    stems: Annotated[
        Path | None, option("--stems", "Stems found: x, y, dbh (m) or dbh_cm, number.", "FILE.csv")
    ] = None,
    inventory: Annotated[Path | None, option("--inventory", "True trees, of `forest --inventory`.", "FILE.csv")] = None,
    truth_points: Annotated[Path | None, option("--truth-points", "True points, of `points --truth`.", "FILE")] = None,
    radius: Annotated[
        float,
        option(
            "--radius",
            "Within which a stem is one of the truth.",
            "M",
            checked("--radius", float, lambda m: 0 < m <= 10, "a number above 0 and at most 10"),
            shown="0.5",
        ),
    ] = 0.5,
    unit: WhichUnit = 1,
    out: Annotated[
        Path | None, option("--out", "Write score.json and score.html; needs the extra 'score'.", "DIR")
    ] = None,
    require: Annotated[
        list[str] | None,
        option("--require", "A threshold; exit code 1 where it is missed. Repeatable.", "SCORE<NUMBER"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score a pipeline's trajectory, map, labels and stems against the truth of a run.

    Scores what is given, from files of any tool. Exit code 1 where a threshold is missed.
    """
    from vlp16emu.extras.plots import check_matplotlib
    from vlp16emu.extras.score.card import ScoreInputs, limits_of, make_card
    from vlp16emu.extras.score.page import page

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
