"""`vlp16emu stream`: a scene over UDP, in real time."""

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from vlp16emu.cli.arguments import (
    AsJson,
    DataPort,
    Duration,
    Ideal,
    PositionPort,
    SceneName,
    Settings,
    Threads,
    checked,
    span_s,
)
from vlp16emu.cli.audit import NoAudit, audit_tree, audited
from vlp16emu.cli.inputs import load_for
from vlp16emu.cli.interrupt import INTERRUPTED, stop_on_ctrl_c
from vlp16emu.cli.light import light_tree
from vlp16emu.cli.output import print_json, print_rows
from vlp16emu.cli.progress import Progress
from vlp16emu.cli.start import starting
from vlp16emu.cli.stream_report import behind_line, stream_rows, stream_tree
from vlp16emu.cli.truth import SCENARIO, TruthPackets, TruthRate, TruthTo, with_truth
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.cli.engine import Engine
    from vlp16emu.packets import Link
    from vlp16emu.sinks import FellBehind, PacketSink, StreamReport, UdpSink
    from vlp16emu.types import Packet

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
    truth: TruthTo = None,
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
        changes = [*(settings or ()), *_told_ports(data_port, position_port)]
        scenario = load_for([truth and truth / SCENARIO], scene, changes, ideal=ideal)
        start_s, stop_s = span_s(0.0, duration, scenario.duration_s)
        from vlp16emu.cli.engine import Engine

        emulator, audit = audited(scenario, threads=threads, no_audit=no_audit)
    engine, units = Engine(emulator, start_s, stop_s), emulator.parts.units
    head = {"scene": scene, "seed": scenario.seed, "to": to, "speed": speed, "late": late}
    with (
        stop_on_ctrl_c() as stop,
        with_truth(emulator, engine, start_s, truth, truth_rate, per_packet=truth_packets) as told,
        _opened([unit.link for unit in units], to, as_sensor=as_sensor) as sinks,
        Progress(stop_s) as progress,
    ):
        _announce(scene, to, [unit.link for unit in units], quiet=as_json)
        report = _send(told, engine, _Shown(sinks, progress, scenario.start_ns), head, stop)
    tree = head | light_tree(scenario) | stream_tree(units, sinks, report, engine.skipped, scenario, speed)
    _print(tree | {"audit": audit_tree(audit)}, as_json=as_json)


def _send(
    packets: "Iterator[Packet]",
    engine: "Engine",
    shown: "_Shown",
    head: dict[str, Any],
    stop: threading.Event,
) -> "StreamReport":
    """Send in real time, and print at once where the stream falls behind."""
    from vlp16emu.sinks import LOOK_AHEAD_PACKETS, Late, Pacer
    from vlp16emu.sinks import stream as send

    late, speed = Late(head["late"]), head["speed"]

    def notify(behind: "FellBehind") -> None:
        """Print that the stream falls behind."""
        shown.progress.say(behind_line(behind, engine.scenario, late, speed))

    return send(
        packets,
        shown,
        Pacer(speed),
        late=late,
        notify=notify,
        go_on_from=engine.go_on_from,
        stop=stop,
        look_ahead_packets=LOOK_AHEAD_PACKETS * shown.units,
    )


def _told_ports(data_port: int | None, position_port: int | None) -> list[str]:
    """Give the ports of the command line as settings."""
    ports = {"data_port": data_port, "position_port": position_port}
    return [f"sensor.{key}={port}" for key, port in ports.items() if port is not None]


def _announce(scene: str, to: str, links: "Sequence[Link]", *, quiet: bool) -> None:
    """Print what begins, at once, unless only JSON is wanted."""
    if not quiet:
        pairs = "; ".join(f"{link.data_port} and {link.position_port}" for link in links)
        print(f"streaming {scene} to {to}, ports {pairs}", flush=True)


@contextmanager
def _opened(links: "Sequence[Link]", to: str, *, as_sensor: bool) -> "Iterator[list[UdpSink]]":
    """Open the sockets of each unit."""
    from vlp16emu.sinks import UdpSink

    with ExitStack() as stack:
        yield [
            stack.enter_context(
                UdpSink(
                    to,
                    data_port=link.data_port,
                    position_port=link.position_port,
                    as_sensor=link.source if as_sensor else None,
                )
            )
            for link in links
        ]


class _Shown:
    """The sinks of all units as one that moves a progress bar."""

    def __init__(self, sinks: "Sequence[PacketSink]", progress: Progress, begin_ns: int) -> None:
        self._sinks, self._begin_ns = sinks, begin_ns
        self.progress, self.units = progress, len(sinks)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to close: the sinks belong to whoever opened them."""

    def send(self, packet: "Packet") -> None:
        """Send first, draw after."""
        self._sinks[packet.unit].send(packet)
        self.progress.show("streaming", (packet.due_ns - self._begin_ns) * 1e-9)


def _print(tree: dict[str, Any], *, as_json: bool) -> None:
    """Print the report, for people unless as JSON; where the stream was interrupted, exit as such."""
    if as_json:
        print_json(tree)
    else:
        ended = "interrupted" if tree["interrupted"] else "done"
        print_rows(f"{ended}: {tree['scene']} to {tree['to']}", stream_rows(tree))
    if tree["interrupted"]:
        raise typer.Exit(INTERRUPTED)
