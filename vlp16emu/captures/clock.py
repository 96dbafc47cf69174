"""The clock of each unit of a capture, chosen from its first packets."""

from collections.abc import Sequence
from pathlib import Path
from threading import Event
from typing import NamedTuple

from vlp16emu.captures.arrivals import arrivals_of
from vlp16emu.captures.capture import Capture
from vlp16emu.captures.datagrams import Datagram, table_of
from vlp16emu.captures.units import CapturedUnit, searched
from vlp16emu.errors import InputError, PacketError
from vlp16emu.packets.arrival import ArrivalRecord
from vlp16emu.packets.decode import decode_position
from vlp16emu.packets.layout import DATA_BYTES, POSITION_BYTES
from vlp16emu.packets.nmea import rmc_time
from vlp16emu.packets.table import Clock, PacketClock
from vlp16emu.types import PpsState, SensorModel
from vlp16emu.units import S_NS

_CLOSE_NS = S_NS  # without position packets, a clock this close to the host's is taken as UTC
_LOOKED_AT = 10_000
"""The first position packet is looked for among this many packets of a unit: 7 s in dual return."""


class UnitClock(NamedTuple):
    """Clock of a unit, chosen from its first packets."""

    clock: PacketClock  # For all packets of the unit, from the first
    first_ns: int  # UTC of the first data packet by the clock; 0 without data packets
    arrived_ns: int = 0  # its stamp in the capture
    sensor_ns: int = 0  # its UTC by the sensor's clock


def unit_clocks(
    path: Path,
    units: Sequence[CapturedUnit | None],
    name: str | None = None,
    *,
    where: str = "clock",
    stop: Event | None = None,
    model: SensorModel | None = None,
) -> list[UnitClock]:
    """Choose the clock of each unit of a capture.

    Parameters
    ----------
    units : None stands for all packets
    name : "sensor", "gps", "fitted" or "host"; by default the sensor's clock if the unit is locked to GPS, or
        if it has no position packets and is within a second of the host; else the host's clock, which stamps
        everything else of a recording, fitted to the sensor's; the sensor's if the host's stamps do not go on
    where : name of the option in error lines
    model : sensor model of prototype units, whose product byte names another sensor

    Raises CaptureError if the file is not a capture; InputError if there is no such clock, or no valid
    sentence for "gps"; CancelledError once `stop` is set.
    """
    if name not in (None, *Clock):
        raise InputError(where, f"found {name}", ", ".join(Clock))
    seen = [_Seen(model) for _ in units]
    for unit, datagram in searched(Capture(path, is_quiet=True), units, stop):
        if unit is not None:
            seen[unit].take(datagram)
        if all(of.is_known(wants_sentence=name == Clock.GPS) for of in seen):
            break
    chosen = [of.clock(path, name, where) for of in seen]
    wanted = [each.clock.clock is Clock.HOST and name != Clock.HOST for each in chosen]
    if not any(wanted):
        return chosen
    arrivals = arrivals_of(path, units, stop, model)
    return [
        _fitted(path, each, record, name, where) if is_wanted else each
        for each, record, is_wanted in zip(chosen, arrivals, wanted, strict=True)
    ]


def _fitted(
    path: Path, chosen: UnitClock, arrivals: ArrivalRecord, name: str | None, where: str
) -> UnitClock:
    """Return the host's clock fitted to the sensor's, or the sensor's if that cannot be."""
    model = chosen.clock.model
    stamps = arrivals.stamps
    fit = arrivals.fit() if stamps.runs else None
    if fit is not None:
        first = fit.parts[0]
        begin_ns = chosen.first_ns + first.host_ns - chosen.arrived_ns
        return UnitClock(
            PacketClock(Clock.FITTED, fit=fit, model=model), begin_ns, chosen.arrived_ns, chosen.sensor_ns
        )
    if name == Clock.FITTED and stamps.steps:
        raise InputError(where, f"found fitted, but in {path} {stamps.fault}", "sensor")
    return chosen._replace(clock=PacketClock(model=model), first_ns=chosen.sensor_ns)


def packet_clock(
    path: Path,
    unit: CapturedUnit | None,
    name: str | None = None,
    *,
    where: str = "clock",
    stop: Event | None = None,
    model: SensorModel | None = None,
) -> PacketClock:
    """Return the clock for the packets of one unit, as `unit_clocks`.

    By default a pipe has the sensor's clock. Raises InputError for "gps" and "fitted" of a pipe, whose
    packets cannot be read twice; CancelledError once `stop` is set.
    """
    if path.is_fifo() and name in (None, *Clock):
        if name in (Clock.GPS, Clock.FITTED):
            raise InputError(where, f"found {name} for the pipe {path}", "sensor or host, or a file")
        return PacketClock(Clock(name or Clock.SENSOR), model=model)
    clocks = unit_clocks(path, [unit], name, where=where, stop=stop, model=model)
    return clocks[0].clock


class _Seen:
    """What the first packets of a unit say about its clock."""

    def __init__(self, model: SensorModel | None) -> None:
        self._model = model
        self.data: Datagram | None = None
        self.pps: PpsState | None = None
        self.behind_ns: int | None = None
        self.count = 0

    def take(self, datagram: Datagram) -> None:
        """Note what the next packet says."""
        self.count += 1
        if len(datagram.payload) == DATA_BYTES:
            self.data = self.data or datagram
        elif len(datagram.payload) == POSITION_BYTES and (self.pps is None or self.behind_ns is None):
            try:
                fields = decode_position(datagram.payload)
                self.pps = fields.pps if self.pps is None else self.pps
                second_ns, valid = rmc_time(fields.sentence)
            except PacketError:
                return
            if second_ns is not None and valid and self.behind_ns is None:
                self.behind_ns = second_ns - datagram.stamp_ns

    def is_known(self, *, wants_sentence: bool) -> bool:
        """Return whether further packets cannot change the choice."""
        if self.data is None:
            return False
        return (
            self.behind_ns is not None if wants_sentence else self.pps is not None or self.count > _LOOKED_AT
        )

    def clock(self, path: Path, name: str | None, where: str) -> UnitClock:
        """Return the clock of this name, or the one that follows UTC; errors as in `unit_clocks`."""
        behind_ns = self.behind_ns if name == Clock.GPS else 0
        if behind_ns is None:
            raise InputError(where, f"no valid sentence of a GPS receiver in {path}", "sensor or host")
        if self.data is None:
            return UnitClock(PacketClock(_before_fit(name or Clock.SENSOR), behind_ns, model=self._model), 0)
        first = table_of([self.data], PacketClock(Clock.HOST, behind_ns, model=self._model))[0]
        follows_utc = self.pps is PpsState.LOCKED
        if self.pps is None:
            follows_utc = abs(first["utc_ns"] - first["sensor_ns"]) <= _CLOSE_NS
        clock = _before_fit(name) if name else Clock.SENSOR if follows_utc else Clock.HOST
        first_ns = first["utc_ns"] if clock is Clock.HOST else first["sensor_ns"]
        found = PacketClock(clock, behind_ns, model=self._model)
        return UnitClock(found, int(first_ns), self.data.stamp_ns, int(first["sensor_ns"]))


def _before_fit(name: str) -> Clock:
    """Return a clock by its name; the host's where that is to be fitted."""
    return Clock.HOST if name == Clock.FITTED else Clock(name)
