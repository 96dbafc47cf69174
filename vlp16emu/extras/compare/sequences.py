"""Firing sequences of a capture, numbered through gaps."""

from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures import Capture, table_of
from vlp16emu.errors import CaptureError
from vlp16emu.packets import PacketClock, PacketTable, layout
from vlp16emu.packets.decode import is_before_release, is_dual, layouts_of
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sensor.settings import LEAST_RPM, MOST_RPM
from vlp16emu.types import I8
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_LEAST_PACKETS = 80  # one revolution at 600 rpm has 75
_MOST_PACKETS = 50_000  # one minute; more changes no figure
_MARGIN = 0.1  # of the speed: other rotors stand, or change speed


@dataclass(frozen=True, slots=True)
class Sequences:
    """n firing sequences of b blocks and p packets; in dual return, from the odd blocks."""

    number: I8  # (n,) from 0, in units of 55.296 us: lost packets leave gaps
    distance_lsb: I8  # (n, 16)
    reflectivity: I8  # (n, 16)
    azimuth_cdeg: I8  # (b,) unwrapped, so it rises past north
    block: I8  # (b,) number of the blocks, in units of 110.592 us
    clock_ns: I8  # (p,) the sensor's clock, hours added
    stamp_ns: I8  # (p,) stamps of the capture
    packet: I8  # (p,) from 0, numbered through gaps
    last: tuple[I8, I8] | None  # distances and reflectivities (n, 16) of the even blocks, in dual return

    @property
    def is_dual(self) -> bool:
        """True if each firing sequence is sent twice."""
        return self.last is not None

    @property
    def packet_us(self) -> float:
        """Period of the packets by the manual, in microseconds."""
        return len(self.number) // len(self.packet) * SEQUENCE_NS / US_NS

    @property
    def rpm(self) -> float:
        """Mean speed of the rotor."""
        turned = (self.azimuth_cdeg[-1] - self.azimuth_cdeg[0]) / layout.AZIMUTH_CODES
        return float(turned / (self.block[-1] * layout.BLOCK_PERIOD_NS / S_NS) * 60)


def read_sequences(path: Path) -> Sequences:
    """Read at most a minute of a capture, with any product byte.

    Raises CaptureError if it is no capture, has less than a revolution or two return modes, or its rotor
    speed is not possible for a VLP-16.
    """
    data = (datagram for datagram in Capture(path) if len(datagram.payload) == layout.DATA_BYTES)
    packets = list(islice(data, _MOST_PACKETS))
    if len(packets) < _LEAST_PACKETS:
        raise CaptureError(str(path), f"{len(packets)} data packets", f"{_LEAST_PACKETS} at least")
    table = table_of(packets, PacketClock())
    model = layouts_of(table)[0].model
    if model.lasers != layout.LASERS and not is_before_release(table):
        raise CaptureError(str(path), f"{model.title} packets", "those of a VLP-16 or another Puck")
    if len(modes := np.unique(table["return_mode"])) > 1:
        raise CaptureError(str(path), f"{len(modes)} return modes", "one")
    sequences = _sequences_of(path, table)
    if not (1 - _MARGIN) * LEAST_RPM <= sequences.rpm <= (1 + _MARGIN) * MOST_RPM:
        raise CaptureError(str(path), f"a rotor at {sequences.rpm:.1f} rpm", f"{LEAST_RPM} to {MOST_RPM} rpm")
    return sequences


def _sequences_of(path: Path, table: PacketTable) -> Sequences:
    dual = bool(is_dual(table)[0])
    blocks = table["blocks"][:, 1::2] if dual else table["blocks"]
    per_packet = layout.BLOCKS_PER_PACKET // 2 if dual else layout.BLOCKS_PER_PACKET
    # The clock of a sensor that restarts falls; its packets come later all the same.
    since_ns = np.cumsum(np.diff(table["sensor_ns"], prepend=table["sensor_ns"][:1]) % HOUR_NS)
    packet = np.rint(since_ns / (per_packet * layout.BLOCK_PERIOD_NS)).astype(np.int64)
    if (np.diff(packet) < 1).any():
        raise CaptureError(
            str(path), "time stamps that stand still or fall", "packets of one sensor in order"
        )
    block = (packet[:, None] * per_packet + np.arange(per_packet)).ravel()
    number = (block[:, None] * layout.SEQUENCES_PER_BLOCK + np.arange(layout.SEQUENCES_PER_BLOCK)).ravel()
    azimuth_cdeg = blocks["azimuth_cdeg"].ravel().astype(np.int64)
    apart = np.diff(block)
    step_cdeg = np.diff(azimuth_cdeg) % layout.AZIMUTH_CODES
    # In a gap the rotor turns at its usual speed.
    off_cdeg = np.median(step_cdeg[apart == 1]) * apart - step_cdeg
    step_cdeg += np.rint(off_cdeg / layout.AZIMUTH_CODES).astype(np.int64) * layout.AZIMUTH_CODES
    distance_lsb, reflectivity = _by_laser(blocks)
    return Sequences(
        number=number,
        distance_lsb=distance_lsb,
        reflectivity=reflectivity,
        azimuth_cdeg=np.cumsum(np.append(azimuth_cdeg[:1], step_cdeg)),
        block=block,
        clock_ns=table["sensor_ns"][0] % HOUR_NS + since_ns,
        stamp_ns=table["arrival_ns"],
        packet=packet,
        last=_by_laser(table["blocks"][:, ::2]) if dual else None,
    )


def _by_laser(blocks: NDArray[np.void]) -> tuple[I8, I8]:
    """Return distances and reflectivities (n, 16) of the firing sequences of blocks."""
    names = ("distance_lsb", "reflectivity")
    records = blocks["records"]
    distance, code = (records[name].reshape(-1, layout.LASERS).astype(np.int64) for name in names)
    return distance, code
