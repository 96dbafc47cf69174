"""Arrivals of the data packets of units, in one pass over a capture."""

from collections.abc import Sequence
from pathlib import Path
from threading import Event

from vlp16emu.captures.capture import Capture, CapturedUnit, Datagram, searched, table_of
from vlp16emu.packets.arrival import ArrivalRecord
from vlp16emu.packets.layout import DATA_BYTES
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
    found = [_Arrivals(model) for _ in units]
    for unit, datagram in searched(Capture(path, is_quiet=True), units, stop):
        if unit is not None and len(datagram.payload) == DATA_BYTES:
            found[unit].take(datagram)
    return [of.record for of in found]


class _Arrivals:
    """Record of one unit's arrivals, which takes packets one by one."""

    def __init__(self, model: SensorModel | None) -> None:
        self._record = ArrivalRecord()
        self._clock = PacketClock(model=model)
        self._ages_ns = ages_ns(model)
        self._held = list[Datagram]()

    def take(self, datagram: Datagram) -> None:
        """Take the next data packet of the unit."""
        self._held.append(datagram)
        if len(self._held) == _TOGETHER:
            self._note()

    def _note(self) -> None:
        """Add the held packets to the record."""
        table = table_of(self._held, self._clock)
        lasts_ns = self._ages_ns[table["factory"], table["return_mode"]]
        self._record.take(table["number"], table["sensor_ns"] + lasts_ns, table["arrival_ns"])
        self._held = []

    @property
    def record(self) -> ArrivalRecord:
        """Record of all packets that were taken."""
        if self._held:
            self._note()
        return self._record
