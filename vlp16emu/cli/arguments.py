"""Arguments and options that several verbs share, and how their values are checked."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.run.options import TruthTo


_LONGEST_S = 7 * 86_400
"""As long as a scene may be."""
_SCENE = "Name of a scene (see `vlp16emu scenes`) or path of a .toml file"

T = TypeVar("T", int, float)


def option(
    name: str,
    about: str,
    metavar: str | None = None,
    parser: Callable[[str], Any] | None = None,
    *,
    shown: bool | str = True,
) -> Any:
    """Declare an option; `shown` is what help says of its default."""
    return typer.Option(name, help=about, metavar=metavar, parser=parser, show_default=shown)


def argument(metavar: str, about: str) -> Any:
    """Declare an argument that a command line must have."""
    return typer.Argument(metavar=metavar, help=about, show_default=False)


def number(name: str, about: str, metavar: str, least: T, most: float = math.inf, *, shown: bool | str = True) -> Any:
    """Declare an option that takes a number of the type of `least`, between both or equal to one."""
    kind, words = type(least), {int: ("a whole number", ""), float: ("a number", " on")}
    name_of_kind, end = words[kind]
    expected = f"{name_of_kind} from {least:.12g}{f' to {most:.12g}' if most < math.inf else end}"
    parser = checked(name, kind, lambda value: least <= value <= most and math.isfinite(value), expected)
    return option(name, about, metavar, parser, shown=shown)


def one_of(name: str, about: str, *words: str) -> Any:
    """Declare an option that takes one of some words."""

    def parse(text: str) -> str:
        if text not in words:
            raise InputError(name, f"found {text}", f"{', '.join(words[:-1])} or {words[-1]}")
        return text

    return option(name, about, "|".join(words), parse)


def checked(name: str, kind: Callable[[str], T], is_right: Callable[[T], bool], expected: str) -> Callable[[str], T]:
    """Parser of a number that raises `InputError` in the name of its option."""

    def parse(text: str) -> T:
        try:
            value = kind(text)
        except ValueError:
            raise InputError(name, f"found {text}", expected) from None
        if not is_right(value):  # NaN is never right
            raise InputError(name, f"found {text}", expected)
        return value

    return parse


def pixels(text: str, expected: str, is_right: Callable[[int], bool] = lambda _: True) -> tuple[int, int]:
    """Read the `--size` of a picture, width and height."""
    width, _, height = text.lower().partition("x")
    if not all(word.isascii() and word.isdecimal() and is_right(int(word)) for word in (width, height)):
        raise InputError("--size", f"found {text}", expected)
    return int(width), int(height)


def truth_to(folder: Path | None, rate_hz: int, *, per_packet: bool, per_return: bool) -> "TruthTo | None":
    """Where the truth of a run goes, if it is wanted.

    Raises
    ------
    InputError
        where a part of it is wanted and no folder
    """
    if folder is not None:
        from vlp16emu.run.options import TruthTo

        return TruthTo(folder, rate_hz, per_packet, per_return)
    if per_packet or per_return:
        name, file = ("packets", "packets.tum") if per_packet else ("returns", "returns.parquet")
        raise InputError(f"--truth-{name}", "found no --truth", f"--truth DIR, where {file} goes")
    return None


SceneName = Annotated[str, argument("SCENE", f"{_SCENE}.")]
SceneOrCapture = Annotated[str, argument("SCENE|FILE.pcap", f"{_SCENE}; or a capture, ours or a real sensor's.")]
CaptureFile = Annotated[
    Path, argument("FILE.pcap", "Capture with VLP-16 packets: pcap or pcapng, also .gz, .bz2, .xz, .zst.")
]
Start = Annotated[
    float, number("--start", "Simulated seconds to leave out at the beginning.", "S", 0.0, _LONGEST_S, shown=False)
]
Duration = Annotated[
    float | None,
    option(
        "--duration",
        "Simulated seconds; up to the end of the scene if left out.",
        "S",
        checked("--duration", float, lambda s: 0 < s <= _LONGEST_S, f"a number above 0 and at most {_LONGEST_S}"),
    ),
]
DataPort = Annotated[
    int | None,
    number("--data-port", "Receiver's port for data packets, instead of sensor.data_port.", "PORT", 1, 65_535),
]
PositionPort = Annotated[
    int | None,
    number("--position-port", "The same for position packets, instead of sensor.position_port.", "PORT", 1, 65_535),
]
Settings = Annotated[
    list[str] | None,
    option(
        "--set",
        "Change a value of the scene, for instance sensor.rpm=1200. Files are found from the current folder. May be repeated.",
        "KEY=VALUE",
    ),
]
Ideal = Annotated[bool, option("--ideal", "A sensor without errors: beams without width, no noise, clear air.")]
Threads = Annotated[
    int, number("--threads", "Workers, 0 for one per core. Changes the speed, never a byte.", "N", 0, 1024, shown=False)
]
NoAudit = Annotated[
    bool, option("--no-audit", "Do not cast 0.05 % of the pulses again to estimate the error of the run.")
]
TruthFolder = Annotated[
    Path | None, option("--truth", "Write beside it what was true: trajectory, GNSS, rig, scenario.", "DIR")
]
TruthRate = Annotated[int, number("--truth-rate", "Poses per second in trajectory.tum.", "HZ", 1, 10_000)]
TruthPackets = Annotated[bool, option("--truth-packets", "Also write packets.tum, one pose for each data packet.")]
TruthReturns = Annotated[
    bool,
    option(
        "--truth-returns", "Also write returns.parquet, one row for each record of a data packet: range, place, labels."
    ),
]
TrajectoryFile = Annotated[
    Path | None,
    option(
        "--trajectory",
        "Of a capture: the folder that `record --truth` has written, for the true trajectory, or any other in TUM format.",
        "DIR|FILE.tum",
    ),
]
WhichUnit = Annotated[int, number("--unit", "Which sensor of a rig; 1 is that of [sensor].", "N", 1)]
AsJson = Annotated[bool, option("--json", "Print one JSON object and nothing else.")]
