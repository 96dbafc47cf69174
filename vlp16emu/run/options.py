"""Options of runs, each declared once as a field of a frozen dataclass: name, unit, limits and help.

Python uses the dataclasses directly; `vlp16emu.cli.verb` makes command-line options from the same fields.
They need no library, so `vlp16emu stream --help` loads nothing else.
"""

import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Annotated, NamedTuple, Self, TypedDict, get_args, get_origin

from vlp16emu.errors import InputError
from vlp16emu.hosts import LAST_PORT, LOOPBACK, host_and_port, is_ipv6

_LONGEST_S = 7 * 86_400  # longest scene
_SLOWEST = 0.001  # one simulated second in a quarter of an hour
_UNITS = ("_s", "_hz", "_m", "_deg", "_px")
"""Units at the end of field names; command-line options have names without them."""


@dataclass(frozen=True, slots=True)
class Option:
    """Meaning of a value, and its valid values.

    Parameters
    ----------
    help : one or two sentences
    metavar : placeholder of the value in help; None for a flag or a choice
    name : name on the command line; by default the field's name without unit. A name without dashes is an
        argument
    ge, gt, le, lt : limits of a number
    words : valid texts
    parse : parses the text of the command line, ValueError if invalid; by default the type of the field
    expected : valid values in words; by default made from limits and words
    shown : whether help shows the default, or the text that it shows instead
    """

    help: str
    metavar: str | None = None
    name: str | None = None
    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    words: tuple[str, ...] = ()
    parse: Callable[[str], object] | None = None
    expected: str | None = None
    shown: bool | str = True

    def check(self, where: str, kind: type, value: object, found: object = None) -> None:
        """Raise InputError for `where` if `value` is not valid."""
        if "" in (value, found):
            raise InputError(where, "found an empty text", self._expected(kind))
        limits = (
            (operator.ge, self.ge),
            (operator.gt, self.gt),
            (operator.le, self.le),
            (operator.lt, self.lt),
        )
        if isinstance(value, int | float) and kind in (int, float):
            kept = [holds(value, limit) for holds, limit in limits if limit is not None]
            is_right = abs(value) < math.inf and all(kept)  # `math.isfinite` fails for an integer above 1e308
        else:
            is_right = not self.words or value in self.words
        if not is_right:
            raise InputError(where, f"found {value if found is None else found}", self._expected(kind))

    def read(self, where: str, kind: type, text: str) -> object:
        """Return the value of a text of the command line; InputError for `where` if it is not valid."""
        try:
            value = (self.parse or kind)(text)
        except ValueError:
            raise InputError(where, f"found {text}", self._expected(kind)) from None
        self.check(where, kind, value, text)
        return value

    def _expected(self, kind: type) -> str:
        if self.expected:
            return self.expected
        if self.words:
            return f"{', '.join(self.words[:-1])} or {self.words[-1]}"
        if kind not in (int, float):
            return f"a value, {self.metavar}" if self.metavar else "a value"
        number = "a whole number" if kind is int else "a number"
        if self.ge is not None and self.le is not None:
            return f"{number} from {self.ge:.12g} to {self.le:.12g}"
        limits = {"at least": self.ge, "above": self.gt, "at most": self.le, "below": self.lt}
        words = " and ".join(f"{word} {limit:.12g}" for word, limit in limits.items() if limit is not None)
        return f"{number} {words}".rstrip()


class Declared(NamedTuple):
    """A field that is an option."""

    field: str
    name: str  # name on the command line: with dashes, or the word of an argument
    kind: type  # type of the value, without None; `list` if the option can be repeated
    default: object  # MISSING if there is none
    option: Option


def declared(name: str, annotation: object, default: object = MISSING) -> Declared | None:
    """Return the option that `Annotated[kind, Option(...)]` declares; None if it declares none."""
    if get_origin(annotation) is not Annotated:
        return None
    inner, *others = get_args(annotation)
    option = next((other for other in others if isinstance(other, Option)), None)
    if option is None:
        return None
    kinds = (
        [kind for kind in get_args(inner) if kind is not NoneType] if NoneType in get_args(inner) else [inner]
    )
    bare = next((name.removesuffix(unit) for unit in _UNITS if name.endswith(unit)), name)
    of_field = option.name or f"--{bare.replace('_', '-')}"
    return Declared(name, of_field, get_origin(kinds[0]) or kinds[0], default, option)


class Options:
    """Base of frozen dataclasses of options.

    Raises InputError, with the field's name, for a value that is not valid.
    """

    def __post_init__(self) -> None:
        for one in options_of(type(self)):
            if (value := getattr(self, one.field)) is not None:
                one.option.check(one.field, one.kind, value)

    @classmethod
    def from_fields(cls, given: Mapping[str, object]) -> Self:
        """Return the options with some values by field.

        Raises InputError for a name that is no field, or a value that is not valid.
        """
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        if unknown := [name for name in given if name not in names]:
            raise InputError(unknown[0], "unknown option", f"one of {', '.join(names)}")
        return cls(**given)


