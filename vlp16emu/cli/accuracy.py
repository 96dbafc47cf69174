"""`vlp16emu accuracy`: error against run time."""

import json
from contextlib import nullcontext
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from vlp16emu.cli.arguments import AsJson, SceneName, Settings
from vlp16emu.cli.printer import count, print_files, print_json, print_table, tree_of
from vlp16emu.cli.start import compile_first
from vlp16emu.cli.terminal import Progress
from vlp16emu.options import Option

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from vlp16emu.extras.accuracy.curve import Accuracy, LevelOfDetail, Row
    from vlp16emu.scenario import Scenario


_TIMES = 8
"""So many times as many pulses for means of worlds, by which single pulses are not compared."""


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
    with report(out, names) if out else nullcontext() as files:
        measured = _measured(scenario, name, pulses)
        tree = _tree(measured)
        if files:
            from vlp16emu.extras.accuracy.curve import draw_accuracy

            files[0].write(f"{json.dumps(tree, indent=2)}\n".encode())
            draw_accuracy(files[1], measured)
    paths = [out / name for name in names] if out else []
    if as_json:
        print_json(tree | {"files": [str(path) for path in paths]})
        return
    _print(measured)
    print_files(paths)


def _measured(scenario: "Scenario", name: str, pulses: int) -> "Accuracy":
    """Measure a scene, with a progress bar."""
    from vlp16emu.extras.accuracy.foliage import measure_foliage
    from vlp16emu.extras.accuracy.sweep import measure_accuracy

    whole_s = scenario.duration_s
    with Progress(whole_s) as progress:

        def show(task: str) -> "Callable[[float], None]":
            return lambda share: progress.show(task, share * whole_s)

        measured = measure_accuracy(scenario, name, pulses=pulses, done=show("measuring"))
        foliage = measure_foliage(scenario, pulses=_TIMES * pulses, done=show("comparing worlds"))
    return replace(measured, foliage=foliage)


def _tree(measured: "Accuracy") -> dict[str, Any]:
    """Return the report in the types of JSON."""
    from vlp16emu.extras.accuracy.curve import Kind, choices, fitted_order, front

    tree: dict[str, Any] = tree_of(measured)
    return (
        {"written_by": f"vlp16emu {version('vlp16emu')}"}
        | tree
        | {
            "front": [row.name for row in front(measured.rows)],
            "fits": {kind: tree_of(fit) for kind in Kind if (fit := fitted_order(measured.rows, kind))},
            "choices": [{"wanted_m": one.wanted_m, "take": one.row.name} for one in choices(measured.rows)],
        }
    )


def _print(measured: "Accuracy") -> None:
    from vlp16emu.extras.accuracy.curve import choices

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
    taken = "; ".join(f"{one.wanted_m:g} m: {one.row.name}" for one in choices(measured.rows))
    print(f"For a mean error of {taken}" if taken else "No setting has a mean error below 0.5 m")


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
