"""Verbs about scenes and this machine: scenes, schema, plan, doctor, cache, forest and accuracy."""

import logging
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vlp16emu.cli.arguments import AsJson, PlotFile, RunOptions, SceneName, Settings
from vlp16emu.cli.printer import (
    count,
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

    known = {}
    for name, path in scene_files().items():
        try:
            known[name] = load(str(path)), path
        except InputError as error:
            _log.warning("%s; left out", error)
    if not as_json:
        print_rows("scenes", {name: f"{s.duration_s:g} s  {s.title}" for name, (s, _) in known.items()})
        return
    rows = [
        {"name": name, "title": s.title, "duration_s": s.duration_s}
        | {"motion": s.motion.kind, "world": s.world.kind, "file": path}
        for name, (s, path) in known.items()
    ]
    print_json({"scenes": rows})


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
    making: RunOptions,
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
        report = report_of("plan", _plan(scene, making, duration_s, sample_s, repeats))
        draw(report)
    if as_json:
        print_json(report)
        return
    for title, on in (("has", True), ("leaves out", False)):
        if features := {need["name"]: need["costs"] for need in report["features"] if need["on"] is on}:
            print_rows(f"{scene} {title}", features)
    print_rows("in reach", rows_of(report["world"]))
    print_rows(
        "libraries", {name: "loaded" if on else "left out" for name, on in report["libraries"].items()}
    )
    costs = {stage["name"]: f"{stage['cpu_s_per_s']:.3f}" for stage in report["stages"]}
    print_rows("cost by stage, seconds of one core per simulated second", costs)
    print_rows(f"measured now, on {report['threads']} threads", rows_of(report["measured"]))
    print_rows("recording, estimated", rows_of(report["recording"]))
    print_rows("stream", rows_of(report["stream"]))
    if not report["stream"]["keeps_up"]:
        print(_TOO_SLOW)
    print_file(plot)


def _plan(scene: str, making: RunOptions, duration_s: float | None, sample_s: float, repeats: int) -> Tree:
    """Measure a scene, and return its plan."""
    began_s = time.perf_counter()
    emulator = make_emulator(scene, making)
    _, stop_s = emulator.scenario.span_s(0.0, duration_s)
    emulator.packets(0.0, stop_s)  # not taken: it refuses a walk that ends before
    from vlp16emu.extras.plan import libraries, needs, recording_outlook, stages, stream_outlook, surroundings

    emulator.record(os.devnull, duration_s=min(0.1, emulator.scenario.duration_s))
    started_s = time.perf_counter() - began_s
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
        "measured": {"started_s": started_s}
        | {name: getattr(measured, name) for name in ("simulated_s", "wall_s", "real_time_factor")},
        "recording": recording_outlook(engine, measured, started_s, stop_s),
        "stream": stream_outlook(emulator.scenario, measured.real_time_factor),
    }


def doctor(*, as_json: AsJson = False) -> None:
    """Check this machine: cores, kernels, Embree, ports, rights, clock, wake-ups, buffers, extras, disk.

    Each row is ok, a warning if some runs will suffer, or a problem if some will fail, with the remedy. The
    exit code is 1 if there is a problem. Wake-ups are measured under the present load of this machine.
    """
    from vlp16emu.extras.doctor import Condition, all_checks

    checks = list(all_checks())
    counts = {finding.value: sum(check.finding is finding for check in checks) for finding in Condition}
    if as_json:
        print_json({"checks": checks, **counts})
    else:
        mends = {check.name: f"; {check.mend}" if check.mend else "" for check in checks}
        print_rows(
            "this machine", {one.name: f"{one.finding:<7}  {one.found}{mends[one.name]}" for one in checks}
        )
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
    for name, kept in ("worlds", user_store()), ("kernels", user_kernels()):
        files, used = kept.clear() if clear else kept.kept()
        folder = str(kept.folder) if kept.folder else None
        tree[name] = {"folder": folder, "files": files, "bytes": used, "most_bytes": kept.most_bytes}
        limit = "" if clear else f" of at most {size(kept.most_bytes)}"
        rows[name] = f"{count(files)} files, {size(used)}{limit}, in {folder or 'no folder: nothing is kept'}"
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

    given = zip(_SUFFIXES, (inventory, stems, ground, glb), strict=True)
    wanted = {name: path for name, path in given if path is not None}
    scenario = load(scene, settings or ())
    inputs = [find(scene), *named_files(scenario)]
    for name, path in wanted.items():  # before anything heavy
        spare(inputs, path)
        if path.suffix != (suffix := _SUFFIXES[name]):
            raise InputError(f"{name} {path}", f"found the ending {path.suffix!r}", suffix)
    with plotting(plot, inputs) as draw:
        compile_first(scenario.world.kind)
        from vlp16emu.extras.survey import write_survey

        with Progress(0.0):
            summary = write_survey(scene, scenario, radius_m, wanted, bark=bark)
        written = {name.removeprefix("--"): str(path) for name, path in wanted.items()}
        report = report_of("forest", {**summary, "files": written})
        draw(report)
    if as_json:
        print_json(report)
        return
    _print_forest(summary)
    for file in (*wanted.values(), plot):
        print_file(file)


