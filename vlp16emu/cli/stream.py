"""`vlp16emu stream`: a scene over UDP, in real time."""

import math
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
from vlp16emu.cli.audit import NoAudit, audit_row, audit_tree, audited
from vlp16emu.cli.inputs import load_for
from vlp16emu.cli.interrupt import INTERRUPTED, stop_on_ctrl_c
from vlp16emu.cli.light import light_rows, light_tree
from vlp16emu.cli.output import count, print_json, print_rows
from vlp16emu.cli.progress import Progress
from vlp16emu.cli.rotor import revolutions, turned
from vlp16emu.cli.start import starting
from vlp16emu.cli.truth import SCENARIO, TruthPackets, TruthRate, TruthTo, with_truth

if TYPE_CHECKING:
    from vlp16emu.assembly import Unit
    from vlp16emu.packets import Link
    from vlp16emu.scenario import Scenario
    from vlp16emu.sinks import PacketSink, StreamReport, UdpResult, UdpSink
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
    as_sensor: AsSensor = False,
    as_json: AsJson = False,
) -> None:
    """Stream a scene over UDP, each packet at its time.

    Nothing leaves this machine unless --to names another one. Packets are computed ahead; the first one
    starts the clock, and all deadlines count from there. Ctrl-C ends the stream.
    """
    with starting():
        changes = [*(settings or ()), *_told_ports(data_port, position_port)]
        scenario = load_for([truth and truth / SCENARIO], scene, changes, ideal=ideal)
        start_s, stop_s = span_s(0.0, duration, scenario.duration_s)
        emulator, audit = audited(scenario, threads=threads, no_audit=no_audit)
        from vlp16emu.sinks import LOOK_AHEAD_PACKETS, Pacer
        from vlp16emu.sinks import stream as send
    packets = emulator.packets(start_s, stop_s)
    links = [unit.link for unit in emulator.parts.units]
    with (
        stop_on_ctrl_c() as stop,
        with_truth(emulator, packets, start_s, truth, truth_rate, per_packet=truth_packets) as told,
        _opened(links, to, as_sensor=as_sensor) as sinks,
        Progress(stop_s) as progress,
    ):
        _announce(scene, to, links, quiet=as_json)
        shown, ahead = _Shown(sinks, progress, scenario.start_ns), LOOK_AHEAD_PACKETS * len(sinks)
        report = send(told, shown, Pacer(speed), stop=stop, look_ahead_packets=ahead)
    tree = _head(scenario, scene, to, speed) | _tree(emulator.parts.units, sinks, report)
    _print(tree | {"audit": audit_tree(audit)}, as_json=as_json)
    if report.interrupted:
        raise typer.Exit(INTERRUPTED)


def _told_ports(data_port: int | None, position_port: int | None) -> list[str]:
    """Give the ports of the command line as settings."""
    ports = {"data_port": data_port, "position_port": position_port}
    return [f"sensor.{key}={port}" for key, port in ports.items() if port is not None]


def _head(scenario: "Scenario", scene: str, to: str, speed: float) -> dict[str, Any]:
    """Tell what was streamed, and whither."""
    return {
        "scene": scene,
        "seed": scenario.seed,
        "to": to,
        "speed": speed,
    } | light_tree(scenario)


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
        self._sinks, self._progress, self._begin_ns = sinks, progress, begin_ns

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to close: the sinks belong to whoever opened them."""

    def send(self, packet: "Packet") -> None:
        """Send first, draw after."""
        self._sinks[packet.unit].send(packet)
        self._progress.show("streaming", (packet.due_ns - self._begin_ns) * 1e-9)


def _unit(unit: "Unit", sent: "UdpResult", simulated_s: float) -> dict[str, Any]:
    """Tell what one unit sent, whither, and how far it turned."""
    return {
        "unit": unit.number + 1,
        "data_port": unit.link.data_port,
        "position_port": unit.link.position_port,
        "packets": sent.data_packets,
        "position_packets": sent.position_packets,
    } | turned(unit.head, simulated_s)


def _tree(streamed: "Sequence[Unit]", sinks: "Sequence[UdpSink]", report: "StreamReport") -> dict[str, Any]:
    """Put how the stream went into the types of JSON; ports are those of the first unit."""
    late = report.lateness
    pairs = zip(streamed, sinks, strict=True)
    units = [_unit(unit, sink.result, report.simulated_s) for unit, sink in pairs]
    return {
        "data_port": units[0]["data_port"],
        "position_port": units[0]["position_port"],
        "packets": sum(unit["packets"] for unit in units),
        "position_packets": sum(unit["position_packets"] for unit in units),
        "units": units,
        "simulated_s": report.simulated_s,
        "wall_s": report.wall_s,
        "real_time_factor": report.real_time_factor,
        "late_median_us": late.median_ns * 1e-3,
        "late_p99_us": late.p99_ns * 1e-3,
        "late_max_us": late.max_ns * 1e-3,
        "fell_behind": report.fell_behind,
        "most_behind_s": report.most_behind_s,
        "interrupted": report.interrupted,
    }


def _print(tree: dict[str, Any], *, as_json: bool) -> None:
    """Print the report, for people unless as JSON."""
    if as_json:
        print_json(tree)
        return
    behind = "never"
    if tree["fell_behind"]:
        behind = f"{count(tree['fell_behind'])} times, by {tree['most_behind_s']:.3f} s at most"
    print_rows(
        f"{'interrupted' if tree['interrupted'] else 'done'}: {tree['scene']} to {tree['to']}",
        {
            **light_rows(tree),
            "data packets": count(tree["packets"]),
            "position packets": count(tree["position_packets"]),
            "simulated": f"{tree['simulated_s']:.1f} s in {tree['wall_s']:.1f} s",
            "revolutions": revolutions(tree["units"]),
            "lateness": (
                f"median {tree['late_median_us']:.0f} us, 99 % within {tree['late_p99_us']:.0f} us, "
                f"at most {tree['late_max_us']:.0f} us"
            ),
            "fell behind": behind,
        }
        | audit_row(tree["audit"]),
    )
