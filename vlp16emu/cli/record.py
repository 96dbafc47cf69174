"""`vlp16emu record`: a scene into a pcap file."""

import sys
import time
from contextlib import nullcontext, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import argument, option, truth_to
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.cli.terminal import audit_rows, count, finish, light_rows, revolutions, size, tree_of
from vlp16emu.output import STDOUT

if TYPE_CHECKING:
    from vlp16emu.run.record import Recording, UnitRecording


_WHOLE = 0.995


def record(
    scene: args.SceneName,
    out: Annotated[
        str,
        argument(
            "OUT",
            "File to write, classic pcap (.pcap, .cap, .dump or no ending); overwritten if it exists. - is standard output; the report "
            "then goes to stderr. With .mcap (ROS 2), .bag (ROS 1), or a slash at its end (new folder, ROS 2) a bag, with the truth in it.",
        ),
    ],
    *,
    duration: args.Duration = None,
    start: args.Start = 0.0,
    split: Annotated[
        bool, option("--split", "Write each sensor of a rig into a file of its own: OUT_1.pcap and so on.")
    ] = False,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    threads: args.Threads = 0,
    no_audit: args.NoAudit = False,
    truth: args.TruthFolder = None,
    truth_rate: args.TruthRate = 200,
    truth_packets: args.TruthPackets = False,
    truth_returns: args.TruthReturns = False,
    as_json: args.AsJson = False,
) -> None:
    """Record a scene into a pcap file, or a bag.

    The file holds data and position packets in order of sending, in the frames of a real sensor and
    stamped with simulated time. Ctrl-C ends it early and leaves a valid file. Until its end it is
    OUT.pcap.part, which after kill -9 holds all whole packets.
    """
    began_s = time.perf_counter()
    emulator = make_emulator(scene, settings, ideal=ideal, threads=threads, audit=not no_audit)
    with running(emulator, "recording", start, duration) as span:
        truth_wanted = truth_to(truth, truth_rate, per_packet=truth_packets, per_return=truth_returns)
        recording = emulator.record(out, split=split, truth=truth_wanted, **span)
    wall_s = time.perf_counter() - began_s  # of the whole command
    recording = replace(recording, wall_s=wall_s, real_time_factor=recording.simulated_s / wall_s)
    on_stderr = redirect_stdout(sys.stderr) if Path(out) == STDOUT else nullcontext()
    with on_stderr:
        finish(tree_of(recording), recording.file, _rows(recording), as_json=as_json)


def _rows(recording: "Recording") -> dict[str, str]:
    units = recording.units if len(recording.units) > 1 else ()
    return {
        "scene": f"{recording.scene}, seed {recording.seed}",
        **light_rows(recording.beam, recording.noise, recording.weather),
        "simulated": f"{recording.simulated_s:.1f} s{_of_walk(recording.walk_share)}",
        "revolutions": revolutions([unit.turn for unit in recording.units]),
        "data packets": count(recording.packets),
        "position packets": count(recording.position_packets),
        "returns": count(recording.returns),
        **{topic: f"{count(number)} messages" for topic, number in (recording.messages or {}).items()},
        **{f"unit {unit.unit}": _line(unit) for unit in units},
        "size": size(recording.bytes),
        "sha256": recording.sha256,
        "run time": f"{recording.wall_s:.1f} s, {recording.real_time_factor:.2f} x real time",
        **audit_rows(recording.audit),
    }


def _of_walk(share: float | None) -> str:
    return f", {100 * share:.0f} % of the walk" if share is not None and share < _WHOLE else ""


def _line(unit: "UnitRecording") -> str:
    sent = f"{count(unit.packets)} data, {count(unit.position_packets)} position"
    return f"{unit.name}, {sent}, {count(unit.returns)} returns, {unit.address}:{unit.data_port}"