_MAPPED = "stems", "ground", "profile", "hall_m"  # members that only plots and programs use


def _print_forest(summary: Tree) -> None:
    figures = dict(summary)
    tables = {
        name: figures.pop(name, ()) for name in ("scene", "title", "trees", "things", "named", *_MAPPED)
    }
    print_rows(f"{summary['scene']}: {summary['title']}", rows_of(figures))
    if tables["trees"]:
        print_table(table_of(tables["trees"]))
    if seen := dict(tables["stems"] or {}).get("bark_seen"):
        print_rows(
            "stems within the radius, by the share of their bark at 1.3 m that the path sees", _classes(seen)
        )
    if tables["things"]:
        print_rows("on the ground", {kind: text_of(things) for kind, things in tables["things"].items()})
    if tables["named"]:
        print_rows("things", {one["name"]: text_of(one) for one in tables["named"]})


def _classes(shares: list[float]) -> dict[str, str]:
    """Return the number of shares in each class; half of the bark allows the fit of a circle."""
    counts = {"none": 0, "under a quarter": 0, "under a half": 0, "a half and more": 0}
    for share in shares:
        counts[list(counts)[(share > 0) + (share >= 0.25) + (share >= 0.5)]] += 1
    return {name: count(number) for name, number in counts.items()}


_MOST_PULSES = 1_000_000
_TIMES = 8  # factor on the pulses for means of worlds, whose single pulses cannot be compared


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

        with Progress(whole_s := scenario.duration_s) as bar:
            show = lambda share: bar.show("measuring", share * whole_s)  # noqa: E731
            measured = measure_accuracy(scenario, Path(scene).stem, pulses=pulses, done=show)
            show = lambda share: bar.show("comparing worlds", share * whole_s)  # noqa: E731
            foliage = measure_foliage(scenario, pulses=_TIMES * pulses, done=show)
        best = choices(measured.rows)
        taken = [{"wanted_m": wanted_m, "take": name} for name, wanted_m in best.items()]
        report = report_of("accuracy", dict(members(measured)) | {"foliage": foliage, "choices": taken})
        draw(report)
    if as_json:
        print_json(report)
        return
    _print_accuracy(measured)
    if foliage:
        _print_foliage(foliage)
    words = "; ".join(f"{wanted_m:g} m: {name}" for name, wanted_m in best.items())
    print(f"For a mean error of {words}" if words else "No setting has a mean error below 0.5 m")
    print_file(plot)


def _print_accuracy(measured: "Accuracy") -> None:
    """Print settings of the beam as a table, with intervals; a star marks the one in use."""
    errors = measured.rows[0].errors
    print_line(f"{measured.scene}, seed {measured.seed}: error against run time")
    print(
        f"  {count(errors.pulses)} pulses, {count(errors.returns)} with a return; answer of "
        f"{count(measured.answer_rays)} sub-rays, itself wrong by {1e3 * measured.answer_rmse_m:.2f} mm\n"
    )
    heads = "us/pulse", "rays", *(head for head, _ in _COLUMNS.values())
    lines = [["setting of the beam", *heads]]
    for row in measured.rows:
        cells = [f"{row.us_per_pulse:.2f}", f"{row.rays_per_pulse:.1f}"]
        for name, (_, unit) in _COLUMNS.items():
            value = unit * getattr(row.errors, name)
            cells.append(f"{value:.{max(_digits(value), 1)}f}")
        lines.append([_with_star(row.name, in_use=row.in_use), *cells])
        ends = [_interval(name, row.intervals[name]) for name in _COLUMNS]
        lines.append(["  95 %", f"+-{row.us_spread / 2:.2f}", "", *ends])
    print_table(lines)
    more = 4 * errors.pulses  # an interval shrinks with the root of the number of pulses
    halve = f"--pulses {more} halves them" if more <= _MOST_PULSES else "no more pulses can be evaluated"
    print(
        f"  95 %: interval of an error for all pulses of the scene; {halve}. ? is an interval wider than "
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
"""Head and unit of the columns of errors."""


def _interval(name: str, ends: "Interval") -> str:
    """Format an interval in the unit of its column."""
    if ends is None:
        return "?"
    values = [_COLUMNS[name][1] * end for end in ends]
    return "..".join(f"{value:.{_digits(value)}f}" for value in values)


def _digits(value: float) -> int:
    """Return the decimals of a number with about two significant digits."""
    return next((digits for least, digits in ((10.0, 0), (1.0, 1)) if abs(value) >= least), 2)


def _print_foliage(levels: "Sequence[LevelOfDetail]") -> None:
    """Print the means of each world; differences from the explicit world beyond chance are marked."""
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
    short = name.removeprefix("beam.model=").removeprefix("world.").replace("beam.", "")
    return f"{short} *" if in_use else short
