"""Firing sequences of a capture, numbered through gaps."""

from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures import Capture, table_of
from vlp16emu.errors import CaptureError
from vlp16emu.packets import PacketClock, PacketTable
from vlp16emu.packets.decode import is_before_release, is_dual, layouts_of
from vlp16emu.packets.layout import AZIMUTH_CODES, DATA_BYTES, Layout
from vlp16emu.sensor.settings import LEAST_RPM, MOST_RPM
from vlp16emu.types import F8, I8, SensorModel
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_LEAST_PACKETS = 80  # one revolution at 600 rpm has 75
_MOST_PACKETS = 50_000  # one minute; more changes no figure
_MARGIN = 0.1  # of the speed: other rotors stand, or change speed


@dataclass(frozen=True, slots=True)
class Sequences:
    """n firing sequences of L lasers, b azimuth readings and p packets; in dual return the strongest returns.

    A reading of a VLP-16 is a block, with two firing sequences.
    """

    layout: Layout  # of the packets
    period_ns: int  # from packet to packet, measured where units of the model differ from the manual
    number: I8  # (n,) from 0: lost packets leave gaps
    distance_lsb: I8  # (n, L)
    reflectivity: I8  # (n, L)
    azimuth_cdeg: I8  # (b,) unwrapped, so it rises past north
    block: I8  # (b,) number of the readings
    clock_ns: I8  # (p,) the sensor's clock, hours added
    stamp_ns: I8  # (p,) stamps of the capture
    packet: I8  # (p,) from 0, numbered through gaps
    last: tuple[I8, I8] | None  # distances and reflectivities (n, L) of the last returns, in dual return

    @property
    def is_dual(self) -> bool:
        """True if each firing sequence is sent twice."""
        return self.last is not None

    @property
    def range_mm(self) -> F8:
        """Distances (n, L) in mm, 0 for none."""
        return np.asarray(self.distance_lsb * (self.layout.model.distance_lsb_m * 1000))

    @property
    def packet_us(self) -> float:
        """Period of the packets by the manual, in microseconds."""
        return self.layout.period_ns / US_NS

    @property
    def rpm(self) -> float:
        """Mean speed of the rotor."""
        turned = (self.azimuth_cdeg[-1] - self.azimuth_cdeg[0]) / AZIMUTH_CODES
        return float(turned / (self.block[-1] * self.period_ns / self.layout.readings / S_NS) * 60)


def read_sequences(path: Path) -> Sequences:
    """Read at most a minute of a capture, with any product byte.

    Raises CaptureError if it is no capture, has less than a revolution or two return modes, or its rotor
    speed is not possible for a sensor.
    """
    data = (datagram for datagram in Capture(path) if len(datagram.payload) == DATA_BYTES)
    packets = list(islice(data, _MOST_PACKETS))
    if len(packets) < _LEAST_PACKETS:
        raise CaptureError(str(path), f"{len(packets)} data packets", f"{_LEAST_PACKETS} at least")
    table = table_of(packets, PacketClock())
    if len(modes := np.unique(table["return_mode"])) > 1:
        raise CaptureError(str(path), f"{len(modes)} return modes", "one")
    sequences = _sequences_of(path, table)
    if not (1 - _MARGIN) * LEAST_RPM <= sequences.rpm <= (1 + _MARGIN) * MOST_RPM:
        raise CaptureError(str(path), f"a rotor at {sequences.rpm:.1f} rpm", f"{LEAST_RPM} to {MOST_RPM} rpm")
    return sequences


def _sequences_of(path: Path, table: PacketTable) -> Sequences:
    dual = bool(is_dual(table)[0])
    layout = layouts_of(table, SensorModel.VLP_16 if is_before_release(table) else None)[dual]
    # The clock of a sensor that restarts falls; its packets come later all the same.
    step_ns = np.diff(table["sensor_ns"], prepend=table["sensor_ns"][:1]) % HOUR_NS
    since_ns = np.cumsum(step_ns)
    period_ns = layout.measured_period_ns(step_ns // US_NS)
    packet = np.rint(since_ns / period_ns).astype(np.int64)
    if (np.diff(packet) < 1).any():
        raise CaptureError(
            str(path), "time stamps that stand still or fall", "packets of one sensor in order"
        )
    block = (packet[:, None] * layout.readings + np.arange(layout.readings)).ravel()
    number = (block[:, None] * layout.per_reading + np.arange(layout.per_reading)).ravel()
    azimuth_cdeg = layout.by_reading(table["blocks"]["azimuth_cdeg"])[:, :, 0, -1].ravel().astype(np.int64)
    apart = np.diff(block)
    step_cdeg = np.diff(azimuth_cdeg) % AZIMUTH_CODES
    # In a gap the rotor turns at its usual speed.
    off_cdeg = np.median(step_cdeg[apart == 1]) * apart - step_cdeg
    step_cdeg += np.rint(off_cdeg / AZIMUTH_CODES).astype(np.int64) * AZIMUTH_CODES
    last, strongest = (_by_laser(layout, table["blocks"]["records"], copy) for copy in (0, -1))
    distance_lsb, reflectivity = strongest
    return Sequences(
        layout=layout,
        period_ns=period_ns,
        number=number,
        distance_lsb=distance_lsb,
        reflectivity=reflectivity,
        azimuth_cdeg=np.cumsum(np.append(azimuth_cdeg[:1], step_cdeg)),
        block=block,
        clock_ns=table["sensor_ns"][0] % HOUR_NS + since_ns,
        stamp_ns=table["arrival_ns"],
        packet=packet,
        last=last if dual else None,
    )


def _by_laser(layout: Layout, records: NDArray[np.void], copy: int) -> tuple[I8, I8]:
    """Return distances and reflectivities (n, L) of the firing sequences of one of the copies of blocks."""
    lasers = layout.model.lasers
    by_copy = layout.by_laser(records).reshape(-1, layout.copies, layout.per_reading, lasers)[:, copy]
    names = ("distance_lsb", "reflectivity")
    distance, code = (by_copy[name].reshape(-1, lasers).astype(np.int64) for name in names)
    return distance, code
