"""Verbs about scenes and this machine: scenes, schema, plan, doctor, cache, forest and accuracy."""

import logging
import os
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vlp16emu.cli.arguments import AsJson, PlotFile, RunOptions, SceneName, Settings
from vlp16emu.cli.printer import (
    members,
    print_file,
    print_json,
    print_line,
    print_rows,
    print_table,
    report_of,
    rows_of,
    size,
    table_of,
    text_of,
)
from vlp16emu.cli.terminal import Progress, compile_first, make_emulator
from vlp16emu.errors import InputError
from vlp16emu.run.options import Duration, Option
from vlp16emu.trees import Tree
from vlp16emu.units import count_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vlp16emu.extras.accuracy.intervals import Interval
    from vlp16emu.extras.accuracy.sweep import Accuracy, LevelOfDetail

_log = logging.getLogger(__name__)


def scenes(*, as_json: AsJson = False) -> None:
    """List the scenes that can be called by name.

    They come with the program; scenes in the folder that the variable VLP16EMU_SCENES names come first.
    """
    from vlp16emu.scenario import load, scene_files

    rows = list[Tree]()
    for name, path in scene_files().items():
        try:
            scenario = load(str(path))
        except InputError as error:
            _log.warning("%s; left out", error)
            continue
        rows.append(
            {
                "name": name,
                "title": scenario.title,
                "duration_s": scenario.duration_s,
                "motion": scenario.motion.kind,
                "world": scenario.world.kind,
                "file": path,
            }
        )
    if as_json:
        print_json({"scenes": rows})
    else:
        print_rows("scenes", {row["name"]: f"{row['duration_s']:g} s  {row['title']}" for row in rows})


def schema() -> None:
    """Print the JSON Schema of the scene file.

    With it, editors that know TOML complete keys and show errors.
    """
    from vlp16emu.scenario import schema as scene_schema

    print_json(scene_schema())


_TOO_SLOW = (
    "Fewer single leaves (world.near_m) and fewer rays (beam.model, beam.target_m) are faster too; "
    "`vlp16emu accuracy` reports their errors."
)


def plan(
    scene: SceneName,
    emulator_options: RunOptions,
    *,
    duration_s: Duration = None,
    sample_s: Annotated[
        float, Option("Recorded time from which the speed is measured.", "S", gt=0.0, le=3600.0)
    ] = 2.0,
    repeats: Annotated[
        int, Option("Number of measurements of each stage; the shortest counts.", "N", ge=1, le=1000)
    ] = 3,
    plot: PlotFile = None,
    as_json: AsJson = False,
) -> None:
    """Report what a scene needs, what its stages cost, and whether a stream keeps up.

    It also names what the scene leaves out, and estimates run time and size of a recording.

    The world is grown, the kernels are loaded, and a sample is recorded without a file: the speed holds
    for this machine at its present load. It does not include the new window of the world that a walk needs
    every 7 s; the time of a recording does.
    """
    from vlp16emu.extras.plot.sheet import plotting

    with plotting(plot) as draw:
        report = report_of("plan", _plan(scene, emulator_options, duration_s, sample_s, repeats))
        draw(report)
    if as_json:
        print_json(report)
        return
    for title, is_on in (("has", True), ("leaves out", False)):
        if features := {need["name"]: need["costs"] for need in report["features"] if need["on"] is is_on}:
            print_rows(f"{scene} {title}", features)
    print_rows("in reach", rows_of(report["world"]))
    print_rows(
        "libraries", {name: "loaded" if is_on else "left out" for name, is_on in report["libraries"].items()}
    )
    costs = {stage["name"]: f"{stage['cpu_s_per_s']:.3f}" for stage in report["stages"]}
    print_rows("cost by stage, seconds of one core per simulated second", costs)
    print_rows(f"measured now, on {report['threads']} threads", rows_of(report["measured"]))
    print_rows("recording, estimated", rows_of(report["recording"]))
    print_rows("stream", rows_of(report["stream"]))
    if not report["stream"]["keeps_up"]:
        print(_TOO_SLOW)
    print_file(plot)


