"""Arrivals of the data packets of units, in one pass over a capture."""

from collections.abc import Sequence
from pathlib import Path
from threading import Event

from vlp16emu.captures.capture import Capture
from vlp16emu.captures.units import CapturedUnit, data_rows
from vlp16emu.packets.arrival import ArrivalRecord
from vlp16emu.packets.table import PacketClock, ages_ns
from vlp16emu.types import SensorModel

_TOGETHER = 1000  # packets of a unit that are noted at once


def arrivals_of(
    path: Path,
    units: Sequence[CapturedUnit | None],
    stop: Event | None = None,
    model: SensorModel | None = None,
) -> list[ArrivalRecord]:
    """Read a capture, and record the arrivals of the data packets of some of its units.

    Parameters
    ----------
    units : None stands for all packets
    model : sensor model of prototype units, whose product byte names another sensor

    Raises CaptureError if the file is not a capture; CancelledError once `stop` is set.
    """
    records = [ArrivalRecord() for _ in units]
    clocks = [PacketClock(model=model) for _ in units]
    lasts_ns = ages_ns(model)
    for unit, rows in data_rows(Capture(path, is_quiet=True), units, _TOGETHER, stop):
        table = rows.table(clocks[unit])
        last_ns = table["sensor_ns"] + lasts_ns[table["factory"], table["return_mode"]]
        records[unit].take(table["number"], last_ns, table["arrival_ns"])
    return records
