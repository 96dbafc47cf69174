"""The options of the truth beside a run, and what writes it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vlp16emu.cli.arguments import checked
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator
    from vlp16emu.types import Packet

__all__ = ["SCENARIO", "TruthPackets", "TruthRate", "TruthTo", "with_truth"]

SCENARIO = "scenario.json"
"""File of the truth that can be recorded again."""

TruthTo = Annotated[
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
    bool,
    typer.Option("--truth-packets", help="Also write packets.tum, one pose for each data packet."),
]


@contextmanager
def with_truth(
    emulator: "Emulator",
    packets: "Iterator[Packet]",
    start_s: float,
    folder: Path | None,
    rate_hz: int,
    *,
    per_packet: bool,
) -> "Iterator[Iterator[Packet]]":
    """Packets whose truth is written as they are taken, where a folder is given."""
    if folder is None and per_packet:
        raise InputError("--truth-packets", "found no --truth", "--truth DIR, where packets.tum goes")
    if folder is None:
        yield packets
        return
    from vlp16emu.truth import Truth

    with Truth(folder, emulator, start_s=start_s, rate_hz=rate_hz, per_packet=per_packet) as truth:
        yield truth.beside(packets)
