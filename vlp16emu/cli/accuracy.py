"""`vlp16emu accuracy`: error against run time."""

import math
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vlp16emu.cli.arguments import AsJson, SceneName, Settings, checked
from vlp16emu.cli.start import compile_first
from vlp16emu.cli.terminal import Progress, count, make_folder, print_json, size
from vlp16emu.output import OutputFile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vlp16emu.accuracy.curve import Accuracy, Row
    from vlp16emu.accuracy.distributions import Distributions
    from vlp16emu.scenario import Scenario


_WIDTH = 120
_TIMES = 16
"""So many times as many pulses for distributions, by which single pulses are not compared."""

Pulses = Annotated[
    int,
    typer.Option(
        "--pulses",
        metavar="N",
        parser=checked(
            "--pulses", int, lambda n: 128 <= n <= 1_000_000, "a whole number from 128 to 1000000"
        ),
        help="How many pulses to look at.",
    ),
]
OutDir = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Write the report as JSON and a picture into a folder; needs the extra 'picture'.",
    ),
]


def accuracy(
    scene: SceneName,
    *,
    settings: Settings = None,
    pulses: Pulses = 8192,
    out: OutDir = None,
    as_json: AsJson = False,
) -> None:
    """Measure the error and the cost of settings of the beam, of poses and of foliage.

    Pulses from all over the run are received with each setting and compared with their converged answer, of
    thousands of sub-rays, by a receiver without noise; so are poses that are held. A forest cast leaf by leaf to some
    distances is held against the explicit one by its distributions, with 16 times as many pulses.
    Of a rig, the first sensor is looked at.
    """
    from vlp16emu.scenario import load

    scenario = load(scene, settings or [])
    if out is not None:
        from vlp16emu.plots import check_matplotlib

        check_matplotlib()
        make_folder(out)
    name = Path(scene).stem
    files = [] if out is None else [out / f"accuracy_{name}{suffix}" for suffix in (".json", ".png")]
    compile_first("hall" if scenario.world.kind == "hall" else "forest")
    with ExitStack() as stack:
        outputs = [stack.enter_context(OutputFile(file, where=f"--out {file}")) for file in files]
        measured = _measured(scenario, name, pulses)
        tree = _tree(measured)
        if outputs:
            _write(outputs, measured, tree)
    if as_json:
        print_json(tree | {"files": [str(file) for file in files]})
        return
    _print(measured)
    if measured.distributions is not None:
        _print_distributions(measured.distributions)
    for file in files:
        print(f"wrote {file}, {size(file.stat().st_size)}")


def _measured(scenario: "Scenario", name: str, pulses: int) -> "Accuracy":
    """Measure a scene, with a progress bar."""
    from vlp16emu.accuracy.medium import measure_medium
    from vlp16emu.accuracy.sweep import measure_accuracy

    with Progress(scenario.duration_s) as progress:
        measured = measure_accuracy(
            scenario, name, pulses=pulses, done=lambda done_s: progress.show("measuring", done_s)
        )
        whole_s = scenario.duration_s
        distributions = measure_medium(
            scenario,
            pulses=_TIMES * pulses,
            done=lambda share: progress.show("comparing worlds", share * whole_s),
        )
    return replace(measured, distributions=distributions)


def _tree(measured: "Accuracy") -> dict[str, Any]:
    """Put the report into the types of JSON, which has no NaN."""
    from vlp16emu.accuracy.curve import Kind, choices, fitted_order, front

    def clean(value: Any) -> Any:
        """JSON has no NaN: nothing stands for it."""
        if isinstance(value, dict):
            return {key: clean(one) for key, one in value.items()}
        if isinstance(value, list | tuple):
            return [clean(one) for one in value]
        return None if isinstance(value, float) and math.isnan(value) else value

    tree: dict[str, Any] = clean(asdict(measured))
    return tree | {
        "front": [row.name for row in front(measured.rows)],
        "fits": {kind: asdict(fit) for kind in Kind if (fit := fitted_order(measured.rows, kind))},
        "choices": [{"wanted_m": one.wanted_m, "take": one.row.name} for one in choices(measured.rows)],
    }


def _write(outputs: "Sequence[OutputFile]", measured: "Accuracy", tree: dict[str, Any]) -> None:
    """Write the files of a report.

    Raises
    ------
    RunError
        where one cannot be written to its end
    """
    import json

    from vlp16emu.accuracy.curve import draw_accuracy

    report, picture = outputs
    with report.writing() as file:
        file.write(f"{json.dumps(tree, indent=2)}\n".encode())
    with picture.writing() as file:
        draw_accuracy(file, measured)


