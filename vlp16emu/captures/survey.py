"""One pass over a capture before it is read: its sensors."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError
from pathlib import Path
from threading import Event

import numpy as np

from vlp16emu.captures.capture import Capture
from vlp16emu.captures.datagrams import Batch, PacketRows
from vlp16emu.captures.units import CapturedUnit
from vlp16emu.errors import InputError
from vlp16emu.packets.layout import BLOCK_FLAG, DATA_BYTES, DATA_PAYLOAD, POSITION_BYTES, SPLIT_PRODUCTS

_STRAY = 0.02
"""Smallest share of the data packets of the busiest unit that counts as a unit; fewer are an accident."""
_NAMED = 16  # units listed in an error line; as many as a rig may have


class _Sender:
    """Datagrams as long as data packets, from one sender to one port."""

    def __init__(self, first: int) -> None:
        self.first = first  # number of its first frame
        self.last = first
        self.packets = 0  # datagrams that begin as Velodyne data packets do

    def note(self, rows: PacketRows) -> None:
        """Note what follows from more datagrams."""
        fields = rows.payloads.reshape(-1).view(DATA_PAYLOAD)
        is_first = fields["blocks"]["flag"][:, :2] == BLOCK_FLAG
        is_first[:, 1] |= np.isin(fields["factory"], SPLIT_PRODUCTS)
        self.packets += int(is_first.all(axis=1).sum())
        self.last = int(rows.number[-1])


class Survey:
    """The sensors of a capture, in order of address, port and MAC address.

    It reads the whole file. A pipe can be read only once, so it is not read here and has no units. If two
    sensors share an address, as behind a router, the one with the lower data port has the lower position
    port.

    Parameters
    ----------
    stop : ends it with CancelledError
    progress : called with the share of the file that is read

    Raises CaptureError if the file is not a capture or is damaged.
    """

    def __init__(
        self, path: Path, stop: Event | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        self.path = path
        self.is_pipe = path.is_fifo()
        self._senders = dict[tuple[bytes, int, bytes], _Sender]()
        self._position = defaultdict[bytes, set[int]](set)
        self._capture = Capture(path, is_quiet=True, progress=progress)
        if not self.is_pipe:
            self._read(stop)
        self._find_units()

    def _read(self, stop: Event | None) -> None:
        for batch in self._capture.batches():
            if stop is not None and stop.is_set():
                raise CancelledError
            self._take(batch)

    def _take(self, batch: Batch) -> None:
        """Note the datagrams of a batch, those of each flow at once."""
        flows, flow = batch.flows()
        is_data = batch.payload_bytes == DATA_BYTES
        is_position = batch.payload_bytes == POSITION_BYTES
        for i, (mac, source, port) in enumerate(flows):
            rows = np.flatnonzero(is_data & (flow == i))
            if len(rows):
                packets = PacketRows.of(batch, rows)
                sender = self._senders.setdefault((source, port, mac), _Sender(int(packets.number[0])))
                sender.note(packets)
            if (is_position & (flow == i)).any():
                self._position[source].add(port)

    def _find_units(self) -> None:
        streams: dict[tuple[bytes, int], dict[bytes, _Sender]] = defaultdict(dict)
        for (source, port, mac), sender in self._senders.items():
            streams[source, port][mac] = sender
        counts = {key: sum(one.packets for one in own.values()) for key, own in streams.items()}
        least = max(_STRAY * max(counts.values(), default=0), 1)
        ports = defaultdict[bytes, list[int]](list)
        for source, port in sorted(key for key, packets in counts.items() if packets >= least):
            ports[source].append(port)
        self.units = [
            CapturedUnit(source, port, tuple(sorted(self._position[source])[place :: len(own)]), mac)
            for source, own in ports.items()
            for place, port in enumerate(own)
            for mac in _macs(streams[source, port], least)
        ]
        self._has_others = not all(counts.values())  # senders of other datagrams as long as data packets

    def required(self) -> list[CapturedUnit]:
        """Return the sensors; CaptureError if there is none."""
        if not self.units:
            raise self._capture.no_data()
        return self.units

    def chosen(self, unit: str | None, *, where: str = "unit") -> CapturedUnit | None:
        """Return one sensor; errors and parameters as for `chosen_unit`."""
        if self.is_pipe and unit is not None:
            found = f"found {unit} for the pipe {self.path}"
            raise InputError(where, found, "a file, which can be read twice")
        units = self.units
        if not units or (unit is None and len(units) == 1):
            return units[0] if self._has_others and units else None
        for number, known in enumerate(units, start=1):
            if unit in (str(number), str(known)):
                return known
        found = f"{len(units)} units in {self.path}" if unit is None else f"found {unit}"
        names = [f"{number} ({known})" for number, known in enumerate(units[:_NAMED], start=1)]
        names += [f"... {len(units)}"] if len(units) > _NAMED else []
        raise InputError(where, found, f"one of {', '.join(names)}")


def units_in(path: Path, *, required: bool = False, stop: Event | None = None) -> list[CapturedUnit]:
    """Find the sensors in a capture, as `Survey`; CaptureError if one is `required` and there is none."""
    survey = Survey(path, stop)
    return survey.required() if required else survey.units


def chosen_unit(
    path: Path, unit: str | None, *, where: str = "unit", stop: Event | None = None
) -> CapturedUnit | None:
    """Find one sensor of a capture.

    It is None if it is the only sender of packets of that length and no unit is named.

    Parameters
    ----------
    unit : its number from 1, or its address and data port, as `192.168.1.201:2368`
    where : the option's name in error lines

    Raises CaptureError if the file is not a capture or is damaged; InputError if there is no such unit, if
    there are several and none is named, or if one of a pipe is named, as a pipe can be read only once;
    CancelledError once `stop` is set.
    """
    return Survey(path, stop).chosen(unit, where=where)


def _macs(senders: dict[bytes, _Sender], least: float) -> Iterable[bytes]:
    """Return the MAC addresses of sensors that send at the same time.

    It is empty if one sensor replaces another.
    """
    busy = {mac: sender for mac, sender in senders.items() if sender.packets >= least}
    firsts = [sender.first for sender in busy.values()]
    if len(busy) > 1 and max(firsts) < min(sender.last for sender in busy.values()):
        return sorted(busy)
    return [b""]
