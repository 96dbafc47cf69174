"""`vlp16emu record`: a scene into a pcap file."""

import sys
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
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
    span_s,
)
from vlp16emu.cli.audit import NoAudit, audit_row, audit_tree, audited
from vlp16emu.cli.inputs import load_for
from vlp16emu.cli.interrupt import INTERRUPTED, stop_on_ctrl_c
from vlp16emu.cli.light import light_rows, light_tree
from vlp16emu.cli.output import count, print_json, print_rows, size
from vlp16emu.cli.progress import Progress
from vlp16emu.cli.rotor import revolutions, turned
from vlp16emu.cli.start import starting
from vlp16emu.cli.truth import SCENARIO, TruthPackets, TruthRate, TruthTo, with_truth

if TYPE_CHECKING:
    from vlp16emu.assembly import Unit
    from vlp16emu.sinks import PcapResult, PcapSink
    from vlp16emu.types import Packet

__all__ = ["record"]

OutFile = Annotated[
    Path,
    typer.Argument(
        metavar="OUT.pcap",
        help="File to write; overwritten if it exists. - is standard output; the report then goes to stderr.",
        show_default=False,
    ),
]


def record(
    scene: SceneName,
    out: OutFile,
    *,
    duration: Duration = None,
    start: Start = 0.0,
    settings: Settings = None,
    ideal: Ideal = False,
    threads: Threads = 0,
    no_audit: NoAudit = False,
    truth: TruthTo = None,
    truth_rate: TruthRate = 200,
    truth_packets: TruthPackets = False,
    as_json: AsJson = False,
) -> None:
    """Record a scene into a pcap file.

    The file holds data and position packets in order of sending, in the frames of a real sensor and
    stamped with simulated time. Ctrl-C ends it early and leaves a valid file.
    """
    began_s = time.perf_counter()
    with starting():
        scenario = load_for([out, truth and truth / SCENARIO], scene, settings, ideal=ideal)
        start_s, stop_s = span_s(start, duration, scenario.duration_s)
        emulator, audit = audited(scenario, threads=threads, no_audit=no_audit)
        from vlp16emu.sinks import PcapSink
        from vlp16emu.units import seconds_to_ns

    packets = emulator.packets(start_s, stop_s)  # checks the span before the file is touched
    asked_s, links = stop_s - start_s, [unit.link for unit in emulator.parts.units]
    with (
        stop_on_ctrl_c() as stop,
        with_truth(emulator, packets, start_s, truth, truth_rate, per_packet=truth_packets) as told,
        PcapSink(out, emulator.first_position_packets(start_s), links) as sink,
        Progress(asked_s) as progress,
    ):
        sent, done_s = _send(told, sink, progress, stop, scenario.start_ns + seconds_to_ns(start_s))
    report: dict[str, Any] = {"file": str(out), "scene": scene, "seed": scenario.seed} | light_tree(scenario)
    simulated_s = done_s if stop.is_set() else asked_s
    units = [_unit(unit, sent, simulated_s) for unit in emulator.parts.units]
    report |= _tree(sink.result, units, simulated_s, time.perf_counter() - began_s)
    with _beside(out):
        _print(report | {"audit": audit_tree(audit), "interrupted": stop.is_set()}, as_json=as_json)
    if stop.is_set():
        raise typer.Exit(INTERRUPTED)


def _beside(out: Path) -> AbstractContextManager[object]:
    """Print to where the file does not go."""
    from vlp16emu.sinks import STDOUT

    return redirect_stdout(sys.stderr) if out == STDOUT else nullcontext()


def _send(
    packets: "Iterable[Packet]", sink: "PcapSink", progress: Progress, stop: Event, begin_ns: int
) -> "tuple[Counter[tuple[int, str]], float]":
    """Write packets until they end or are to stop; count each unit's packets and returns, and simulated seconds."""
    from vlp16emu.cli.reading import returns_in
    from vlp16emu.units import S_NS

    sent, done_s = Counter[tuple[int, str]](), 0.0
    for packet in packets:
        if stop.is_set():
            break
        sink.send(packet)
        sent[packet.unit, packet.kind] += 1
        sent[packet.unit, "returns"] += returns_in(packet)
        done_s = (packet.due_ns - begin_ns) / S_NS
        progress.show("recording", done_s)
    return sent, done_s


def _unit(unit: "Unit", sent: "Counter[tuple[int, str]]", simulated_s: float) -> dict[str, Any]:
    """Tell what one unit sent, whence and whither, and how far it turned."""
    from vlp16emu.scenario.sensor import on_the_wire
    from vlp16emu.types import PacketKind

    sensor = on_the_wire(unit.section)
    return {
        "unit": unit.number + 1,
        "name": sensor.name,
        "address": sensor.address,
        "data_port": sensor.data_port,
        "position_port": sensor.position_port,
        "packets": sent[unit.number, PacketKind.DATA],
        "position_packets": sent[unit.number, PacketKind.POSITION],
        "returns": sent[unit.number, "returns"],
    } | turned(unit.head, simulated_s)


def _tree(
    written: "PcapResult", units: list[dict[str, Any]], simulated_s: float, wall_s: float
) -> dict[str, Any]:
    """Put what the run made and took into the types of JSON; `wall_s` is that of the whole command."""
    return {
        "packets": written.data_packets,
        "position_packets": written.position_packets,
        "returns": sum(unit["returns"] for unit in units),
        "units": units,
        "bytes": written.bytes,
        "sha256": written.sha256,
        "simulated_s": simulated_s,
        "wall_s": wall_s,
        "real_time_factor": simulated_s / wall_s,
    }


def _print(report: dict[str, Any], *, as_json: bool) -> None:
    """Print the report, for people unless as JSON."""
    if as_json:
        print_json(report)
        return
    units = report["units"] if len(report["units"]) > 1 else []
    print_rows(
        f"{'interrupted, kept' if report['interrupted'] else 'wrote'} {report['file']}",
        {
            "scene": f"{report['scene']}, seed {report['seed']}",
            **light_rows(report),
            "simulated": f"{report['simulated_s']:.1f} s",
            "revolutions": revolutions(report["units"]),
            "data packets": count(report["packets"]),
            "position packets": count(report["position_packets"]),
            "returns": count(report["returns"]),
        }
        | {f"unit {unit['unit']}": _line(unit) for unit in units}
        | {
            "size": size(report["bytes"]),
            "sha256": report["sha256"],
            "run time": f"{report['wall_s']:.1f} s, {report['real_time_factor']:.2f} x real time",
        }
        | audit_row(report["audit"]),
    )


def _line(unit: dict[str, Any]) -> str:
    """Write what one of several units sent."""
    sent = f"{count(unit['packets'])} data, {count(unit['position_packets'])} position"
    return f"{unit['name']}, {sent}, {count(unit['returns'])} returns, {unit['address']}:{unit['data_port']}"
