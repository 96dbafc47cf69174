"""The rules of VLP-16 traffic, a row of the table that checks them, and the findings where they are broken."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Level(StrEnum):
    """Weight of a finding."""

    ERROR = "error"
    """No sensor sends it."""
    NOTE = "note"
    """Settings of the user, receivers, old firmware or recorders cause it; the sensor is sound."""


class Rule(StrEnum):
    """Rules of real VLP-16 traffic.

    Sources: 63-9243 Rev D, sections 8 (rates) and 9.3 (packets), and captures of real units.
    """

    FRAMING = "framing"
    """Payloads of 1206 and 512 bytes, whole frames without padding or trailer."""
    PORTS = "ports"
    """Source ports are 2368 and 8308; destination ports may be set."""
    HEADER = "header"
    """IPv4 and UDP header fields of each stream, checksums included."""
    STAMP_ORDER = "stamp-order"
    """Capture stamps never decrease."""
    FLAG = "flag"
    """Every block begins with FF EE."""
    FACTORY = "factory"
    """Return mode and product are known and the product does not change; a change of mode is a note."""
    TIME_RANGE = "time-range"
    """Time stamps lie within the hour."""
    TIME_STEP = "time-step"
    """Time stamps grow by one packet period, over the hour as well."""
    LOST_PACKETS = "lost-packets"
    """No packet is missing."""
    DUPLICATE = "duplicate"
    """No packet comes twice."""
    PACKET_ORDER = "packet-order"
    """Packets come in order of their time stamps."""
    FROZEN = "frozen"
    """No payload is sent again and again, as by a sensor that hangs."""
    SILENCE = "silence"
    """Packets of one kind or the other come all the time, as long as the sensor has power and its cable."""
    LATENESS = "lateness"
    """No packet comes later after its time stamp than those before and after it, by more than 5 ms."""
    CLOCK_DRIFT = "clock-drift"
    """Time stamps keep pace with the capture stamps."""
    AZIMUTH_RANGE = "azimuth-range"
    """Azimuths lie in 0 .. 35999."""
    AZIMUTH_STEP = "azimuth-step"
    """Azimuths grow evenly from block to block, over 0 as well."""
    AZIMUTH_GAP = "azimuth-gap"
    """The whole revolution is sent; a limited field of view, a setting of the manual's section 10.1, is a note."""
    SINGLE_AS_DUAL = "single-as-dual"
    """In single return the first two blocks differ in azimuth, which some software takes for dual."""
    RPM = "rpm"
    """The rotor makes 300 to 1200 revolutions per minute."""
    SPEED = "speed"
    """The rotor holds its speed, a multiple of 60 rpm."""
    LASER = "laser"
    """Every laser has returns where those beside it have."""
    WINDOW = "window"
    """No sector turns dark from one moment to the next."""
    DISTANCE_CODE = "distance-code"
    """Distances are 0 or at least 250 counts."""
    DUAL_AZIMUTH = "dual-azimuth"
    """In dual return the two blocks of a pair have one azimuth."""
    DUAL_ORDER = "dual-order"
    """The last return, in the even block, is never nearer than its pair."""
    DUAL_REFLECTIVITY = "dual-reflectivity"
    """Pairs of equal distance have equal reflectivity, with rare exceptions."""
    POSITION_HEAD = "position-head"
    """Position packets begin with 14 zeros."""
    PPS = "pps"
    """The state of the pulse per second is 0 .. 2; 3 is an error. Once locked it stays locked."""
    NMEA_FORMAT = "nmea-format"
    """The sentence is RMC as NMEA 0183 has it, by a talker GP, else a note; there is one when the state is locked."""
    NMEA_CHECKSUM = "nmea-checksum"
    """The sentence's checksum is right."""
    NMEA_END = "nmea-end"
    """The sentence ends with CR LF, and only NUL follows."""
    NMEA_SECOND = "nmea-second"
    """The sentence names the second before the time stamp, or the one before that; unless locked, a disagreement is a note."""
    NMEA_TIME = "nmea-time"
    """When locked, sentences come at one time after their second, within 0.25 s."""
    DATA_RATE = "data-rate"
    """753.5 data packets per second in single, 1507 in dual return, within 10 %."""
    POSITION_RATE = "position-rate"
    """146 position packets per second as measured, or 53.8 as in the manual, within 10 %."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One place where a rule is broken."""

    rule: Rule
    packet: int
    """Number of the frame in the capture, from 1, as Wireshark counts."""
    found: str
    expected: str
    level: Level = Level.ERROR

    def __str__(self) -> str:
        rule = f"{self.rule} (note)" if self.level is Level.NOTE else self.rule
        return f"packet {self.packet}: {rule}: {self.found}; expected {self.expected}"


class Row(NamedTuple):
    """One row of a table of rules: what breaks a rule in the columns of a chunk, and the words for it."""

    rule: Rule
    broken: str
    """Column of truth values, (n,) or of more axes."""
    found: str
    """Format of the words, with names of columns of the same shape, or of single values."""
    expected: str
    level: Level = Level.ERROR
    at: str = "number"
    """Column of the frame numbers to which the findings belong."""
    once: bool = False
    """Only the first finding is kept; all are counted."""


class _Element:
    """Element `i` of each column, by name."""

    def __init__(self, columns: object, i: int) -> None:
        self._columns, self._i = columns, i

    def __getitem__(self, name: str) -> Any:
        value = getattr(self._columns, name)
        return value.flat[self._i] if isinstance(value, np.ndarray) else value


class Findings:
    """Counts all findings and keeps the first `limit_per_rule` of each rule."""

    def __init__(self, limit_per_rule: int) -> None:
        self._limit = limit_per_rule
        self.counts = {level: Counter[Rule]() for level in Level}
        self.kept: list[Finding] = []
        self._kept_once = set[Row]()

    def add(self, rule: Rule, packet: int, found: str, expected: str, level: Level = Level.ERROR) -> None:
        """Add one finding."""
        if self.counts[level][rule] < self._limit:
            self.kept.append(Finding(rule, packet, found, expected, level))
        self.counts[level][rule] += 1

    def apply(self, table: Iterable[Row], columns: object, where: slice = slice(None)) -> None:
        """Add a finding for each true element in the columns that a table names; `where` limits the rows of a chunk."""
        for row in table:
            broken: NDArray[np.bool_] = getattr(columns, row.broken)
            inside = np.zeros_like(broken)
            inside[where] = broken[where]
            if not (places := np.flatnonzero(inside)).size:
                continue
            number = getattr(columns, row.at).ravel()
            most = max(self._limit - self.counts[row.level][row.rule], 0)
            if row.once:
                most = int(row not in self._kept_once)
                self._kept_once.add(row)
            for i in places[:most].tolist():
                element = _Element(columns, i)
                found, expected = (text.format_map(element) for text in (row.found, row.expected))
                self.kept.append(Finding(row.rule, int(number[i]), found, expected, row.level))
            self.counts[row.level][row.rule] += len(places)
