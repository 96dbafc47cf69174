"""A run that is recorded before it is sent, so that its engine cannot be too slow."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any

from vlp16emu.errors import OutputError
from vlp16emu.output import STDOUT
from vlp16emu.packets import Capture, Link
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.options import RecordOptions, StreamOptions
from vlp16emu.run.record import record
from vlp16emu.scenario.model import CaptureClock
from vlp16emu.sinks import check_ending
from vlp16emu.types import Packet, PacketKind


def prepared(emulator: Emulator, options: StreamOptions, **hooks: Any) -> Iterator[Packet]:
    """Record a whole run into the file `prepare` of the options, and yield its packets as `packets_of` does.

    Parameters
    ----------
    hooks : as of `record`

    Raises
    ------
    OutputError : If the place cannot be read again, or has the ending of another format; and others as `record`
    """
    path = Path(options.prepare or "")
    if path == STDOUT or (path.exists() and not path.is_file()):
        raise OutputError(str(path), "no file that can be read again", "the name of a file")
    check_ending(path)
    # Packets leave when they are due: the clock of a host that records has no part in it.
    scenario = emulator.scenario.model_copy(update={"capture": CaptureClock(preset="ideal")})
    asked = RecordOptions(duration_s=options.duration_s, truth=options.truth)
    record(emulator.with_engine(replace(emulator.engine, scenario=scenario)), path, asked, **hooks)
    return packets_of([unit.link for unit in emulator.engine.parts.units], path)


def packets_of(links: Sequence[Link], path: Path) -> Iterator[Packet]:
    """Yield all packets of a capture of our own, due at the stamps of their frames, which are in whole microseconds.

    Parameters
    ----------
    links : of the units that the packets are from

    Raises
    ------
    CaptureError : If the file is damaged
    """
    ways = {
        (IPv4Address(link.source).packed, port): (kind, number)
        for number, link in enumerate(links)
        for kind, port in ((PacketKind.DATA, link.data_port), (PacketKind.POSITION, link.position_port))
    }
    for datagram in Capture(path, repeats=True):
        kind, number = ways[datagram.source, datagram.destination_port]
        yield Packet(kind, datagram.stamp_ns, datagram.payload, number)
