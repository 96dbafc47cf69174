"""Rules about position packets. Source: 63-9243 Rev D, section 9.3.3, p. 60, and captures of real units."""

import re
from functools import lru_cache

import numpy as np

from vlp16emu.extras.verify.frames import HOUR_US, SENTENCE_OFFSET, ClockWatch, is_rewritten
from vlp16emu.extras.verify.rules import Findings, Rule
from vlp16emu.packets.capture import Datagram
from vlp16emu.packets.layout import POSITION_PAYLOAD
from vlp16emu.types import PpsState
from vlp16emu.units import MS_NS, S_NS, US_NS

_HEAD_BYTES = 14
"""Other sensors of the family report motion from here on; software takes the zeros for a mark."""
_SHORTEST_INTERVAL_NS = 1_400_000
"""Real units leave 1.47 ms or more between position packets."""
_LATEST_S = 2
"""The sentence of a second arrives during the next one, and until then its forerunner is echoed."""
_UNEVEN_S = 0.25
"""By which receivers may be later with one sentence than with another."""
_NEXT_NS = 50 * MS_NS
"""Position packets farther apart than this do not show when a sentence came."""
_STATES = {PpsState.ABSENT: "absent", PpsState.SYNCHRONIZING: "synchronizing", PpsState.ERROR: "error"}
_SENTENCE_CHARACTERS = 82
"""Longest sentence of NMEA 0183."""
_SENTENCE = re.compile(
    rb"\$GPRMC,"
    rb"(?P<hour>[01]\d|2[0-3])(?P<minute>[0-5]\d)(?P<second>[0-5]\d)(\.\d{1,3})?,"
    rb"(?=(?P<status>[AV]),)"
    rb"(A,\d{4}\.\d+,[NS],\d{5}\.\d+,[EW]|V,(\d{4}\.\d+)?,[NS]?,(\d{5}\.\d+)?,[EW]?),"
    rb"(\d+(\.\d*)?)?,(\d+(\.\d*)?)?,"  # speed, course
    rb"([0-3]\d[01]\d\d\d),"
    rb"(\d+(\.\d*)?)?,[EW]?"  # magnetic variation
    rb"(,[ADEFMNPRS])?"  # mode, since NMEA 0183 version 2.3
)
_Fault = tuple[Rule, str, str]