def _plan(
    scene: str, emulator_options: RunOptions, duration_s: float | None, sample_s: float, repeats: int
) -> Tree:
    """Measure a scene, and return its plan."""
    began_s = time.perf_counter()
    emulator = make_emulator(scene, emulator_options)
    _, stop_s = emulator.scenario.span_s(0.0, duration_s)
    emulator.packets(0.0, stop_s)  # refuses a walk that ends before; no packet is computed
    from vlp16emu.extras.plan import libraries, needs, recording_outlook, stages, stream_outlook, surroundings

    emulator.record(os.devnull, duration_s=min(0.1, emulator.scenario.duration_s))
    startup_s = time.perf_counter() - began_s
    measured = emulator.record(os.devnull, duration_s=min(sample_s, emulator.scenario.duration_s))
    audited = measured.audit is not None and not measured.audit.exact
    engine = emulator.engine
    return {
        "scene": scene,
        "seed": emulator.scenario.seed,
        "threads": engine.threads,
        "libraries": libraries(),
        "features": needs(engine, audited=audited),
        "world": surroundings(engine),
        "stages": stages(engine, repeats),
        "measured": {"started_s": startup_s}
        | {name: getattr(measured, name) for name in ("simulated_s", "wall_s", "real_time_factor")},
        "recording": recording_outlook(engine, measured, startup_s, stop_s),
        "stream": stream_outlook(emulator.scenario, measured.real_time_factor),
    }


def doctor(*, as_json: AsJson = False) -> None:
    """Check this machine: cores, kernels, Embree, ports, rights, clock, wake-ups, buffers, extras, disk.

    Each row is ok, a warning if some runs will suffer, or a problem if some will fail, with the remedy. The
    exit code is 1 if there is a problem. Wake-ups are measured under the present load of this machine.
    """
    from vlp16emu.extras.doctor import Condition, all_checks

    checks = list(all_checks())
    counts = {condition.value: sum(check.finding is condition for check in checks) for condition in Condition}
    if as_json:
        print_json({"checks": checks, **counts})
    else:
        rows = {}
        for check in checks:
            remedy = f"; {check.mend}" if check.mend else ""
            rows[check.name] = f"{check.finding:<7}  {check.found}{remedy}"
        print_rows("this machine", rows)
    if counts[Condition.PROBLEM]:
        raise typer.Exit(1)


