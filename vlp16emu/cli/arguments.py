"""Arguments and options that several verbs share, and how their values are checked."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.run.options import TruthTo


_LONGEST_S = 7 * 86_400
"""As long as a scene may be."""

T = TypeVar("T", int, float)


def checked(option: str, kind: Callable[[str], T], is_right: Callable[[T], bool], expected: str) -> Callable[[str], T]:
    """Parser of a number that raises `InputError` in the name of its option."""

    def parse(text: str) -> T:
        try:
            value = kind(text)
        except ValueError:
            raise InputError(option, f"found {text}", expected) from None
        if not is_right(value):  # NaN is never right
            raise InputError(option, f"found {text}", expected)
        return value

    return parse


def truth_to(folder: Path | None, rate_hz: int, *, per_packet: bool, per_return: bool) -> "TruthTo | None":
    """Where the truth of a run goes, if it is wanted.

    Raises
    ------
    InputError
        where a part of it is wanted and no folder
    """
    if folder is None:
        for given, option, file in (
            (per_packet, "--truth-packets", "packets.tum"),
            (per_return, "--truth-returns", "returns.parquet"),
        ):
            if given:
                raise InputError(option, "found no --truth", f"--truth DIR, where {file} goes")
        return None
    from vlp16emu.run.options import TruthTo

    return TruthTo(folder, rate_hz, per_packet, per_return)


def _port(option: str, about: str) -> Any:
    parser = checked(option, int, lambda port: 1 <= port <= 65_535, "a whole number from 1 to 65535")
    return typer.Option(option, metavar="PORT", parser=parser, help=about)


SceneName = Annotated[
    str,
    typer.Argument(
        metavar="SCENE", help="Name of a scene (see `vlp16emu scenes`) or path of a .toml file.", show_default=False
    ),
]
CaptureFile = Annotated[
    Path, typer.Argument(metavar="FILE.pcap", help="Classic pcap file with VLP-16 packets.", show_default=False)
]
Start = Annotated[
    float,
    typer.Option(
        "--start",
        metavar="S",
        parser=checked("--start", float, lambda s: 0 <= s <= _LONGEST_S, f"a number from 0 to {_LONGEST_S}"),
        help="Simulated seconds to leave out at the beginning.",
        show_default=False,
    ),
]
Duration = Annotated[
    float | None,
    typer.Option(
        "--duration",
        metavar="S",
        parser=checked(
            "--duration", float, lambda s: 0 < s <= _LONGEST_S, f"a number above 0 and at most {_LONGEST_S}"
        ),
        help="Simulated seconds; up to the end of the scene if left out.",
    ),
]
DataPort = Annotated[int | None, _port("--data-port", "Receiver's port for data packets, instead of sensor.data_port.")]
PositionPort = Annotated[
    int | None, _port("--position-port", "The same for position packets, instead of sensor.position_port.")
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a value of the scene, for instance sensor.rpm=1200. Files are found from the current folder. "
        "May be repeated.",
    ),
]
Ideal = Annotated[
    bool, typer.Option("--ideal", help="A sensor without errors: beams without width, no noise, clear air.")
]
Threads = Annotated[
    int,
    typer.Option(
        "--threads",
        metavar="N",
        parser=checked("--threads", int, lambda n: 0 <= n <= 1024, "a whole number from 0 to 1024"),
        help="Workers, 0 for one per core. Changes the speed, never a byte.",
        show_default=False,
    ),
]
NoAudit = Annotated[
    bool, typer.Option("--no-audit", help="Do not cast 0.05 % of the pulses again to estimate the error of the run.")
]
TruthFolder = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="DIR",
        help="Write beside it what was true: trajectory, GNSS, rig, scenario.",
        show_default=False,
    ),
]
TruthRate = Annotated[
    int,
    typer.Option(
        "--truth-rate",
        metavar="HZ",
        parser=checked("--truth-rate", int, lambda hz: 1 <= hz <= 10_000, "a whole number from 1 to 10000"),
        help="Poses per second in trajectory.tum.",
    ),
]
TruthPackets = Annotated[
    bool, typer.Option("--truth-packets", help="Also write packets.tum, one pose for each data packet.")
]
TruthReturns = Annotated[
    bool,
    typer.Option(
        "--truth-returns",
        help="Also write returns.parquet, one row for each record of a data packet: range, place, labels.",
    ),
]
WhichUnit = Annotated[
    int,
    typer.Option(
        "--unit",
        metavar="N",
        parser=checked("--unit", int, lambda n: n >= 1, "a whole number from 1"),
        help="Which sensor of a rig; 1 is that of [sensor].",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
