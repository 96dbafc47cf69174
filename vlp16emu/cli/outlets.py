"""Options of `vlp16emu stream` for what leaves beside the packets, and the rows of its report."""

from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from vlp16emu.cli.terminal import count
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.sinks import OutletResult, Outlets
    from vlp16emu.streaming import Streamed

__all__ = ["GpsOut", "GpsPps", "ImuOut", "outlet_rows", "outlets_of"]

Line = Literal["dtr", "rts", "off"]
_LINES: tuple[Line, ...] = get_args(Line)


def _line(text: str) -> Line:
    """Read the line of the pulse."""
    for line in _LINES:
        if text == line:
            return line
    raise InputError("--gps-pps", f"found {text}", "dtr, rts or off")


GpsOut = Annotated[
    str | None,
    typer.Option(
        "--gps-out",
        metavar="PORT",
        help="Play the GPS receiver of the scene on a serial port, 9600 8N1: a device, or a URL of pyserial such as "
        "socket://127.0.0.1:5000.",
    ),
]
GpsPps = Annotated[
    Line,
    typer.Option(
        "--gps-pps",
        metavar="dtr|rts|off",
        parser=_line,
        help="Line of that port that carries the receiver's pulse.",
    ),
]
ImuOut = Annotated[
    str | None,
    typer.Option(
        "--imu-out",
        metavar="udp://HOST:PORT|serial:PORT",
        help="Send the samples of the inertial unit ([imu]) too, each at its time; on a serial port with 921600 8N1.",
    ),
]


def outlets_of(gps_out: str | None, gps_pps: Line, imu_out: str | None) -> "Outlets":
    """Take the options together."""
    from vlp16emu.sinks import Outlets

    return Outlets(gps_out, gps_pps, imu_out)


def outlet_rows(streamed: "Streamed") -> dict[str, str]:
    """Write what left beside the packets."""
    rows = dict[str, str]()
    if gps := streamed.gps_out:
        rows["sentences"] = _row(gps)
        if gps.line:
            has_none = f"none, as {gps.to} has no such line as {gps.line.upper()}"
            rows["pulses"] = has_none if gps.pulses is None else f"{count(gps.pulses)} on {gps.line.upper()}"
    if imu := streamed.imu_out:
        rows["samples"] = _row(imu)
    return rows


def _row(sent: "OutletResult") -> str:
    """Write how much went where, and what was lost."""
    row = f"{count(sent.messages)} to {sent.to}"
    if sent.dropped:
        row += f", {count(sent.dropped)} dropped"
    if sent.away:
        often = "once" if len(sent.away) == 1 else f"{count(len(sent.away))} times"
        row += f"; the device was away {often}, for {sum(time.away_s for time in sent.away):.1f} s"
    return row