def _print(measured: "Accuracy") -> None:
    from vlp16emu.accuracy.curve import choices

    errors, rounding = measured.rows[0].errors, measured.rounding
    print(f"{measured.scene}, seed {measured.seed}: error against run time")
    print(
        f"  {count(errors.pulses)} pulses, {count(errors.returns)} with a return; answer of "
        f"{count(measured.answer_rays)} sub-rays, itself wrong by {1e3 * measured.answer_rmse_m:.2f} mm\n"
    )
    _print_rows(measured.rows, "setting of the beam")
    if measured.poses:
        print("\nWith the light of the answer; run time is that of posing and aiming.")
        _print_rows(measured.poses, "pose")
    print(
        f"\nfloat32 against float64, {rounding.rays} single rays: RMSE {1e6 * rounding.range_rmse_m:.1f} um, at most "
        f"{1e6 * rounding.range_max_m:.0f} um; {100 * rounding.elsewhere:.1f} % graze an edge and meet something else"
    )
    taken = "; ".join(f"{one.wanted_m:g} m: {one.row.name}" for one in choices(measured.rows))
    print(f"For a mean error of {taken}" if taken else "No setting has a mean error below 0.5 m")


def _print_distributions(found: "Distributions") -> None:
    """Print worlds with a medium beside the explicit one; what departs from that by more than chance has a star."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    print(
        f"\nWorlds with a medium beyond near_m, held against the explicit one: the same {count(found.pulses)} pulses "
        f"in {count(found.groups)} groups,\nby {found.rays} sub-rays without noise, in dual return. ± is half of "
        "the 95 % interval, by drawing groups anew: of the explicit\nworld's value, and of the others' difference "
        "from it. ! marks a difference beyond that; chance alone marks one in 20."
    )
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("statistic", no_wrap=True)
    for name, in_use in zip(found.names, found.in_use, strict=True):
        table.add_column(
            name.removeprefix("world.") + (" *" if in_use else ""), justify="right", no_wrap=True
        )
    table.add_row("us per pulse", *(f"{us:.1f}" for us in found.us_per_pulse))
    section = ""
    for row in found.statistics:
        if row.section != section:
            table.add_row(section := row.section)
        halves = ((high - low) / 2 for low, high in zip(row.low, row.high, strict=True))
        marks = ("!" if row.departs(world) else " " for world in range(len(found.names) - 1))
        cells = zip(row.values, halves, (*marks, " "), strict=True)
        table.add_row(
            f"  {row.name}", *(f"{_short(value)} ±{_short(half)}{mark}" for value, half, mark in cells)
        )
    Console(width=_WIDTH).print(table)
    _print_tests(found)


def _short(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.{1 if abs(value) >= 100 else 2}f}"


def _print_tests(found: "Distributions") -> None:
    """Print distances of distributions from those of the explicit world, and how often chance alone gives more."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("distribution, against near_m=inf", no_wrap=True)
    for name in found.names[:-1]:
        table.add_column(name.removeprefix("world."), justify="right", no_wrap=True)
    for test in found.tests:
        pairs = zip(test.distance, test.p, strict=True)
        cells = (f"{distance:.4g}, p {'<' if p < 0.0015 else ''}{p:.3f}" for distance, p in pairs)
        table.add_row(f"{test.name} ({test.kind})", *cells)
    Console(width=_WIDTH).print(table)


def _print_rows(rows: "Sequence[Row]", what: str) -> None:
    """Print settings as a table; the one in use has a star."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(what, no_wrap=True)
    heads = "us per\npulse", "\n+-", "\nrays", "mean\nmm", "RMSE\nmm", "bias\nmm", "p95\nmm"
    for head in (*heads, "lost\n%", "invented\n%", "wrong\n%", "wrong\nlast, %", "reflect.\nRMSE"):
        table.add_column(head, justify="right", no_wrap=True)
    for row in rows:
        e = row.errors
        lengths_m = e.mean_error_m, e.range_rmse_m, e.range_bias_m, e.range_p95_m
        shares = e.lost, e.invented, e.wrong_strongest, e.wrong_last
        table.add_row(
            f"{row.name.removeprefix('beam.model=').removeprefix('world.').replace('beam.', '')}{' *' if row.in_use else ''}",
            f"{row.us_per_pulse:.2f}",
            f"{row.us_spread / 2:.2f}",
            f"{row.rays_per_pulse:.1f}",
            *(f"{1e3 * length_m:.{1 if length_m >= 1e-3 else 2}f}" for length_m in lengths_m),
            *(f"{100 * share:.2f}" for share in shares),
            f"{e.reflectivity_rmse:.2f}",
        )
    Console(width=_WIDTH).print(table)
