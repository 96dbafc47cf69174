"""Packets, and what was true beside them, into a bag."""

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vlp16emu.extras.bag.bag_file import BagFile
from vlp16emu.extras.bag.messages import TrueMessages, UnitMessages
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES, PacketClock
from vlp16emu.run.options import BagOptions
from vlp16emu.sinks import PacketSink, PcapResult
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, US_NS

_OFTEN_NS = S_NS // 10
"""Time whose truth is written together."""


class Truth(NamedTuple):
    """Ground truth of a run, from its engine or from its files."""

    rig: Mapping[str, Any]
    """`rig.json`, with the units that are written."""
    scenario: Mapping[str, Any]
    """`scenario.json`."""
    feeds: Callable[[TrueMessages, int], Sequence[Callable[[int], None]]]
    """Opens the samples from the first pulse on; each feed writes those up to and with an instant that are not written yet."""
    after_ns: int
    """Time after the last packet that is written too."""


class BagSink(PacketSink):
    """Writes packets of one or several sensors into a bag, as they come, and the truth of the same time.

    Each unit of several has its topics and its frame under `/unit_1` and so on.

    Parameters
    ----------
    path : .mcap, .bag or a folder, as `BagFile` takes it
    frames : of the clouds of the units
    clock_of : gives each sensor its clock, by its number from 0 and the stamp of its first data packet
    options : transforms
    truth : what else is to be in the bag

    Raises
    ------
    OutputError, MissingExtraError
        as `BagFile`
    RunError
        If the disk is full: here, or later
    """

    def __init__(
        self,
        path: Path,
        frames: Sequence[str],
        clock_of: Callable[[int, int], PacketClock],
        options: BagOptions,
        truth: Truth | None,
    ) -> None:
        self.bag = BagFile(path)
        self._frames, self._clock_of, self._tf, self._truth = frames, clock_of, options.tf, truth
        self._units = dict[int, UnitMessages]()
        self._feeds: Sequence[Callable[[int], None]] | None = None
        self._sent = Counter[PacketKind]()
        self._seen_ns = self._next_ns = -(2**62)

    def __exit__(self, *raised: object) -> None:
        with self.bag:
            if isinstance(raised[1], BaseException):
                raise raised[1]
            for unit in self._units.values():
                unit.check()
            self._write_truth(self._truth.after_ns if self._truth else 0)

    def send(self, packet: Packet) -> None:
        """Take one packet, which is due at the stamp of its capture, and numbered as its frame if it has a number.

        Raises
        ------
        PacketError
            If it is not a VLP-16's
        """
        if (unit := self._units.get(packet.unit)) is None:
            clock = self._clock_of(packet.unit, packet.due_ns)
            unit = self._units[packet.unit] = UnitMessages(self.bag, self._frames[packet.unit], clock)
        self._sent[packet.kind] += 1
        stamp_ns = packet.due_ns // US_NS * US_NS  # as captures have it
        if len(packet.payload) == DATA_BYTES:
            t_ns = unit.data(stamp_ns, packet.payload, packet.number or self._sent.total())
            if self._feeds is None and self._truth is not None:
                to = TrueMessages(self.bag, self._truth.rig, self._truth.scenario, self._frames, self._tf)
                to.fixed(t_ns)
                self._feeds = self._truth.feeds(to, t_ns)
        elif len(packet.payload) == POSITION_BYTES:
            t_ns = unit.position(stamp_ns, packet.payload)
        else:
            return
        self._seen_ns = max(self._seen_ns, t_ns)
        if t_ns >= self._next_ns:
            self._next_ns = t_ns + _OFTEN_NS
            self._write_truth(0)

    def _write_truth(self, after_ns: int) -> None:
        for feed in self._feeds or ():
            feed(self._seen_ns + after_ns)

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


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