def options_of(owner: type) -> Iterator[Declared]:
    """Yield the options that the fields of a dataclass declare, without nested dataclasses."""
    for field in fields(owner):
        if one := declared(field.name, field.type, field.default):
            yield one


Start = Annotated[
    float, Option("Simulated seconds to leave out at the beginning.", "S", ge=0, le=_LONGEST_S, shown=False)
]
Duration = Annotated[
    float | None, Option("Simulated seconds; to the end of the scene if left out.", "S", gt=0, le=_LONGEST_S)
]
WhichUnit = Annotated[int, Option("Sensor of a rig; 1 is [sensor].", "N", ge=1)]


@dataclass(frozen=True)
class Span(Options):
    """Span of a scene to run."""

    start_s: Start = 0.0
    duration_s: Duration = None


TruthRate = Annotated[
    int, Option("Poses per second in trajectory.tum.", "HZ", "--truth-rate", ge=1, le=10_000)
]
TruthPackets = Annotated[
    bool, Option("Also write packets.tum, one pose for each data packet.", name="--truth-packets")
]
TruthReturns = Annotated[
    bool,
    Option(
        "Also write returns.parquet, one row for each record of a data packet: range, place, labels.",
        name="--truth-returns",
    ),
]


@dataclass(frozen=True)
class TruthTo(Options):
    """Folder for the ground truth of a run, and its files."""

    folder: Annotated[
        Path,
        Option("Also write the ground truth of the run: trajectory, GNSS, rig, scenario.", "DIR", "--truth"),
    ]
    rate_hz: TruthRate = 200
    per_packet: TruthPackets = False
    per_return: TruthReturns = False

    @property
    def scenario(self) -> Path:
        """Path of the scene file with all values, which can be recorded again."""
        return self.folder / "scenario.json"

    @staticmethod
    def of(place: "TruthPlace | None") -> "TruthTo | None":
        """Return a place as options; None for none."""
        return TruthTo(Path(place)) if isinstance(place, str | Path) else place


TruthPlace = str | Path | TruthTo
"""Folder for the ground truth of a run."""


@dataclass(frozen=True)
class BagOptions(Options):
    """Options of a bag."""

    slam: Annotated[
        str | None,
        Option(
            "Also write the configuration of a SLAM program for the bag, such as fast-lio2 or kiss-icp, "
            "or all of them.",
            "NAME",
            "--for",
        ),
    ] = None
    tf: Annotated[
        str,
        Option(
            "Child frame of the true pose in /tf of a bag: a separate frame, so that a SLAM program can "
            "move base_link (slam), or base_link, to view clouds without a SLAM program (truth).",
            words=("slam", "truth"),
        ),
    ] = "slam"


@dataclass(frozen=True)
class RecordOptions(Span):
    """Options of a recording."""

    split: Annotated[
        bool, Option("Write each sensor of a rig into a separate file: OUT_1.pcap and so on.")
    ] = False
    truth: TruthPlace | None = None
    bag: BagOptions | None = None
    """None for a bag with the defaults, or no bag."""


class RecordKeys(TypedDict, total=False):
    """Fields of `RecordOptions` as keyword arguments."""

    start_s: float
    duration_s: float | None
    split: bool
    truth: TruthPlace | None
    bag: BagOptions | None


@dataclass(frozen=True)
class SendOptions(Options):
    """Options of sending packets over UDP."""

    to: Annotated[
        str | None,
        Option(
            "Receiver; may be a broadcast address. PORT is for data packets. By default it is this "
            "machine, 127.0.0.1, and with --interface all stations on that network, 255.255.255.255.",
            "HOST[:PORT]",
        ),
    ] = None
    data_port: Annotated[
        int | None,
        Option(
            "Receiver's port for data packets, instead of sensor.data_port; 0 for a free port for each "
            "sensor.",
            "PORT",
            ge=0,
            le=LAST_PORT,
        ),
    ] = None
    position_port: Annotated[
        int | None,
        Option("The same for position packets, instead of sensor.position_port.", "PORT", ge=0, le=LAST_PORT),
    ] = None
    speed: Annotated[float, Option("Simulated seconds per second.", "X", ge=_SLOWEST)] = 1.0
    late: Annotated[
        str,
        Option(
            "Treatment of packets late by more than 50 ms: send them at the sensor's spacing, so the "
            "stream stays late (pace), or drop them until the stream is in time (skip). Neither sends "
            "bursts.",
            words=("pace", "skip"),
        ),
    ] = "pace"
    as_sensor: Annotated[
        bool,
        Option(
            "Send from the sensor's address, 192.168.1.201, which this machine must have, with its headers."
        ),
    ] = False
    interface: Annotated[
        str | None,
        Option(
            "As --as-sensor, through this network interface, for instance eth0, regardless of the routes.",
            "IFACE",
        ),
    ] = None
    now: Annotated[
        bool,
        Option(
            "Move time stamps and sentences by whole seconds into the present, for drivers that trust "
            "GPS time."
        ),
    ] = False

    @property
    def receiver(self) -> tuple[str, int | None]:
        """Host, and port of data packets if given.

        Raises InputError if the port is invalid, or given twice.
        """
        to = self.to if self.to is not None else LOOPBACK if self.interface is None else "255.255.255.255"
        host, colon, port = to.partition(":")
        if not colon or is_ipv6(to):  # which `hosts.resolve` refuses
            return to, self.data_port
        if not (port.isascii() and port.isdecimal() and 1 <= int(port) <= LAST_PORT):
            raise InputError(
                "--to",
                f"found {to}",
                "HOST or HOST:PORT, an IPv4 address or a name, with a port from 1 to 65535",
            )
        if self.data_port not in (None, int(port)):
            raise InputError(
                "--to", f"found {to} beside --data-port {self.data_port}", "one port for data packets"
            )
        return host, int(port)

    @property
    def is_from_sensor(self) -> bool:
        """True if packets are sent from the sensor's own address."""
        return self.as_sensor or self.interface is not None


