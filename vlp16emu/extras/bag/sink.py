"""Packets, and what was true beside them, into a bag."""

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from vlp16emu.extras.bag.bag_file import BagFile
from vlp16emu.extras.bag.messages import UnitMessages
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES, PacketClock
from vlp16emu.sinks import PacketSink, PcapResult
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, US_NS

_OFTEN_NS = S_NS // 10
"""Time whose truth is written together."""


class TrueSamples(Protocol):
    """Something that is true of a run, sample by sample."""

    def up_to(self, t_ns: int) -> None:
        """Write all samples until and with an instant that are not written yet."""


TruthOf = Callable[[BagFile, Sequence[str], int], Sequence[tuple[TrueSamples, int]]]
"""Makes the truth from the first pulse on, of a bag, the frames of its units and the first pulse; each with its time after the last packet."""


class BagSink(PacketSink):
    """Writes packets of one or several sensors into a bag, as they come, and the truth of the same time.

    Each unit of several has its topics and its frame under `/unit_1` and so on.

    Parameters
    ----------
    path : .mcap, .bag or a folder, as `BagFile` takes it
    units : number of sensors
    clock_of : gives each sensor its clock, by its number from 0 and the stamp of its first data packet
    truth : what else is to be in the bag

    Raises
    ------
    OutputError, MissingExtraError
        as `BagFile`
    RunError
        If the disk is full: here, or later
    """

    def __init__(
        self, path: Path, units: int, clock_of: Callable[[int, int], PacketClock], truth: TruthOf | None = None
    ) -> None:
        self._frames = frames_of(units)
        self.bag = BagFile(path)
        self._units, self._clock_of = dict[int, UnitMessages](), clock_of
        self._truth, self._samples = truth, list[tuple[TrueSamples, int]]()
        self._sent = Counter[PacketKind]()
        self._seen_ns = self._next_ns = -(2**62)
        self.first_ns: int | None = None
        """UTC of the first pulse, by its sensor's clock; None before."""

    def __exit__(self, *raised: object) -> None:
        if raised[1] is not None:
            self.bag.__exit__(*raised)  # type: ignore[arg-type]  # as `with` calls it
            return
        with self.bag:
            for unit in self._units.values():
                unit.check()
            for samples, longer_ns in self._samples:
                samples.up_to(self._seen_ns + longer_ns)

    def send(self, packet: Packet) -> None:
        """Take one packet, which is due at the stamp of its capture, and numbered as its frame if it has a number.

        Raises
        ------
        PacketError
            If it is not a VLP-16's
        """
        if packet.unit not in self._units:
            clock = self._clock_of(packet.unit, packet.due_ns)
            self._units[packet.unit] = UnitMessages(self.bag, self._frames[packet.unit], clock)
        unit = self._units[packet.unit]
        self._sent[packet.kind] += 1
        stamp_ns = packet.due_ns // US_NS * US_NS  # as captures have it
        if len(packet.payload) == DATA_BYTES:
            t_ns = unit.data(stamp_ns, packet.payload, packet.number or self._sent.total())
            if self.first_ns is None:
                self.first_ns = t_ns
                self._samples += self._truth(self.bag, self._frames, t_ns) if self._truth else []
        elif len(packet.payload) == POSITION_BYTES:
            t_ns = unit.position(stamp_ns, packet.payload)
        else:
            return
        self._seen_ns = max(self._seen_ns, t_ns)
        if t_ns >= self._next_ns:
            self._next_ns = t_ns + _OFTEN_NS
            for samples, _ in self._samples:
                samples.up_to(t_ns)

    @property
    def result(self) -> PcapResult:
        """Contents of the closed bag; sha256 of several files in the order of their names."""
        path = self.bag.path
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        return PcapResult(
            data_packets=self._sent[PacketKind.DATA],
            position_packets=self._sent[PacketKind.POSITION],
            bytes=sum(file.stat().st_size for file in files),
            sha256=", ".join(map(_sha256, files)),
            messages=dict(sorted(self.bag.counts.items())),
        )


def frames_of(units: int) -> list[str]:
    """Return the frames of the clouds of so many sensors; topics are under the same names."""
    return ["velodyne"] if units == 1 else [f"unit_{number}/velodyne" for number in range(1, units + 1)]


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