def cache(
    *,
    clear: Annotated[bool, Option("Remove all of it; files of other programs stay.")] = False,
    compile_all: Annotated[
        bool, Option("Compile all kernels that are missing, for container images and CI.", name="--compile")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show what is kept on disk from run to run, and where: compiled kernels and grown worlds.

    Without them a run takes longer to start and gives the same bytes. VLP16EMU_CACHE_DIR names another folder
    for worlds (`off` for none), VLP16EMU_CACHE_MB limits their size, and NUMBA_CACHE_DIR names another folder
    for kernels.
    """
    from vlp16emu.kernels.cache import user_kernels
    from vlp16emu.store import user_store

    if clear and compile_all:
        raise InputError("--compile", "found beside --clear", "only one of the two")
    if compile_all:
        compile_first(None)
    tree: Tree = {"cleared": clear}
    rows = {}
    for name, store in (("worlds", user_store()), ("kernels", user_kernels())):
        files, used_bytes = store.clear() if clear else store.kept()
        folder = str(store.folder) if store.folder else None
        tree[name] = {"folder": folder, "files": files, "bytes": used_bytes, "most_bytes": store.most_bytes}
        limit = "" if clear else f" of at most {size(store.most_bytes)}"
        rows[name] = (
            f"{count_text(files)} files, {size(used_bytes)}{limit}, "
            f"in {folder or 'no folder: nothing is kept'}"
        )
    if as_json:
        print_json(tree)
    else:
        print_rows("removed" if clear else "kept on disk", rows)


_SUFFIXES = {"--inventory": ".csv", "--stems": ".csv", "--ground": ".asc", "--glb": ".glb"}


def forest(
    scene: SceneName,
    *,
    settings: Settings = None,
    radius_m: Annotated[
        float,
        Option(
            "Distance from the path within which things are counted and go into the twin.", "M", ge=1, le=300
        ),
    ] = 30.0,
    inventory: Annotated[
        Path | None, Option("Write all trees in the sensor's reach, one per line.", "OUT.csv")
    ] = None,
    stems: Annotated[
        Path | None,
        Option(
            "Write the stems of those trees, and the branches of those within the radius, as circles "
            "along their axes, with radii, for QSM and taper.",
            "OUT.csv",
        ),
    ] = None,
    ground: Annotated[
        Path | None,
        Option("Write the true height of the ground as an ESRI ASCII grid of 0.25 m cells.", "OUT.asc"),
    ] = None,
    glb: Annotated[
        Path | None, Option("Write a digital twin as glTF, its nodes named by labels.", "OUT.glb")
    ] = None,
    bark: Annotated[
        bool,
        Option(
            "Also find the share of each stem's bark at 1.3 m that the sensor sees from its path.",
            name="--seen",
        ),
    ] = False,
    plot: PlotFile = None,
    as_json: AsJson = False,
) -> None:
    """Report what stands along the path of the sensor.

    The report lists trees by species, their spatial pattern, the relief, and objects on the ground, all
    within the radius of the path; for a hall, its objects.
    """
    from vlp16emu.extras.plot.sheet import plotting
    from vlp16emu.output import spare
    from vlp16emu.scenario import find, load, named_files

    paths = {"--inventory": inventory, "--stems": stems, "--ground": ground, "--glb": glb}
    outputs = {name: path for name, path in paths.items() if path is not None}
    scenario = load(scene, settings or ())
    inputs = [find(scene), *named_files(scenario)]
    for name, path in outputs.items():  # before anything heavy
        spare(inputs, path)
        if path.suffix != (suffix := _SUFFIXES[name]):
            raise InputError(f"{name} {path}", f"found the ending {path.suffix!r}", suffix)
    with plotting(plot, inputs) as draw:
        compile_first(scenario.world.kind)
        from vlp16emu.extras.survey import write_survey

        with Progress(0.0):
            summary = write_survey(scene, scenario, radius_m, outputs, bark=bark)
        files = {name.removeprefix("--"): str(path) for name, path in outputs.items()}
        report = report_of("forest", {**summary, "files": files})
        draw(report)
    if as_json:
        print_json(report)
        return
    _print_forest(summary)
    for file in (*outputs.values(), plot):
        print_file(file)


_TABLES = ("trees", "things", "named", "stems", "ground", "profile", "hall_m")
"""Members of the summary beside its figures; of the last four, plots and programs use all."""


def _print_forest(summary: Tree) -> None:
    heads = ("scene", "title")
    figures = {name: value for name, value in summary.items() if name not in (*heads, *_TABLES)}
    print_rows(f"{summary['scene']}: {summary['title']}", rows_of(figures))
    if trees := summary.get("trees"):
        print_table(table_of(trees))
    stems = summary.get("stems") or {}
    if shares := stems.get("bark_seen"):
        title = "stems within the radius, by the share of their bark at 1.3 m that the path sees"
        print_rows(title, _bark_classes(shares))
    if things := summary.get("things"):
        print_rows("on the ground", {kind: text_of(value) for kind, value in things.items()})
    if objects := summary.get("named"):
        print_rows("things", {thing["name"]: text_of(thing) for thing in objects})


def _bark_classes(shares: list[float]) -> dict[str, str]:
    """Return the number of stems by the share of their bark; a circle can be fitted to half of the bark."""
    names = ("none", "under a quarter", "under a half", "a half and more")
    counts = Counter(sum((share > 0.0, share >= 0.25, share >= 0.5)) for share in shares)
    return {name: count_text(counts[number]) for number, name in enumerate(names)}


_MOST_PULSES = 1_000_000
_FOLIAGE_FACTOR = 8  # on the pulses for means of worlds, whose single pulses cannot be compared


def accuracy(
    scene: SceneName,
    *,
    settings: Settings = None,
    pulses: Annotated[int, Option("Number of pulses to evaluate.", "N", ge=128, le=_MOST_PULSES)] = 8192,
    plot: PlotFile = None,
    as_json: AsJson = False,
) -> None:
    """Measure the error and the cost of settings of the beam and of foliage.

    Pulses from the whole run are received with each setting, without noise, and compared with their converged
    result from thousands of sub-rays. A forest cast leaf by leaf only up to some distance is compared with
    the fully explicit one by means over 8 times as many pulses. In a rig, the first sensor is evaluated.
    """
    from vlp16emu.extras.plot.sheet import plotting
    from vlp16emu.scenario import find, load, named_files

    scenario = load(scene, settings or [])
    with plotting(plot, [find(scene), *named_files(scenario)]) as draw:
        compile_first(scenario.world.kind)
        from vlp16emu.extras.accuracy.sweep import choices, measure_accuracy, measure_foliage

        with Progress(scenario.duration_s) as bar:
            beam = measure_accuracy(
                scenario, Path(scene).stem, pulses=pulses, done=partial(bar.show_share, "measuring")
            )
            foliage = measure_foliage(
                scenario, pulses=_FOLIAGE_FACTOR * pulses, done=partial(bar.show_share, "comparing worlds")
            )
        best = choices(beam.rows)
        choice_rows = [{"wanted_m": wanted_m, "take": name} for name, wanted_m in best.items()]
        tables = {"foliage": foliage, "choices": choice_rows}
        report = report_of("accuracy", dict(members(beam)) | tables)
        draw(report)
    if as_json:
        print_json(report)
        return
    _print_accuracy(beam)
    if foliage:
        _print_foliage(foliage)
    advice = "; ".join(f"{wanted_m:g} m: {name}" for name, wanted_m in best.items())
    print(f"For a mean error of {advice}" if advice else "No setting has a mean error below 0.5 m")
    print_file(plot)


def _print_accuracy(measured: "Accuracy") -> None:
    """Print settings of the beam as a table, with intervals; a star marks the one in use."""
    errors = measured.rows[0].errors
    print_line(f"{measured.scene}, seed {measured.seed}: error against run time")
    print(
        f"  {count_text(errors.pulses)} pulses, {count_text(errors.returns)} with a return; answer of "
        f"{count_text(measured.answer_rays)} sub-rays, "
        f"itself wrong by {1e3 * measured.answer_rmse_m:.2f} mm\n"
    )
    heads = [head for head, _ in _COLUMNS.values()]
    lines = [["setting of the beam", "us/pulse", "rays", *heads]]
    for row in measured.rows:
        cells = [f"{row.us_per_pulse:.2f}", f"{row.rays_per_pulse:.1f}"]
        for name, (_, factor) in _COLUMNS.items():
            value = factor * getattr(row.errors, name)
            cells.append(f"{value:.{max(_decimals(value), 1)}f}")
        lines.append([_with_star(row.name, in_use=row.in_use), *cells])
        intervals = [_interval(name, row.intervals[name]) for name in _COLUMNS]
        lines.append(["  95 %", f"+-{row.us_spread / 2:.2f}", "", *intervals])
    print_table(lines)
    pulses = 4 * errors.pulses  # an interval shrinks with the root of the number of pulses
    advice = "no more pulses can be evaluated"
    if pulses <= _MOST_PULSES:
        advice = f"--pulses {pulses} halves them"
    print(
        f"  95 %: interval of an error for all pulses of the scene; {advice}. ? is an interval wider than "
        "a factor of ten.\n"
        "  +-: half of the range of repeated run times."
    )


_COLUMNS: dict[str, tuple[str, float]] = {
    "mean_error_m": ("mean mm", 1e3),
    "range_rmse_m": ("RMSE", 1e3),
    "range_bias_m": ("bias", 1e3),
    "range_p95_m": ("p95", 1e3),
    "lost": ("lost %", 100.0),
    "invented": ("invented", 100.0),
    "wrong_strongest": ("wrong", 100.0),
    "wrong_last": ("last", 100.0),
    "reflectivity_rmse": ("refl.", 1.0),
}
"""Head of each column of errors, and the factor to the unit of the column."""


def _interval(name: str, ends: "Interval") -> str:
    """Format an interval in the unit of its column."""
    if ends is None:
        return "?"
    _, factor = _COLUMNS[name]
    values = [factor * end for end in ends]
    return "..".join(f"{value:.{_decimals(value)}f}" for value in values)


def _decimals(value: float) -> int:
    """Return the number of decimals that gives a value about two significant digits."""
    if abs(value) >= 10.0:
        return 0
    return 1 if abs(value) >= 1.0 else 2


def _print_foliage(levels: "Sequence[LevelOfDetail]") -> None:
    """Print the means of each world, and mark differences from the explicit world beyond chance."""
    print(
        "\nWorlds cast leaf by leaf to some distance, means over all pulses without noise; a pulse "
        "without a return\n"
        "has a range of sensor.max_range_m. +- is half of the 95 % interval of the difference from the "
        "explicit\n"
        "world, ! marks a difference beyond it; chance alone marks one in 20."
    )
    lines = [["world", "us per pulse", *levels[-1].means]]
    for level in levels:
        cells = (
            f"{mean.value:.2f} +-{mean.half:.2f}{'!' if mean.departs else ' '}"
            for mean in level.means.values()
        )
        lines.append([_with_star(level.name, in_use=level.in_use), f"{level.us_per_pulse:.2f}", *cells])
    print_table(lines)


def _with_star(name: str, *, in_use: bool) -> str:
    """Return the short name of a setting, with a star if the scene uses it."""
    short_name = name.removeprefix("beam.model=").removeprefix("world.").replace("beam.", "")
    return f"{short_name} *" if in_use else short_name
