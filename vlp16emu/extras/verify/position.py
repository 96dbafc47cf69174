"""Position packets as columns, and their rules. Source: 63-9243 Rev D, section 9.3.3, p. 60, and captures of real units."""

import math
import re
from collections.abc import Sequence
from functools import lru_cache, reduce
from operator import xor
from typing import NamedTuple

import numpy as np

from vlp16emu.extras.verify.frames import HOUR_US, SENTENCE_OFFSET, ClockWatch, is_rewritten
from vlp16emu.extras.verify.rules import Findings, Level, Row, Rule
from vlp16emu.packets.capture import Datagram
from vlp16emu.packets.layout import POSITION_PAYLOAD
from vlp16emu.types import PpsState
from vlp16emu.units import MS_NS, S_NS, US_NS

_HEAD_BYTES = 14  # other sensors of the family report motion from here on; software takes the zeros for a mark
_SHORTEST_INTERVAL_NS = 1_400_000  # real units leave 1.47 ms or more between position packets
_LATEST_S = 2  # the sentence of a second arrives during the next one, and until then its forerunner is echoed
_UNEVEN_S = 0.25  # difference between the delays of two sentences of one receiver
_NEXT_NS = 50 * MS_NS  # position packets farther apart than this do not show when a sentence came
_SENTENCE_CHARACTERS = 82  # longest sentence of NMEA 0183
_SENTENCE = re.compile(
    rb"\$(?P<talker>[A-Z]{2})RMC,"
    rb"((?P<time>([01]\d|2[0-3])[0-5]\d[0-5]\d)(\.\d*)?)?,"
    rb"(?=(?P<status>[AV]),)"
    rb"(A,\d{4}(\.\d*)?,[NS],\d{5}(\.\d*)?,[EW]|V,(\d{4}(\.\d*)?)?,[NS]?,(\d{5}(\.\d*)?)?,[EW]?),"
    rb"(\d+(\.\d*)?)?,(\d+(\.\d*)?)?,"  # speed, course
    rb"([0-3]\d[01]\d\d\d)?,"
    rb"(\d+(\.\d*)?)?,[EW]?"  # magnetic variation
    rb"(,[ADEFMNPRS]?(,[SCUV]?)?)?"  # mode since NMEA 0183 version 2.3, navigational status since 4.1
)


class _Sentence(NamedTuple):
    """Contents of a sentence, and the words of its faults, empty without one."""

    second: int = -1  # past the hour; -1 unless the sentence names a time
    status: str = ""
    malformed: str = ""
    end: str = ""
    checksum: str = ""
    right: str = ""  # the checksum that it should have
    talker: str = ""  # talker of a receiver other than GPS alone, whose sentences the manual does not name


class PositionChunk:
    """Columns of n consecutive position packets; the first is the last one of the chunk `before`, which has judged it."""

    def __init__(self, datagrams: Sequence[Datagram], before: "PositionChunk | None") -> None:
        self.last = datagrams[-1]
        every = [before.last, *datagrams] if before else list(datagrams)
        self.own = slice(1 if before else 0, None)
        self.number, self.stamp_ns, self.identification = np.array(
            [(each.number, each.stamp_ns, each.identification) for each in every]
        ).T
        payload = np.frombuffer(b"".join(each.payload for each in every), np.uint8).reshape(len(every), -1)
        fields = payload.view(POSITION_PAYLOAD)[:, 0]
        self.head = payload[:, :_HEAD_BYTES].max(axis=1)
        self.has_head = self.head > 0
        self.timestamp_us, self.pps = fields["timestamp_us"].astype(np.int64), fields["pps"]
        self.clock_s, self.is_past_hour = self.timestamp_us * US_NS / S_NS, self.timestamp_us >= HOUR_US
        self.state = np.array([*map(str.lower, PpsState.__members__), ""])[self.pps.clip(0, len(PpsState))]
        self.is_no_state, is_error = self.pps >= len(PpsState), self.pps == PpsState.ERROR
        was = np.append(PpsState.ABSENT, self.pps[:-1])
        self.is_lost_lock = (was == PpsState.LOCKED) & (self.pps != was) & ~self.is_no_state
        self.is_error = is_error & (was != PpsState.ERROR) & ~self.is_lost_lock
        self._count(every)
        self._read_sentences(every, before)

    def _count(self, every: Sequence[Datagram]) -> None:
        """Hold the identifications to their count of position packets."""
        self.due = np.append(self.identification[0], (self.identification[:-1] + 1) % 0x10000)
        self.missing = (self.identification - self.due) % 0x10000
        most = np.diff(self.stamp_ns, prepend=self.stamp_ns[0]).clip(0) // _SHORTEST_INTERVAL_NS
        is_own = np.array([not is_rewritten(each) for each in every])
        self.is_lost = (self.missing > 0) & (self.missing <= most) & is_own
        self.is_no_count = (self.missing > most) & is_own

    def _read_sentences(self, every: Sequence[Datagram], before: "PositionChunk | None") -> None:
        """Read the sentences, and hold their seconds against the clock and against the sentences before."""
        areas = [each.payload[SENTENCE_OFFSET:] for each in every]
        columns = zip(*map(_read_sentence, areas), strict=True)
        self.second, self.status, self.malformed, self.end, self.checksum, self.right, talker = map(np.array, columns)
        self.talker = np.where(talker == np.append("", talker[:-1]), "", talker)
        self.named = np.array([f"{second // 60:02d}:{second % 60:02d}" for second in self.second.tolist()])
        is_locked, is_known = self.pps == PpsState.LOCKED, self.second >= 0
        self.is_missing = is_locked & np.array([not any(area) for area in areas])
        place = np.maximum.accumulate(np.where(is_known, np.arange(len(every)), -1))
        said = np.where(place >= 0, self.second[place], before.said if before else -1)
        earlier = np.append(before.said if before else -1, said[:-1])
        self.said: int = said[-1]
        self.is_void = is_known & (self.status == "V") & (self.second != earlier)
        self.late_s = (self.clock_s - self.second) % 3600
        is_old = is_known & (self.late_s >= _LATEST_S)
        self.is_old, self.is_off = (
            of & ~np.append(False, of[:-1]) for of in (is_old & is_locked, is_old & ~is_locked & (self.status == "A"))
        )
        """First of packets in a row whose sentence and clock disagree, with lock and without."""
        is_next = is_locked & is_known & ~is_old & (earlier >= 0) & (self.second == (earlier + 1) % 3600)
        is_next[1:] &= np.diff(self.stamp_ns) < _NEXT_NS
        came_s = self.late_s[self.own][is_next[self.own]]
        self.comes_s: float = before.comes_s if before else math.nan
        if math.isnan(self.comes_s) and len(came_s):
            self.comes_s = float(came_s[0])
        self.is_uneven = is_next & (np.abs(self.late_s - self.comes_s) > _UNEVEN_S)


