"""`vlp16emu points`: what a sensor of any kind sees of a scene, as points."""

import time
from collections.abc import Iterable
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vlp16emu.cli.arguments import (
    AsJson,
    Duration,
    Ideal,
    SceneName,
    Settings,
    Start,
    Threads,
    checked,
    span_s,
)
from vlp16emu.cli.inputs import load_for
from vlp16emu.cli.interrupt import INTERRUPTED, stop_on_ctrl_c
from vlp16emu.cli.output import count, print_json, print_rows, size
from vlp16emu.cli.progress import Progress
from vlp16emu.cli.rotor import revolutions, turned
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.assembly import Unit
    from vlp16emu.cli.export import Block, PointWriter

__all__ = ["points"]

OutFile = Annotated[
    Path,
    typer.Argument(
        metavar="OUT",
        help="File to write, .npz, .ply or .csv by its suffix; overwritten if it exists.",
        show_default=False,
    ),
]
WhichUnit = Annotated[
    int,
    typer.Option(
        "--unit",
        metavar="N",
        parser=checked("--unit", int, lambda n: n >= 1, "a whole number from 1"),
        help="Which sensor of a rig; 1 is that of [sensor].",
    ),
]
Truth = Annotated[
    bool,
    typer.Option("--truth", help="Tell what each point lies on: class, part, leaf or wood, plant, species."),
]


def points(
    scene: SceneName,
    out: OutFile,
    *,
    duration: Duration = None,
    start: Start = 0.0,
    settings: Settings = None,
    ideal: Ideal = False,
    truth: Truth = False,
    unit: WhichUnit = 1,
    threads: Threads = 0,
    as_json: AsJson = False,
) -> None:
    """Write the points of a scene, for a sensor of any beam table.

    Each point stands in the world and in the sensor's frame at the instant of its pulse, as a user would
    reckon it. No packets are made: ranges are not on their 2 mm grid. Ctrl-C leaves a valid file.
    """
    began_s = time.perf_counter()
    from vlp16emu.cli.cloud import COLUMNS, RETURN_NAMES, TRUTH_COLUMNS, cloud, comments
    from vlp16emu.cli.export import writing
    from vlp16emu.emulator import Emulator

    scenario = load_for([out], scene, settings, ideal=ideal)
    start_s, stop_s = span_s(start, duration, scenario.duration_s)
    if unit > (units := 1 + len(scenario.rig)):
        raise InputError("--unit", f"found {unit}", f"at most {units}, as the scene has {units} units")
    emulator = Emulator(scenario, threads=threads, truth=truth)
    blocks = cloud(emulator, unit - 1, start_s, stop_s, truth=truth)
    columns = COLUMNS + TRUTH_COLUMNS if truth else COLUMNS
    with (
        stop_on_ctrl_c() as stop,
        writing(out, columns, comments(scenario.start_utc.isoformat()), where=str(out)) as writer,
        Progress(stop_s - start_s) as progress,
    ):
        numbers, done_s = _write(blocks, writer, progress, stop, start_s)
    wall_s = time.perf_counter() - began_s
    report: dict[str, Any] = {"file": str(out), "scene": scene, "seed": scenario.seed}
    report |= _sensor(emulator.parts.units[unit - 1], done_s)
    report |= {"points": sum(numbers), "returns": dict(zip(RETURN_NAMES, numbers, strict=True))}
    report |= {"truth": truth, "bytes": out.stat().st_size, "simulated_s": done_s, "wall_s": wall_s}
    _print(report | {"real_time_factor": done_s / wall_s, "interrupted": stop.is_set()}, as_json=as_json)
    if stop.is_set():
        raise typer.Exit(INTERRUPTED)


def _write(
    blocks: "Iterable[tuple[Block, int]]",
    writer: "PointWriter",
    progress: Progress,
    stop: Event,
    start_s: float,
) -> tuple[list[int], float]:
    """Write blocks until they end or are to stop; count points by return number, and the simulated seconds."""
    import numpy as np

    from vlp16emu.units import S_NS

    numbers, done_s = np.zeros(3, np.int64), 0.0
    for block, end_ns in blocks:
        writer.write(block)
        numbers += np.bincount(block["return_number"], minlength=3)
        done_s = end_ns / S_NS - start_s
        progress.show("scanning", done_s)
        if stop.is_set():
            break
    return numbers.tolist(), done_s


def _sensor(unit: "Unit", simulated_s: float) -> dict[str, Any]:
    """Tell what the beam table, the resolution and the speed make of a sensor."""
    from vlp16emu.units import S_NS

    beams = unit.head.beams
    return {
        "unit": unit.number + 1,
        "sensor": unit.section.model,
        "beams": len(beams.elevation_deg),
        "elevation_deg": [float(beams.elevation_deg.min()), float(beams.elevation_deg.max())],
        "pulses_per_s": S_NS / beams.sequence_ns * len(beams.elevation_deg),
    } | turned(unit.head, simulated_s)


def _print(report: dict[str, Any], *, as_json: bool) -> None:
    """Print the report, for people unless as JSON."""
    if as_json:
        print_json(report)
        return
    low, high = report["elevation_deg"]
    returns = ", ".join(f"{count(n)} {name.replace('_', ' ')}" for name, n in report["returns"].items() if n)
    print_rows(
        f"{'interrupted, kept' if report['interrupted'] else 'wrote'} {report['file']}",
        {
            "scene": f"{report['scene']}, seed {report['seed']}",
            "sensor": f"{report['sensor']}: {report['beams']} beams from {low:g} to {high:g} deg",
            "rotor": f"{report['rpm']} rpm",
            "pulses": f"{count(round(report['pulses_per_s']))} per second",
            "simulated": f"{report['simulated_s']:.1f} s",
            "revolutions": revolutions([report]),
            "points": f"{count(report['points'])}{f': {returns}' if returns else ''}",
            "labels": "yes" if report["truth"] else "no, see --truth",
            "size": size(report["bytes"]),
            "run time": f"{report['wall_s']:.1f} s, {report['real_time_factor']:.2f} x real time",
        },
    )
