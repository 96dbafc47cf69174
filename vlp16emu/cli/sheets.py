"""Verbs that report on a scene: forest and accuracy."""

import json
from contextlib import nullcontext
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from vlp16emu.cli.arguments import AsJson, SceneName, Settings
from vlp16emu.cli.printer import (
    count,
    print_files,
    print_json,
    print_rows,
    print_table,
    rows_of,
    table_of,
    text_of,
    tree_of,
)
from vlp16emu.cli.terminal import Progress, compile_first
from vlp16emu.errors import InputError
from vlp16emu.options import Option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vlp16emu.extras.accuracy.sweep import Accuracy, LevelOfDetail, Row

_SUFFIXES = {"--inventory": ".csv", "--stems": ".csv", "--ground": ".asc", "--glb": ".glb", "--picture": ".png"}


def forest(
    scene: SceneName,
    *,
    settings: Settings = None,
    radius_m: Annotated[
        float, Option("How far from the path things count, are drawn and go into the twin.", "M", ge=1, le=300)
    ] = 30.0,
    inventory: Annotated[Path | None, Option("Write all trees in the sensor's reach, one per line.", "OUT.csv")] = None,
    seen: Annotated[
        Path | None,
        Option(
            "With --inventory, for each tree the returns from its stem in a run with this truth"
            " (`record --truth DIR --truth-returns`), the share of the stem that has any, and the arc at breast height.",
            "DIR",
        ),
    ] = None,
    stems: Annotated[
        Path | None,
        Option(
            "Write the stems of those trees, and the branches of those within the radius, as circles along their axes,"
            " with radii, for QSM and taper.",
            "OUT.csv",
        ),
    ] = None,
    ground: Annotated[
        Path | None, Option("Write the true height of the ground as an ESRI ASCII grid of 0.25 m cells.", "OUT.asc")
    ] = None,
    glb: Annotated[Path | None, Option("Write a digital twin as glTF, its nodes named by labels.", "OUT.glb")] = None,
    picture: Annotated[Path | None, Option("Draw a plan and a section; needs the extra 'picture'.", "OUT.png")] = None,
    as_json: AsJson = False,
) -> None:
    """Report what stands along the path of the sensor.

    Trees by species, their pattern, the relief, and what lies on the ground, all within the radius of the
    path; of a hall, its things.
    """
    from vlp16emu.output import spare
    from vlp16emu.scenario import find, load
    from vlp16emu.scenario.find import named_files

    if seen and not inventory:
        raise InputError("--seen", "found no --inventory", "both")
    given = zip(_SUFFIXES, (inventory, stems, ground, glb, picture), strict=True)
    wanted = {name: path for name, path in given if path is not None}
    scenario = load(scene, settings or ())
    for name, path in wanted.items():  # before anything heavy
        spare([find(scene), *named_files(scenario)], path)
        if path.suffix != (suffix := _SUFFIXES[name]):
            raise InputError(f"{name} {path}", f"found suffix '{path.suffix}'", suffix)
    if picture is not None:
        from vlp16emu.extras.plots import check_matplotlib

        check_matplotlib()
    compile_first(scenario.world.kind)
    from vlp16emu.extras.sheets.sheet import write_sheets

    with Progress(0.0):
        summary = write_sheets(scene, scenario, radius_m, wanted, truth=seen)
    if as_json:
        written = {name.removeprefix("--"): str(path) for name, path in wanted.items()}
        print_json({**tree_of(summary), "files": written})
        return
    _print_forest(summary)
    print_files(wanted.values())


def _print_forest(summary: dict[str, Any]) -> None:
    figures = dict(summary)
    tables = {name: figures.pop(name, ()) for name in ("scene", "title", "trees", "things", "named")}
    print_rows(f"{summary['scene']}: {summary['title']}", rows_of(figures))
    if tables["trees"]:
        print_table(table_of(tables["trees"]))
    if tables["things"]:
        print_rows("on the ground", {kind: text_of(things) for kind, things in tables["things"].items()})
    if tables["named"]:
        print_rows("things", {one["name"]: text_of(one) for one in tables["named"]})


_TIMES = 8  # so many times as many pulses for means of worlds, by which single pulses are not compared


