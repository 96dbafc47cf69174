"""Options of `vlp16emu stream` for what leaves beside the packets, and the rows of its report."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from vlp16emu.cli.arguments import one_of, option
from vlp16emu.cli.terminal import count

if TYPE_CHECKING:
    from vlp16emu.extras.bench.gps_in import GpsIn
    from vlp16emu.extras.bench.outlets import Outlets
    from vlp16emu.run.report import Streamed
    from vlp16emu.sinks import Away, OutletResult


Line = Literal["dtr", "rts", "off"]
Pulse = Literal["sentence", "cd", "cts", "dsr", "ri"]


GpsOut = Annotated[
    str | None,
    option(
        "--gps-out",
        "Play the GPS receiver of the scene on a serial port, 9600 8N1: a device, or a URL of pyserial such as "
        "socket://127.0.0.1:5000.",
        "PORT",
    ),
]
GpsPps = Annotated[Line, one_of("--gps-pps", "Line of that port that carries the receiver's pulse.", *get_args(Line))]
ImuOut = Annotated[
    str | None,
    option(
        "--imu-out",
        "Send the samples of the inertial unit ([imu]) too, each at its time; on a serial port with 921600 8N1.",
        "udp://HOST:PORT|serial:PORT",
    ),
]


GpsInPort = Annotated[
    str | None,
    option(
        "--gps-in",
        "Take pulse and sentences from a real GPS receiver, 9600 8N1, which then sets the sensor's clock: a device, or a URL "
        "of pyserial.",
        "PORT",
    ),
]
GpsInPulse = Annotated[
    Pulse,
    one_of(
        "--gps-in-pulse", "Line of that port that carries the pulse; sentence where none is wired.", *get_args(Pulse)
    ),
]


def gps_in_of(port: str | None, pulse: Pulse) -> "GpsIn | None":
    """Take the options together."""
    if port is None:
        return None
    from vlp16emu.extras.bench.gps_in import GpsIn

    return GpsIn(port, pulse)


def outlets_of(gps_out: str | None, gps_pps: Line, imu_out: str | None) -> "Outlets | None":
    """Take the options together."""
    if gps_out is None and imu_out is None:
        return None
    from vlp16emu.extras.bench.outlets import Outlets

    return Outlets(gps_out, gps_pps, imu_out)


def outlet_rows(streamed: "Streamed") -> dict[str, str]:
    """Write what left beside the packets."""
    rows = dict[str, str]()
    if gps := streamed.gps_out:
        rows["sentences"] = _row(gps)
        if gps.line:
            has_none = f"none, as {gps.to} has no such line as {gps.line.upper()}"
            rows["pulses"] = has_none if gps.pulses is None else f"{count(gps.pulses)} on {gps.line.upper()}"
    if gps_in := streamed.gps_in:
        heard = gps_in.heard
        rows["receiver"] = (
            f"{count(heard.sentences)} sentences from {gps_in.port}, {count(heard.pulses)} pulses, "
            f"{count(heard.refused)} garbled; {gps_in.state.name.lower()}{_away(gps_in.away)}"
        )
    if imu := streamed.imu_out:
        rows["samples"] = _row(imu)
    return rows


def _row(sent: "OutletResult") -> str:
    row = f"{count(sent.messages)} to {sent.to}"
    if sent.dropped:
        row += f", {count(sent.dropped)} dropped"
    return row + _away(sent.away)


def _away(times: Sequence["Away"]) -> str:
    if not times:
        return ""
    often = "once" if len(times) == 1 else f"{count(len(times))} times"
    return f"; the device was away {often}, for {sum(time.away_s for time in times):.1f} s"