class PositionRules:
    """Checks position packets one by one."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._clock = ClockWatch(findings)
        self._before: Datagram | None = None
        self._pps = int(PpsState.ABSENT)
        self._second: int | None = None
        self._comes_s: float | None = None
        self.void_sentences = 0
        """Seconds whose sentence has the status V."""
        self.lost_packets = 0

    def check(self, datagram: Datagram) -> None:
        """Check one packet of 512 bytes."""
        number = datagram.number
        fields = np.frombuffer(datagram.payload, POSITION_PAYLOAD)[0]
        timestamp_us, pps = int(fields["timestamp_us"]), int(fields["pps"])
        if any(datagram.payload[:_HEAD_BYTES]):
            found = f"bytes {datagram.payload[:_HEAD_BYTES].hex(' ')}"
            self._findings.add(Rule.POSITION_HEAD, number, found, f"{_HEAD_BYTES} zeros")
        self._check_pps(number, pps)
        if timestamp_us >= HOUR_US:
            found = f"time stamp {timestamp_us} us"
            self._findings.add(Rule.TIME_RANGE, number, found, f"0 .. {HOUR_US - 1}")
        self._clock.check(number, datagram.stamp_ns, datagram.stamp_ns // US_NS - timestamp_us)
        self._check_counter(datagram)
        self._check_sentence(datagram, timestamp_us, is_locked=pps == PpsState.LOCKED)
        self._before = datagram

    def _check_pps(self, number: int, pps: int) -> None:
        """Check the state of the pulse where it changes."""
        before, self._pps = self._pps, pps
        if pps not in set(PpsState):
            self._findings.add(Rule.PPS, number, f"state {pps}", "0 .. 3")
        elif pps != before and (pps == PpsState.ERROR or before == PpsState.LOCKED):
            found = f"state {pps}, {_STATES[PpsState(pps)]}, from here on"
            self._findings.add(Rule.PPS, number, found, "2, locked, as before" if before == 2 else "0 .. 2")

    def _check_counter(self, datagram: Datagram) -> None:
        """Hold the identification to its count of position packets."""
        if self._before is None or is_rewritten(datagram):
            return
        ahead = (datagram.identification - self._before.identification) % 0x10000
        most = 1 + max(datagram.stamp_ns - self._before.stamp_ns, 0) // _SHORTEST_INTERVAL_NS
        if 1 < ahead <= most:
            self.lost_packets += ahead - 1
            found = f"{ahead - 1} position packets missing before it"
            self._findings.add(Rule.LOST_PACKETS, datagram.number, found, "none")
        elif ahead != 1:
            found = f"position identification {datagram.identification}"
            expected = f"{(self._before.identification + 1) % 0x10000}, one more than before"
            self._findings.add(Rule.HEADER, datagram.number, found, expected)

    def _check_sentence(self, datagram: Datagram, timestamp_us: int, *, is_locked: bool) -> None:
        """Check the sentence, and its time where it is bound to the clock."""
        area = datagram.payload[SENTENCE_OFFSET:]
        if not any(area):
            if is_locked:
                self._findings.add(Rule.NMEA_FORMAT, datagram.number, "no sentence", "one when locked")
            return
        faults, second, is_void = _read_sentence(area)
        for rule, found, expected in faults:
            self._findings.add(rule, datagram.number, found, expected)
        if second is None:
            return
        before, self._second = self._second, second
        self.void_sentences += is_void and second != before
        if not is_locked:
            return
        late_s = (timestamp_us * US_NS / S_NS - second) % 3600
        named = f"{second // 60:02d}:{second % 60:02d}"
        if late_s >= _LATEST_S:
            found = f"no sentence after that of {named} at {timestamp_us / 1e6:.3f} s"
            expected = f"one less than {_LATEST_S} s old"
            self._findings.add(Rule.NMEA_SECOND, datagram.number, found, expected)
        elif (
            before is not None
            and second == (before + 1) % 3600
            and self._before
            and datagram.stamp_ns - self._before.stamp_ns < _NEXT_NS
        ):
            self._comes_s = late_s if self._comes_s is None else self._comes_s
            if abs(late_s - self._comes_s) > _UNEVEN_S:
                found = f"the sentence of {named} {late_s:.2f} s after its second"
                self._findings.add(Rule.NMEA_TIME, datagram.number, found, f"{self._comes_s:.2f} s, as before")


@lru_cache(16)
def _read_sentence(area: bytes) -> tuple[tuple[_Fault, ...], int | None, bool]:
    """Faults of the sentence, its second past the hour, and whether it is void; one sentence fills some 146 packets.

    Parameters
    ----------
    area : from the first character to the end of the payload
    """
    text, _, rest = area.partition(b"\0")
    faults: list[_Fault] = []
    if not text.endswith(b"\r\n") or any(rest):
        found = "characters after a NUL" if any(rest) else f"an end of {text[-4:]!r}"
        faults.append((Rule.NMEA_END, found, "CR LF, then NUL to the end"))
    body, star, checksum = text.rstrip(b"\r\n").rpartition(b"*")
    match = _SENTENCE.fullmatch(body)
    if match is None or not star:
        expected = "$GPRMC,time,status,... with 12 or 13 fields"
        faults.append((Rule.NMEA_FORMAT, repr(text[:_SENTENCE_CHARACTERS]), expected))
        return tuple(faults), None, False
    wanted = f"{int(np.bitwise_xor.reduce(np.frombuffer(body[1:], np.uint8))):02X}"
    if checksum != wanted.encode():
        faults.append((Rule.NMEA_CHECKSUM, f"checksum {checksum.decode('ascii', 'replace')}", wanted))
    return tuple(faults), 60 * int(match["minute"]) + int(match["second"]), match["status"] == b"V"
