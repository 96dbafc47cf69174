"""Captures checked against the rules of a sensor's traffic, unit by unit."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vlp16emu.captures.capture import Capture
from vlp16emu.captures.datagrams import Datagram, table_of
from vlp16emu.captures.survey import chosen_unit
from vlp16emu.captures.units import CapturedUnit, parts_by_unit
from vlp16emu.errors import CaptureError
from vlp16emu.extras.verify.calm import LONGEST, CalmRun, calm_run
from vlp16emu.extras.verify.clocks import SILENCE_US, GpsGains, HostClock
from vlp16emu.extras.verify.data import DataChunk, DataRules, PositionRules
from vlp16emu.extras.verify.frames import (
    PAYLOAD_BYTES,
    PORT,
    Finding,
    Findings,
    InOrder,
    Level,
    Rule,
    check_frames,
    kind_of,
)
from vlp16emu.packets.layout import layout_of_bytes
from vlp16emu.packets.table import PacketClock
from vlp16emu.types import PacketKind, SensorModel
from vlp16emu.units import S_NS, US_NS

_CHUNK_PACKETS = 512  # data packets checked together: 0.6 MB, 0.7 s of single return
_HELD_PACKETS = 16 * _CHUNK_PACKETS
_SMALLEST_CHUNK = 16
"""Total length of the chunks of all units, and the least length of a chunk."""
_MODE_AT = -2  # return mode and product end a data payload
_SHORTEST_S = 2.0  # least span to judge rates: position packets arrive at irregular intervals
_RATE_TOLERANCE = 0.1
_POSITION_RATES_HZ = (146.0, 53.8)
"""Measured on two units in single return; 63-9243 Rev D, section 8.2.2, p. 50."""


@dataclass(frozen=True, slots=True)
class Verification:
    """Contents of a capture, and its broken rules."""

    model: SensorModel
    data_packets: int
    position_packets: int
    other_frames: int  # frames of other traffic and of other units, which are not checked
    lost_packets: int  # missing data and position packets
    void_sentences: int
    """Seconds without a GPS fix, from the status V of sentences; trees cause them too."""
    span_s: float  # time from the first packet to the last, by the sensor's clock; by the host's if it is set
    rpm: float | None  # mean rotor speed; None without data packets
    is_cut: bool
    """True if the file ends in the middle of a packet, as after a killed recorder; the rest is checked."""
    damage: tuple[str, ...]  # damaged parts of the file that were left out
    counts: Mapping[Rule, int]  # errors of each broken rule
    notes: Mapping[Rule, int]
    """Findings of each rule that settings, receivers, old firmware or recorders cause."""
    findings: tuple[Finding, ...]  # the first findings of each rule, by packet number

    @property
    def is_clean(self) -> bool:
        """True if no rule is broken; there may be notes."""
        return not self.counts


def verify(capture: str | Path, unit: str | int | None = None, *, limit_per_rule: int = 10) -> Verification:
    """Check a sensor's packets in a capture against the rules of VLP-16 traffic.

    Parameters
    ----------
    capture : file or pattern of files, as `Capture`
    unit : sensor, if there are several: its number from 1, or `address:port` with its data port
    limit_per_rule : findings kept of each rule; all are counted

    Raises CaptureError if the file cannot be read, or has no VLP-16 packets; InputError if there is no such
    unit, or `unit` is missing and there are several.
    """
    path = Path(capture)
    chosen = chosen_unit(path, None if unit is None else str(unit))
    return verify_units(path, [chosen], limit_per_rule=limit_per_rule)[0]


def verify_units(
    path: Path,
    units: Sequence[CapturedUnit | None],
    *,
    limit_per_rule: int = 10,
    progress: Callable[[float], None] | None = None,
) -> list[Verification]:
    """Check each of several units on its own, in one pass and with little memory.

    None among the units stands for all packets of the capture; `progress` is called with the share that is
    read.
    """
    chunk_packets = min(_CHUNK_PACKETS, max(_HELD_PACKETS // max(len(units), 1), _SMALLEST_CHUNK))
    checks = [_Check(Findings(limit_per_rule), chunk_packets) for _ in units]
    capture = Capture(path, repeats=True, progress=progress)
    held: list[list[Datagram]] = [[] for _ in units]
    for unit, datagrams in parts_by_unit(capture, units):
        if unit is not None:
            own = held[unit]
            own += datagrams
            whole = len(own) // LONGEST * LONGEST
            for first in range(0, whole, LONGEST):
                checks[unit].take(own[first : first + LONGEST])
            held[unit] = own[whole:]
    for check, left in zip(checks, held, strict=True):
        check.take(left)
    return [check.finish(path, capture) for check in checks]


class _Check:
    """Check of one unit: it sorts datagrams by kind, counts them, and passes them on in chunks."""

    def __init__(self, findings: Findings, chunk_packets: int) -> None:
        self._findings = findings
        self._chunk_packets = chunk_packets
        self._clock = HostClock(findings)
        self._gains = GpsGains()
        self._data = DataRules(findings)
        self._position = PositionRules(findings)
        self._in_order = {kind: InOrder(kind, findings) for kind in PORT}
        self._chunk: dict[PacketKind, list[Datagram]] = {kind: [] for kind in PORT}
        self._before: Datagram | None = None
        """Last data packet of the chunk before, if this chunk continues it."""
        self._factory = b""
        self._packets = Counter[PacketKind]()
        self._first: dict[PacketKind, Datagram] = {}
        self._last: dict[PacketKind, Datagram] = {}
        self._ports = set[tuple[PacketKind, int]]()
        self._stamp_ns: int | None = None

    def take(self, datagrams: Sequence[Datagram]) -> None:
        """Check datagrams, or keep them for their chunks: all at once, or one by one."""
        if datagrams and not self._take_run(datagrams):
            for datagram in datagrams:
                kind = kind_of(datagram)
                if kind is not None:
                    self._take_all(self._clock.follow(datagram, kind))

    def _take_run(self, datagrams: Sequence[Datagram]) -> bool:
        """Take datagrams at once, and return True; False if that is not possible, and nothing is changed."""
        run = calm_run(datagrams)
        if run is None or not self._is_calm(run) or (run := self._clock.follow_run(run)) is None:
            return False
        self._stamp_ns = int(run.host_ns[-1])
        for kind in PORT:
            own = run.of(kind).datagrams
            if own:
                self._packets[kind] += len(own)
                self._first.setdefault(kind, own[0])
                self._last[kind] = own[-1]
        while len(run.datagrams):
            stop = min(self._until_chunk(run, kind) for kind in PORT)
            self._collect_run(run.part(0, stop))
            run = run.part(stop, len(run.datagrams))
        return True

    def _is_calm(self, run: CalmRun) -> bool:
        """Return True if a run changes neither mode nor state, and its packets are in order."""
        data = run.of(PacketKind.DATA)
        position = run.of(PacketKind.POSITION)
        waiting = self._in_order[PacketKind.DATA].held + self._chunk[PacketKind.DATA][-1:]
        if len({each.payload[_MODE_AT:] for each in (*waiting, *data.datagrams)}) != 1:
            return False
        host_ns = run.host_ns - self._clock.set_ns
        is_ordered = np.diff(host_ns, prepend=self._stamp_ns or host_ns[0]) >= 0
        return (
            bool(is_ordered.all())
            and not self._gains.has_new(position.datagrams)
            and self._in_order[PacketKind.DATA].continues(data.stamp_us, SILENCE_US)
            and self._in_order[PacketKind.POSITION].continues(position.stamp_us, SILENCE_US)
        )

    def _until_chunk(self, run: CalmRun, kind: PacketKind) -> int:
        """Return the number of packets of a run up to that which completes a chunk of a kind, or all."""
        missing = self._chunk_packets - len(self._chunk[kind])
        places = np.flatnonzero(run.is_data == (kind is PacketKind.DATA))
        needed = self._in_order[kind].count_until(missing)
        return int(places[needed - 1]) + 1 if needed <= len(places) else len(run.datagrams)

    def _collect_run(self, run: CalmRun) -> None:
        """Collect the packets of a run as `_collect` does; only its last one may complete a chunk."""
        for kind in PORT:
            own = run.of(kind)
            self._chunk[kind] += self._in_order[kind].extend(own.stamp_us, own.datagrams)
        if len(self._chunk[PacketKind.DATA]) >= self._chunk_packets:
            self._check_data(ends=False)
            self._check_position()
        elif len(self._chunk[PacketKind.POSITION]) >= self._chunk_packets:
            self._check_position()

    def _take_all(self, datagrams: Iterable[tuple[PacketKind, Datagram]]) -> None:
        for kind, datagram in datagrams:
            self._take_one(kind, datagram)

    def _take_one(self, kind: PacketKind, datagram: Datagram) -> None:
        number = datagram.number
        since_ns = 0 if self._stamp_ns is None else datagram.stamp_ns - self._stamp_ns
        if since_ns < 0:
            found = f"{-since_ns / US_NS:.0f} us before the packet in front of it"
            self._findings.add(Rule.STAMP_ORDER, number, found, "stamps that do not decrease")
        self._stamp_ns = datagram.stamp_ns
        self._packets[kind] += 1
        self._first.setdefault(kind, datagram)
        self._last[kind] = datagram
        if len(datagram.payload) != PAYLOAD_BYTES[kind]:
            self._report_length(kind, datagram)
            if kind is PacketKind.DATA:
                self._finish_data()
            return
        if kind is PacketKind.POSITION:
            self._gains.take(datagram)
        stream = kind, datagram.source_port
        is_other = datagram.source_port != PORT[kind] and self._has_known_frame(datagram)
        if is_other and stream not in self._ports:
            self._ports.add(stream)
            found = f"{kind} packets from {datagram.source_port}, as a relay sends them"
            self._findings.add(Rule.PORTS, number, found, f"from {PORT[kind]}")
        self._collect(kind, self._in_order[kind].take(datagram))

    def _has_known_frame(self, datagram: Datagram) -> bool:
        """Return True if the headers of a datagram's sensor are known."""
        if len(datagram.payload) != PAYLOAD_BYTES[PacketKind.DATA]:
            return self._data.layout.model.has_known_frame
        return layout_of_bytes(*datagram.payload[_MODE_AT:]).model.has_known_frame

    def _report_length(self, kind: PacketKind, datagram: Datagram) -> None:
        found = f"a {kind} payload of {len(datagram.payload)} bytes"
        expected = f"{PAYLOAD_BYTES[kind]} bytes"
        if datagram.captured_bytes < datagram.wire_bytes:
            found = f"a {kind} frame, {datagram.captured_bytes} of {datagram.wire_bytes} bytes captured"
            expected = "whole frames (`tcpdump -s 0`)"
        self._findings.add(Rule.FRAMING, datagram.number, found, expected)

    def finish(self, path: Path, capture: Capture) -> Verification:
        """Check the remaining packets, and return the result."""
        self._take_all(self._clock.rest())
        if not self._packets:
            found = f"no VLP-16 packets, but {capture.missed}" if capture.missed else "no VLP-16 packets"
            raise CaptureError(str(path), found, "data packets on UDP port 2368")
        self._finish_data()
        self._data.finish()
        self._collect(PacketKind.POSITION, self._in_order[PacketKind.POSITION].rest())
        self._check_position()
        self._check_rates()
        return Verification(
            model=self._data.layout.model.name,
            data_packets=self._packets[PacketKind.DATA],
            position_packets=self._packets[PacketKind.POSITION],
            other_frames=capture.frames - self._packets.total(),
            lost_packets=self._data.lost_packets + self._position.lost_packets,
            void_sentences=self._position.void_sentences,
            span_s=self._span_s(),
            rpm=self._data.rpm,
            is_cut=capture.cut,
            damage=tuple(capture.damage),
            counts=dict(self._findings.counts[Level.ERROR]),
            notes=dict(self._findings.counts[Level.NOTE]),
            findings=tuple(sorted(self._findings.kept, key=lambda finding: finding.packet)),
        )

    def _span_s(self) -> float:
        """Return the duration, by capture stamps if no packet has a time stamp."""
        if self._clock.elapsed_us:
            return self._clock.elapsed_us * US_NS / S_NS
        stamps_ns = [each.stamp_ns for ends in (self._first, self._last) for each in ends.values()]
        return (max(stamps_ns) - min(stamps_ns)) / S_NS

    def _collect(self, kind: PacketKind, datagrams: Iterable[Datagram]) -> None:
        """Collect packets in order; a chunk of data packets ends at a change of mode or product."""
        for datagram in datagrams:
            held = self._chunk[kind]
            if (
                kind is PacketKind.DATA
                and held
                and held[-1].payload[_MODE_AT:] != datagram.payload[_MODE_AT:]
            ):
                self._check_data(ends=True)
            self._chunk[kind].append(datagram)
            if len(self._chunk[kind]) >= self._chunk_packets:
                if kind is PacketKind.DATA:
                    self._check_data(ends=False)
                self._check_position()

    def _finish_data(self) -> None:
        self._collect(PacketKind.DATA, self._in_order[PacketKind.DATA].rest())
        self._check_data(ends=True)

    def _check_data(self, *, ends: bool) -> None:
        """Check the collected packets; the last one stays as the neighbour of the next chunk."""
        chunk = self._chunk[PacketKind.DATA]
        if chunk:
            continues = chunk[0] is self._before
            table = table_of(chunk, PacketClock())
            columns = DataChunk(table, self._factory, self._gains, continues=continues, ends=ends)
            is_known = columns.layout.model.has_known_frame
            check_frames(chunk[continues:], PacketKind.DATA, self._findings, is_known=is_known)
            self._data.check(columns)
            self._before = chunk[-1]
            self._factory = chunk[-1].payload[_MODE_AT:]
        self._chunk[PacketKind.DATA] = [] if ends else chunk[-1:]

    def _check_position(self) -> None:
        if chunk := self._chunk[PacketKind.POSITION]:
            is_known = self._data.layout.model.has_known_frame
            check_frames(chunk, PacketKind.POSITION, self._findings, is_known=is_known)
            self._position.check(chunk, self._gains)
        self._chunk[PacketKind.POSITION] = []

    def _check_rates(self) -> None:
        """Check packets per second, lost ones included.

        The counts are those of position packets and of the time that data packets cover.
        """
        data_s = self._kind_span_s(PacketKind.DATA) - self._data.left_out_us * US_NS / S_NS
        nominal_hz = S_NS / self._data.layout.period_ns
        covered = self._data.covered_us * US_NS / S_NS * nominal_hz
        copies = self._in_order[PacketKind.POSITION].duplicates  # by a bridge or a recorder
        sent = self._packets[PacketKind.POSITION] - copies - 1 + self._position.lost_packets
        self._check_rate(PacketKind.DATA, covered, data_s, (nominal_hz,))
        position_s = self._kind_span_s(PacketKind.POSITION)
        self._check_rate(PacketKind.POSITION, sent, position_s, _POSITION_RATES_HZ)

    def _kind_span_s(self, kind: PacketKind) -> float:
        """Return the time from the first to the last packet of a kind by the host's clock; 0 without any."""
        if kind not in self._first:
            return 0.0
        return (self._last[kind].stamp_ns - self._first[kind].stamp_ns) / S_NS

    def _check_rate(self, kind: PacketKind, count: float, span_s: float, usual_hz: Sequence[float]) -> None:
        """Compare the rate of `count` packets over a span with the usual rates."""
        if span_s < _SHORTEST_S:
            return
        rate_hz = count / span_s
        if all(abs(rate_hz / hz - 1) > _RATE_TOLERANCE for hz in usual_hz):
            found = f"{rate_hz:.1f} {kind} packets per second"
            words = " or ".join(f"{hz:.1f}" for hz in usual_hz)
            rule = Rule.DATA_RATE if kind is PacketKind.DATA else Rule.POSITION_RATE
            number = self._last[kind].number
            self._findings.add(rule, number, found, f"{words} within {_RATE_TOLERANCE:.0%}")
