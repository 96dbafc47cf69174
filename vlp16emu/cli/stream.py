"""`vlp16emu stream`: a scene over UDP, in real time."""

import math
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from vlp16emu.cli.arguments import (
    AsJson,
    DataPort,
    Duration,
    PositionPort,
    SceneName,
    Settings,
    Threads,
    checked,
    span_s,
)
from vlp16emu.cli.interrupt import INTERRUPTED, stop_on_ctrl_c
from vlp16emu.cli.output import count, print_json, print_rows
from vlp16emu.cli.progress import Progress

if TYPE_CHECKING:
    from vlp16emu.sinks import PacketSink, StreamReport, UdpResult
    from vlp16emu.types import Packet

__all__ = ["stream"]

To = Annotated[str, typer.Option("--to", metavar="HOST", help="Receiver; may be a broadcast address.")]
Speed = Annotated[
    float,
    typer.Option(
        "--speed",
        metavar="X",
        parser=checked("--speed", float, lambda x: 0 < x < math.inf, "a number above 0"),
        help="Simulated seconds per second.",
    ),
]
AsSensor = Annotated[
    bool,
    typer.Option(
        "--as-sensor", help="Send from 192.168.1.201, which this machine must have, with a sensor's headers."
    ),
]


def stream(
    scene: SceneName,
    *,
    to: To = "127.0.0.1",
    data_port: DataPort = 2368,
    position_port: PositionPort = 8308,
    duration: Duration = None,
    settings: Settings = None,
    threads: Threads = 0,
    speed: Speed = 1.0,
    as_sensor: AsSensor = False,
    as_json: AsJson = False,
) -> None:
    """Stream a scene over UDP, each packet at its time.

    Nothing leaves this machine unless --to names another one. Packets are computed ahead; the first one
    starts the clock, and all deadlines count from there. Ctrl-C ends the stream.
    """
    from vlp16emu.emulator import Emulator
    from vlp16emu.packets import FACTORY_LINK
    from vlp16emu.scenario import load
    from vlp16emu.sinks import Pacer, UdpSink
    from vlp16emu.sinks import stream as send

    scenario = load(scene, settings or [])
    start_s, stop_s = span_s(0.0, duration, scenario.duration_s)
    packets = Emulator(scenario, threads=threads).packets(start_s, stop_s)
    source = FACTORY_LINK.source if as_sensor else None
    with (
        stop_on_ctrl_c() as stop,
        UdpSink(to, data_port=data_port, position_port=position_port, as_sensor=source) as sink,
        Progress(stop_s) as progress,
    ):
        if not as_json:
            print(f"streaming {scene} to {to}, ports {data_port} and {position_port}", flush=True)
        report = send(packets, _Shown(sink, progress, scenario.start_ns), Pacer(speed), stop=stop)
    where = {"to": to, "data_port": data_port, "position_port": position_port, "speed": speed}
    tree = {"scene": scene, "seed": scenario.seed} | where | _tree(sink.result, report)
    _print(tree, as_json=as_json)
    if report.interrupted:
        raise typer.Exit(INTERRUPTED)


class _Shown:
    """A sink that moves a progress bar."""

    def __init__(self, sink: "PacketSink", progress: Progress, begin_ns: int) -> None:
        self._sink, self._progress, self._begin_ns = sink, progress, begin_ns

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to close: the sink belongs to whoever opened it."""

    def send(self, packet: "Packet") -> None:
        """Send first, draw after."""
        self._sink.send(packet)
        self._progress.show("streaming", (packet.due_ns - self._begin_ns) * 1e-9)


def _tree(sent: "UdpResult", report: "StreamReport") -> dict[str, Any]:
    """Put how the stream went into the types of JSON."""
    late = report.lateness
    return {
        "packets": sent.data_packets,
        "position_packets": sent.position_packets,
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
            "data packets": count(tree["packets"]),
            "position packets": count(tree["position_packets"]),
            "simulated": f"{tree['simulated_s']:.1f} s in {tree['wall_s']:.1f} s",
            "lateness": (
                f"median {tree['late_median_us']:.0f} us, 99 % within {tree['late_p99_us']:.0f} us, "
                f"at most {tree['late_max_us']:.0f} us"
            ),
            "fell behind": behind,
        },
    )