class SendKeys(TypedDict, total=False):
    """Fields of `SendOptions` as keyword arguments."""

    to: str | None
    data_port: int | None
    position_port: int | None
    speed: float
    late: str
    as_sensor: bool
    interface: str | None
    now: bool


@dataclass(frozen=True)
class ReplayOptions(SendOptions):
    """Options of a replay."""

    loop: Annotated[
        bool, Option("Begin again at the end, until Ctrl-C; time stamps and sentences go on.")
    ] = False
    keep_gaps: Annotated[
        bool, Option("Wait through gaps of more than a minute instead of shortening them.")
    ] = False


class ReplayKeys(SendKeys, total=False):
    """Fields of `ReplayOptions` as keyword arguments."""

    loop: bool
    keep_gaps: bool


@dataclass(frozen=True)
class Http(Options):
    """Web interfaces of a stream's sensors."""

    at: Annotated[
        str,
        Option(
            "Serve the sensor's web interface, which the stream follows; for a rig on this port and the "
            "next ones. PORT alone is on 127.0.0.1.",
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

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.address  # raises an error before a world is grown

    @property
    def address(self) -> tuple[str, int]:
        """Host, and port of the first sensor; 0 for free ports. InputError if it is malformed."""
        host, port = host_and_port(self.at, "--http", "HOST:PORT, such as 127.0.0.1:8080 or [::1]:8080")
        return host or LOOPBACK, port


@dataclass(frozen=True)
class PosesIn(Options):
    """Poses of a live scene."""

    where: Annotated[
        str | None,
        Option(
            'Address for live poses, for a scene with motion.kind = "live"; the stream waits for the '
            "first one.",
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


@dataclass(frozen=True)
class Outlets(Options):
    """Outputs of a stream beside the packets of the sensors."""

    gps_out: Annotated[
        str | None,
        Option(
            "Play the GPS receiver of the scene on a serial port, 9600 8N1: a device, or "
            "socket://HOST:PORT or rfc2217://HOST:PORT.",
            "PORT",
        ),
    ] = None
    gps_pps: Annotated[
        str, Option("Line of that port for the receiver's pulse.", words=("dtr", "rts", "off"))
    ] = "dtr"  # a null-modem cable connects DTR to DCD, where programs expect the pulse
    imu_out: Annotated[
        str | None,
        Option(
            "Also send the samples of the inertial unit ([imu]), each at its time; on a serial port with "
            "921600 8N1.",
            "udp://HOST:PORT|serial:PORT",
        ),
    ] = None


@dataclass(frozen=True)
class GpsIn(Options):
    """A real GPS receiver that is wired to the sensors."""

    port: Annotated[
        str,
        Option(
            "Take pulse and sentences from a real GPS receiver, 9600 8N1, which then sets the sensor's "
            "clock: a device, or a URL of pyserial.",
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
class StreamOptions(SendOptions):
    """Options of a stream."""

    duration_s: Duration = None
    truth: TruthPlace | None = None
    prepare: Annotated[
        Path | None,
        Option(
            "Compute the whole run into a capture, which is kept, before the first packet leaves.",
            "FILE.pcap",
            "--prepare-to",
        ),
    ] = None
    http: Http | None = None  # None for no web interfaces
    poses: PosesIn | None = None
    """The stream of a live scene begins with the first pose, and drops late packets."""
    outlets: Outlets | None = None
    gps_in: GpsIn | None = None  # sets the clock of the sensors instead of the receiver of the scene


class LiveKeys(SendKeys, total=False):
    """Fields of `StreamOptions` but `truth` as keyword arguments."""

    duration_s: float | None
    prepare: Path | None
    http: Http | None
    poses: PosesIn | None
    outlets: Outlets | None
    gps_in: GpsIn | None


class StreamKeys(LiveKeys, total=False):
    """Fields of `StreamOptions` as keyword arguments."""

    truth: TruthPlace | None