class PositionRules:
    """Checks position packets, chunk by chunk."""

    def __init__(self, findings: Findings) -> None:
        self._findings, self._clock = findings, ClockWatch(findings)
        self._before: PositionChunk | None = None
        self.void_sentences = 0
        """Seconds whose sentence has the status V."""
        self.lost_packets = 0

    def check(self, datagrams: Sequence[Datagram]) -> None:
        """Check packets of 512 bytes."""
        chunk = self._before = PositionChunk(datagrams, self._before)
        self._findings.apply(_TABLE, chunk, chunk.own)
        for datagram, timestamp_us in zip(datagrams, chunk.timestamp_us[chunk.own].tolist(), strict=True):
            self._clock.check(datagram.number, datagram.stamp_ns, datagram.stamp_ns // US_NS - timestamp_us)
        self.void_sentences += int(chunk.is_void[chunk.own].sum())
        self.lost_packets += int(chunk.missing[chunk.own][chunk.is_lost[chunk.own]].sum())


_OLD = "no sentence after that of {named} at {clock_s:.3f} s"
_TABLE = (
    Row(Rule.POSITION_HEAD, "has_head", "a byte 0x{head:02x} among the first", f"{_HEAD_BYTES} zeros"),
    Row(Rule.PPS, "is_no_state", "state {pps}", "0 .. 3"),
    Row(Rule.PPS, "is_lost_lock", "state {pps}, {state}, from here on", "2, locked, as before"),
    Row(Rule.PPS, "is_error", "state {pps}, {state}, from here on", "0 .. 2"),
    Row(Rule.TIME_RANGE, "is_past_hour", "time stamp {timestamp_us} us", f"0 .. {HOUR_US - 1}"),
    Row(Rule.LOST_PACKETS, "is_lost", "{missing} position packets missing before it", "none"),
    Row(Rule.HEADER, "is_no_count", "position identification {identification}", "{due}, one more than before"),
    Row(Rule.NMEA_FORMAT, "is_missing", "no sentence", "one when locked"),
    Row(Rule.NMEA_FORMAT, "malformed", "{malformed}", "$GPRMC,time,status,... with 12 to 14 fields"),
    Row(Rule.NMEA_FORMAT, "talker", "${talker}RMC, which some units ignore", "$GPRMC, as in the manual", Level.NOTE),
    Row(Rule.NMEA_END, "end", "{end}", "CR LF, then NUL to the end"),
    Row(Rule.NMEA_CHECKSUM, "checksum", "checksum {checksum}", "{right}"),
    Row(Rule.NMEA_SECOND, "is_old", _OLD, f"one less than {_LATEST_S} s old"),
    Row(Rule.NMEA_SECOND, "is_off", _OLD, "a clock that follows the sentences", Level.NOTE),
    Row(Rule.NMEA_TIME, "is_uneven", "sentence {named} {late_s:.2f} s after its second", "{comes_s:.2f} s, as before"),
)


@lru_cache(16)
def _read_sentence(area: bytes) -> _Sentence:
    """Read the characters from the first of a sentence to the end of the payload; one sentence fills some 146 packets."""
    if not any(area):
        return _Sentence()
    text, _, rest = area.partition(b"\0")
    end = "characters after a NUL" if any(rest) else "" if text.endswith(b"\r\n") else f"an end of {text[-4:]!r}"
    body, star, checksum = text.rstrip(b"\r\n").rpartition(b"*")
    match = _SENTENCE.fullmatch(body)
    if match is None or not star:
        return _Sentence(malformed=repr(text[:_SENTENCE_CHARACTERS]), end=end)
    time, talker = match["time"], match["talker"].decode()
    right, found = f"{reduce(xor, body[1:]):02X}", checksum.decode("ascii", "replace")
    return _Sentence(
        second=60 * int(time[2:4]) + int(time[4:]) if time else -1,
        status=match["status"].decode(),
        end=end,
        checksum="" if found == right else found or "of no digits",
        right=right,
        talker="" if talker == "GP" else talker,
    )
