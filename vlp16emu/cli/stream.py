"""`vlp16emu stream`: a scene over UDP, in real time.

It reports at once where it falls behind, and at its end.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import number, one_of, option, truth_to
from vlp16emu.cli.live import FlownFile, PoseIn, View, late_of, live_rows, poses_in, watched
from vlp16emu.cli.outlets import GpsInPort, GpsInPulse, GpsOut, GpsPps, ImuOut, gps_in_of, outlet_rows, outlets_of
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import (
    INTERRUPTED,
    Progress,
    audit_rows,
    count,
    light_rows,
    print_json,
    print_rows,
    revolutions,
    stop_on_ctrl_c,
    tree_of,
)
from vlp16emu.cli.web import HttpAt, HttpSettings, served
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator
    from vlp16emu.run.replay import Replayed
    from vlp16emu.run.report import Behind, Streamed
    from vlp16emu.scenario import Scenario
    from vlp16emu.sinks import FellBehind


T = TypeVar("T", "Streamed", "Replayed")

_POLICY = {
    "pace": "the delay stays, at the sensor's own spacing (--late pace)",
    "skip": "late packets are dropped until the stream is at now (--late skip)",
}


def behind_line(behind: "FellBehind", scenario: "Scenario", late: str, speed: float) -> str:
    """Write the line that is printed when the stream falls behind."""
    from vlp16emu.run.report import cause_of, options_for

    line = f"behind: {behind.behind_s:.3f} s late at {behind.at_s:.1f} s, as {cause_of(behind)}; {_POLICY[late]}"
    options = options_for([behind], scenario, speed)
    return f"{line}; to keep up: {', or '.join(options)}" if options else line


def stream_rows(streamed: "Streamed") -> dict[str, str]:
    """Write the rows of the report."""
    rows = {
        **light_rows(streamed.beam, streamed.noise, streamed.weather),
        "data packets": count(streamed.packets),
        "position packets": count(streamed.position_packets),
        "simulated": f"{streamed.simulated_s:.1f} s in {streamed.wall_s:.1f} s",
        "revolutions": revolutions([unit.turn for unit in streamed.units]),
        **outlet_rows(streamed),
        **lateness_rows(streamed),
        **live_rows(streamed.live),
    }
    if streamed.moved_s:
        rows["moved"] = moved_row(streamed)
    if streamed.skipped_packets or streamed.skipped_position_packets:
        data, position = count(streamed.skipped_packets), count(streamed.skipped_position_packets)
        rows["skipped"] = f"{data} data packets, {position} position packets"
    if streamed.keeps_up_with:
        rows["to keep up"] = ", or ".join(streamed.keeps_up_with)
    return rows | audit_rows(streamed.audit)


def lateness_rows(sent: "Streamed | Replayed") -> dict[str, str]:
    """Write how punctual packets were."""
    most_s = max((behind.behind_s for behind in sent.behind), default=0.0)
    rows = {
        "lateness": (
            f"median {_time(sent.late_median_us)}, 99 % within {_time(sent.late_p99_us)}, "
            f"at most {_time(sent.late_max_us)}"
        ),
        "fell behind": _times(sent.behind, most_s),
    }
    if sent.delay_s:
        rows["delay"] = f"late by {sent.delay_s:.2f} s since {sent.behind[-1].at_s:.1f} s"
    return rows


def moved_row(sent: "Streamed | Replayed") -> str:
    """Write by how much packets were moved into the present, and how well the clocks agree there."""
    row, first = f"by {sent.moved_s:+d} s into the present", sent.first
    if first is None or first.sensor_ns is None:
        return row
    apart_ms = (first.host_ns - first.sensor_ns) * 1e-6
    return f"{row}; by this machine's clock packet 0 left {apart_ms:.3f} ms after its time by the sensor's"


def _times(times: "Sequence[Behind]", most_s: float) -> str:
    """Write how often, by how much, when first and why a stream fell behind."""
    if not times:
        return "never"
    often = "once" if len(times) == 1 else f"{count(len(times))} times"
    most = f"by {most_s:.2f} s" + (" at most" if len(times) > 1 else "")
    first = "first at" if len(times) > 1 else "at"
    causes = ", ".join(dict.fromkeys(behind.cause for behind in times[:3]))
    return f"{often}, {most}, {first} {times[0].at_s:.1f} s: {causes}"


def _time(us: float) -> str:
    if us < 10_000:
        return f"{us:.0f} us"
    return f"{us * 1e-3:.0f} ms" if us < 1e6 else f"{us * 1e-6:.2f} s"


_LATE = 1
"""Exit code of a strict stream that was late."""
_SLOWEST = 0.001
"""A simulated second in a quarter of an hour."""


def receiver_of(to: str | None, data_port: int | None, interface: str | None) -> tuple[str, int | None]:
    """Split a receiver into its host and the port of data packets, which may be behind it; by default all stations."""
    if to is None:
        to = "127.0.0.1" if interface is None else "255.255.255.255"
    host, colon, port = to.partition(":")
    if not colon:
        return to, data_port
    if not (port.isascii() and port.isdecimal() and 1 <= int(port) <= 65_535):
        raise InputError("--to", f"found {to}", "HOST or HOST:PORT, with a port from 1 to 65535")
    if data_port not in (None, int(port)):
        raise InputError("--to", f"found {to} beside --data-port {data_port}", "one port for data packets")
    return host, int(port)


To = Annotated[
    str | None,
    option(
        "--to",
        "Receiver; may be a broadcast address. The port is that of data packets, as --data-port. "
        "Left out it is this machine, 127.0.0.1, and with --interface all stations behind that, 255.255.255.255.",
        "HOST[:PORT]",
    ),
]
Speed = Annotated[float, number("--speed", "Simulated seconds per second.", "X", _SLOWEST)]

Strict = Annotated[bool, option("--strict", "End with 1 where packets were late by more than 50 ms, or were skipped.")]

Now = Annotated[
    bool,
    option(
        "--now", "Move time stamps and sentences by whole seconds into the present, for drivers that trust GPS time."
    ),
]


LatePolicy = Annotated[
    str,
    one_of(
        "--late",
        "Packets late by more than 50 ms: leave at the sensor's own spacing, and the stream stays late (pace), or "
        "are dropped until it is at now (skip). Neither bursts.",
        "pace",
        "skip",
    ),
]
AsSensor = Annotated[
    bool,
    option(
        "--as-sensor", "Send from the sensor's address, 192.168.1.201, which this machine must have, with its headers."
    ),
]

Interface = Annotated[
    str | None,
    option(
        "--interface",
        "The same by this network interface of the machine, for instance eth0, whatever its routes are.",
        "IFACE",
    ),
]


def stream(
    scene: args.SceneName,
    *,
    to: To = None,
    data_port: args.DataPort = None,
    position_port: args.PositionPort = None,
    duration: args.Duration = None,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    threads: args.Threads = 0,
    no_audit: args.NoAudit = False,
    truth: args.TruthFolder = None,
    truth_rate: args.TruthRate = 200,
    truth_packets: args.TruthPackets = False,
    truth_returns: args.TruthReturns = False,
    speed: Speed = 1.0,
    late: LatePolicy = "pace",
    as_sensor: AsSensor = False,
    interface: Interface = None,
    now: Now = False,
    prepare: Annotated[
        bool,
        option(
            "--prepare",
            "Compute the whole run into a temporary file before the first packet leaves; then the engine cannot be "
            "too slow. It takes 3.4 GB for an hour of single return.",
        ),
    ] = False,
    prepare_to: Annotated[
        Path | None, option("--prepare-to", "The same into a file that is kept.", "FILE.pcap")
    ] = None,
    http: HttpAt = None,
    http_settings: HttpSettings = None,
    strict: Strict = False,
    view: View = False,
    pose_in: PoseIn = None,
    flown: FlownFile = None,
    gps_out: GpsOut = None,
    gps_pps: GpsPps = "dtr",
    imu_out: ImuOut = None,
    gps_in: GpsInPort = None,
    gps_in_pulse: GpsInPulse = "sentence",
    as_json: args.AsJson = False,
) -> None:
    """Stream a scene over UDP, each packet at its time.

    Nothing leaves this machine unless --to names another one. Packets are computed ahead; the first one
    starts the clock, and all deadlines count from there. Where the engine falls behind, a line says so at
    once, with settings that would keep up. Ctrl-C ends the stream.
    """
    to, data_port = receiver_of(to, data_port, interface)
    ports = {"data_port": data_port, "position_port": position_port}
    changes = [*(settings or ()), *(f"sensor.{key}={port}" for key, port in ports.items() if port is not None)]
    emulator = make_emulator(scene, changes, ideal=ideal, threads=threads, audit=not no_audit)
    late = late_of(emulator.scenario, late)
    _, stop_s = emulator.scenario.span_s(0.0, duration)
    with (
        watched(emulator, view=view, duration_s=stop_s, quiet=as_json) as watch,
        stop_on_ctrl_c() as stop,
        Progress(stop_s) as progress,
        _prepared(prepare_to, wanted=prepare) as capture,
    ):
        streamed = emulator.stream(
            to=to,
            duration_s=duration,
            truth=truth_to(truth, truth_rate, per_packet=truth_packets, per_return=truth_returns),
            speed=speed,
            late=late,
            as_sensor=as_sensor or interface is not None,
            interface=interface,
            now=now,
            prepare=capture,
            http=served(http, http_settings, quiet=as_json),
            poses=poses_in(emulator.scenario, pose_in, flown, progress.say),
            outlets=outlets_of(gps_out, gps_pps, imu_out),
            gps_in=gps_in_of(gps_in, gps_in_pulse),
            watched=watch.sink if watch else lambda sink, _: sink,
            opened=lambda: None if as_json else _announce(scene, to, emulator),
            preparing=partial(progress.show, "preparing"),
            progress=partial(progress.show, "streaming"),
            notify=lambda behind: progress.say(behind_line(behind, emulator.scenario, late, speed)),
            stop=stop,
        )
    close(streamed, f"{streamed.scene} to {streamed.to}", stream_rows, strict=strict, as_json=as_json)


@contextmanager
def _prepared(path: Path | None, *, wanted: bool) -> Iterator[Path | None]:
    """Give the file that a run is prepared in, if it is, and remove it where it shall not stay."""
    if path is not None or not wanted:
        yield path
        return
    with TemporaryDirectory(prefix="vlp16emu-") as folder:
        yield Path(folder) / "prepared.pcap"


def close(sent: T, what: str, rows: Callable[[T], dict[str, str]], *, strict: bool, as_json: bool) -> None:
    """Print the report of a stream or a replay, and exit as its end asks for."""
    if as_json:
        print_json(tree_of(sent))
    else:
        print_rows(f"{'interrupted' if sent.interrupted else 'done'}: {what}", rows(sent))
    if strict and sent.behind:  # also where packets were skipped
        raise typer.Exit(_LATE)
    if sent.interrupted:
        raise typer.Exit(INTERRUPTED)


def _announce(scene: str, to: str, emulator: "Emulator") -> None:
    pairs = "; ".join(f"{unit.link.data_port} and {unit.link.position_port}" for unit in emulator.parts.units)
    print(f"streaming {scene} to {to}, ports {pairs}", flush=True)
