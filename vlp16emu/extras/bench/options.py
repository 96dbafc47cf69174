"""Options of a stream's web interfaces, pose input and serial lines. They need no library, as help must be quick."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from vlp16emu.errors import InputError
from vlp16emu.run.options import LAST_PORT, Option, Options, StreamOptions


def host_and_port(text: str, option: str, expected: str, scheme: str = "") -> tuple[str, int]:
    """Return host and port of HOST:PORT after a scheme, IPv6 addresses in brackets; without a scheme the host may be empty.

    Raises InputError with `option` in front if it is malformed.
    """
    host, _, port = text.removeprefix(scheme).rpartition(":")
    is_place = text.startswith(scheme) and (host or not scheme)
    if not (is_place and port.isascii() and port.isdecimal() and int(port) <= LAST_PORT):
        raise InputError(option, f"found {text}", expected)
    return host.strip("[]"), int(port)


@dataclass(frozen=True)
class Http(Options):
    """Web interfaces of a stream's sensors."""

    at: Annotated[
        str,
        Option(
            "Serve the sensor's web interface, which the stream follows; for a rig on this port and the next ones. "
            "PORT alone is on 127.0.0.1.",
            "HOST:PORT",
            "--http",
        ),
    ]
    saved: Annotated[
        Path | None,
        Option(
            "File that keeps the settings saved in the web interface from run to run.",
            "FILE",
            "--http-settings",
        ),
    ] = None  # file of the first sensor; files of other sensors have its name with their number
    serving: Callable[[list[tuple[str, int]]], None] = lambda _: None
    """Called with address and port of each interface, before the first packet leaves."""
    controlled: Callable[[Any], None] = lambda _: (
        None
    )  # called before `serving`, with the `Control` of the sensors

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.address  # raises an error before a world is grown

    @property
    def address(self) -> tuple[str, int]:
        """Host, and port of the first sensor; 0 for free ports. InputError if it is malformed."""
        host, port = host_and_port(self.at, "--http", "HOST:PORT, such as 127.0.0.1:8080")
        return host or "127.0.0.1", port


@dataclass(frozen=True)
class PosesIn(Options):
    """Poses of a live scene."""

    where: Annotated[
        str | None,
        Option(
            'Address for live poses, for a scene with motion.kind = "live"; the stream waits for the first one.',
            "udp://HOST:PORT",
            "--pose-in",
        ),
    ] = None  # None if only `Emulator.put_pose` gives poses
    flown: Annotated[
        Path | None,
        Option(
            "Write the flight of such a scene, to repeat the run with --set motion.flown=FILE.csv.",
            "FILE.csv",
            "--flown",
        ),
    ] = None
    news: Callable[[str], None] = lambda _: (
        None
    )  # called with a line when the stream waits for poses or loses them


@dataclass(frozen=True)
class Outlets(Options):
    """Outputs of a stream beside the packets of the sensors."""

    gps_out: Annotated[
        str | None,
        Option(
            "Play the GPS receiver of the scene on a serial port, 9600 8N1: a device, or a URL of pyserial such as "
            "socket://127.0.0.1:5000.",
            "PORT",
        ),
    ] = None
    gps_pps: Annotated[
        str, Option("Line of that port for the receiver's pulse.", words=("dtr", "rts", "off"))
    ] = "dtr"  # a null-modem cable connects DTR to DCD, where programs expect the pulse
    imu_out: Annotated[
        str | None,
        Option(
            "Also send the samples of the inertial unit ([imu]), each at its time; on a serial port with 921600 8N1.",
            "udp://HOST:PORT|serial:PORT",
        ),
    ] = None


@dataclass(frozen=True)
class GpsIn(Options):
    """A real GPS receiver that is wired to the sensors."""

    port: Annotated[
        str,
        Option(
            "Take pulse and sentences from a real GPS receiver, 9600 8N1, which then sets the sensor's clock: a device, "
            "or a URL of pyserial.",
            "PORT",
            "--gps-in",
        ),
    ]
    pulse: Annotated[
        str,
        Option(
            "Line of that port for the pulse; sentence if none is wired.",
            name="--gps-in-pulse",
            words=("sentence", "cd", "cts", "dsr", "ri"),
        ),
    ] = "sentence"  # with `sentence` a second begins `gps.sentence_delay_s` before its sentence


@dataclass(frozen=True)
class BenchOptions(StreamOptions):
    """Options of a stream and of its additional inputs and outputs."""

    http: Http | None = None  # None for no web interfaces
    poses: PosesIn | None = (
        None  # the stream of a live scene begins with the first pose, and drops late packets
    )
    outlets: Outlets | None = None
    gps_in: GpsIn | None = None  # sets the clock of the sensors instead of the receiver of the scene
