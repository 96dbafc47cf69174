"""`vlp16emu stream`: a scene over UDP, in real time."""

import math
from typing import TYPE_CHECKING, Annotated

import typer

from vlp16emu.cli.arguments import (
    AsJson,
    DataPort,
    Duration,
    Ideal,
    NoAudit,
    PositionPort,
    SceneName,
    Settings,
    Threads,
    TruthFolder,
    TruthPackets,
    TruthRate,
    checked,
    truth_to,
)
from vlp16emu.cli.interrupt import INTERRUPTED, stop_on_ctrl_c
from vlp16emu.cli.output import print_json, print_rows, tree_of
from vlp16emu.cli.progress import Progress
from vlp16emu.cli.start import make_emulator, starting
from vlp16emu.cli.stream_report import behind_line, stream_rows
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator

__all__ = ["stream"]

_SLOWEST = 0.001
"""A simulated second in a quarter of an hour."""

To = Annotated[str, typer.Option("--to", metavar="HOST", help="Receiver; may be a broadcast address.")]
Speed = Annotated[
    float,
    typer.Option(
        "--speed",
        metavar="X",
        parser=checked(
            "--speed", float, lambda x: _SLOWEST <= x < math.inf, f"a number from {_SLOWEST:g} on"
        ),
        help="Simulated seconds per second.",
    ),
]


def _policy(text: str) -> str:
    """Read what happens to late packets."""
    if text not in ("pace", "skip"):
        raise InputError("--late", f"found {text}", "pace or skip")
    return text


LatePolicy = Annotated[
    str,
    typer.Option(
        "--late",
        metavar="pace|skip",
        parser=_policy,
        help="Packets late by more than 50 ms: leave at the sensor's own spacing, and the stream stays late (pace), or "
        "are dropped until it is at now (skip). Neither bursts.",
    ),
]
AsSensor = Annotated[
    bool,
    typer.Option(
        "--as-sensor",
        help="Send from the sensor's address, 192.168.1.201, which this machine must have, with its headers.",
    ),
]


def stream(
    scene: SceneName,
    *,
    to: To = "127.0.0.1",
    data_port: DataPort = None,
    position_port: PositionPort = None,
    duration: Duration = None,
    settings: Settings = None,
    ideal: Ideal = False,
    threads: Threads = 0,
    no_audit: NoAudit = False,
    truth: TruthFolder = None,
    truth_rate: TruthRate = 200,
    truth_packets: TruthPackets = False,
    speed: Speed = 1.0,
    late: LatePolicy = "pace",
    as_sensor: AsSensor = False,
    as_json: AsJson = False,
) -> None:
    """Stream a scene over UDP, each packet at its time.

    Nothing leaves this machine unless --to names another one. Packets are computed ahead; the first one
    starts the clock, and all deadlines count from there. Where the engine falls behind, a line says so at
    once, with settings that would keep up. Ctrl-C ends the stream.
    """
    with starting():
        changes = [*(settings or ()), *_ports(data_port, position_port)]
        emulator = make_emulator(scene, changes, ideal=ideal, threads=threads, audit=not no_audit)
        _, stop_s = emulator.scenario.span_s(0.0, duration)

    with stop_on_ctrl_c() as stop, Progress(stop_s) as progress:
        streamed = emulator.stream(
            to=to,
            duration_s=duration,
            truth=truth_to(truth, truth_rate, per_packet=truth_packets),
            speed=speed,
            late=late,
            as_sensor=as_sensor,
            opened=lambda: None if as_json else _announce(scene, to, emulator),
            progress=lambda done_s: progress.show("streaming", done_s),
            notify=lambda behind: progress.say(behind_line(behind, emulator.scenario, late, speed)),
            stop=stop,
        )
    if as_json:
        print_json(tree_of(streamed))
    else:
        ended = "interrupted" if streamed.interrupted else "done"
        print_rows(f"{ended}: {streamed.scene} to {streamed.to}", stream_rows(streamed))
    if streamed.interrupted:
        raise typer.Exit(INTERRUPTED)


def _announce(scene: str, to: str, emulator: "Emulator") -> None:
    """Print what begins, at once."""
    pairs = "; ".join(f"{unit.link.data_port} and {unit.link.position_port}" for unit in emulator.parts.units)
    print(f"streaming {scene} to {to}, ports {pairs}", flush=True)


def _ports(data_port: int | None, position_port: int | None) -> list[str]:
    """Make settings of the ports of the command line."""
    ports = {"data_port": data_port, "position_port": position_port}
    return [f"sensor.{key}={port}" for key, port in ports.items() if port is not None]