def accuracy(
    scene: SceneName,
    *,
    settings: Settings = None,
    pulses: Annotated[int, Option("How many pulses to look at.", "N", ge=128, le=1_000_000)] = 8192,
    out: Annotated[
        Path | None, Option("Write the report as JSON and a picture into a folder; needs the extra 'picture'.", "DIR")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the error and the cost of settings of the beam, of poses and of foliage.

    Pulses from all over the run are received with each setting and compared with their converged answer, of
    thousands of sub-rays, by a receiver without noise; so are poses that are held. A forest cast leaf by leaf to some
    distances is held against the explicit one by means, with 8 times as many pulses.
    Of a rig, the first sensor is looked at.
    """
    from vlp16emu.extras.outputs import report
    from vlp16emu.scenario import load

    scenario = load(scene, settings or [])
    if out is not None:
        from vlp16emu.extras.plots import check_matplotlib

        check_matplotlib()
    name = Path(scene).stem
    names = [f"accuracy_{name}.json", f"accuracy_{name}.png"]
    compile_first(scenario.world.kind)
    from vlp16emu.extras.accuracy.sweep import choices, draw_accuracy, front, measure_accuracy, measure_foliage

    with report(out, names) if out else nullcontext() as files:
        with Progress(whole_s := scenario.duration_s) as bar:
            show = lambda share: bar.show("measuring", share * whole_s)  # noqa: E731
            measured = measure_accuracy(scenario, name, pulses=pulses, done=show)
            show = lambda share: bar.show("comparing worlds", share * whole_s)  # noqa: E731
            measured = replace(measured, foliage=measure_foliage(scenario, pulses=_TIMES * pulses, done=show))
        taken = [{"wanted_m": wanted_m, "take": name} for name, wanted_m in choices(measured.rows).items()]
        tree = {"written_by": f"vlp16emu {version('vlp16emu')}"} | tree_of(measured)
        tree |= {"front": [row.name for row in front(measured.rows)], "choices": taken}
        if files:
            files[0].write(f"{json.dumps(tree, indent=2)}\n".encode())
            draw_accuracy(files[1], measured)
    paths = [out / name for name in names] if out else []
    if as_json:
        print_json(tree | {"files": [str(path) for path in paths]})
        return
    _print_accuracy(measured)
    words = "; ".join(f"{one['wanted_m']:g} m: {one['take']}" for one in taken)
    print(f"For a mean error of {words}" if words else "No setting has a mean error below 0.5 m")
    print_files(paths)


def _print_accuracy(measured: "Accuracy") -> None:
    errors = measured.rows[0].errors
    print(f"{measured.scene}, seed {measured.seed}: error against run time")
    print(
        f"  {count(errors.pulses)} pulses, {count(errors.returns)} with a return; answer of "
        f"{count(measured.answer_rays)} sub-rays, itself wrong by {1e3 * measured.answer_rmse_m:.2f} mm\n"
    )
    _print_rows(measured.rows, "setting of the beam")
    if measured.poses:
        print("\nWith the light of the answer; run time is that of posing and aiming.")
        _print_rows(measured.poses, "pose")
    if measured.foliage:
        _print_foliage(measured.foliage)


def _print_foliage(levels: "Sequence[LevelOfDetail]") -> None:
    """Print worlds by means; what departs from the explicit one by more than chance has a mark."""
    print(
        "\nWorlds cast leaf by leaf to some distance, means over all pulses without noise; a pulse without a return\n"
        "has a range of sensor.max_range_m. +- is half of the 95 % interval of the difference from the explicit\n"
        "world, ! marks a difference beyond it; chance alone marks one in 20."
    )
    lines = [["world", "us per pulse", *levels[-1].means]]
    for level in levels:
        cells = (f"{mean.value:.2f} +-{mean.half:.2f}{'!' if mean.departs else ' '}" for mean in level.means.values())
        lines.append([_starred(level.name, in_use=level.in_use), f"{level.us_per_pulse:.2f}", *cells])
    print_table(lines)


def _starred(name: str, *, in_use: bool) -> str:
    short = name.removeprefix("beam.model=").removeprefix("world.").replace("beam.", "")
    return f"{short} *" if in_use else short


def _print_rows(rows: "Sequence[Row]", what: str) -> None:
    """Print settings as a table; the one in use has a star."""
    heads = "us/pulse", "+-", "rays", "mean mm", "RMSE", "bias", "p95", "lost %", "invented", "wrong", "last", "refl."
    lines = [[what, *heads]]
    for row in rows:
        e = row.errors
        lengths_m = e.mean_error_m, e.range_rmse_m, e.range_bias_m, e.range_p95_m
        cells = [f"{row.us_per_pulse:.2f}", f"{row.us_spread / 2:.2f}", f"{row.rays_per_pulse:.1f}"]
        cells += [f"{1e3 * length_m:.{1 if length_m >= 1e-3 else 2}f}" for length_m in lengths_m]
        cells += [f"{100 * share:.2f}" for share in (e.lost, e.invented, e.wrong_strongest, e.wrong_last)]
        lines.append([_starred(row.name, in_use=row.in_use), *cells, f"{e.reflectivity_rmse:.2f}"])
    print_table(lines)
