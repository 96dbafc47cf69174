"""A real GPS receiver on the sensor's serial input: its pulses and sentences set the clock, and the state that packets report."""

import re
import threading
from dataclasses import dataclass

from vlp16emu.errors import PacketError
from vlp16emu.packets.nmea import KNOT_M_S, fields_of, rmc_time, utc_ns
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import HOUR_NS, MS_NS, S_NS

_LINE = re.compile(rb"[^\r\n]*[\r\n]+")
_LONGEST = 256  # bytes without an end of line, after which they are no sentence: twice what a position packet holds
_STEADY_NS = 5 * MS_NS
"""By which pulses may miss their second and still be steady: what a program that looks at a line every millisecond, beside others,
makes of a pulse that is exact to a microsecond (assumption)."""
_LOST_NS = S_NS + S_NS // 2  # after so long without a pulse there is none
_STALE_NS = 5 * S_NS  # after so long without a good sentence the clock is no longer set by it (assumption)
_SHARE = 8
"""A pulse moves the clock by this part of the time that it is off, so that the stamps do not show how late a line was looked at."""


@dataclass(frozen=True, slots=True)
class Heard:
    """Input of a receiver so far."""

    pulses: int
    sentences: int
    """Good ones."""
    refused: int
    """RMC sentences that were garbled; others are not looked at."""


class GpsLine:
    """The sensor's end of the line; instants are those of one clock of the host, in ns. Threads may share it.

    Parameters
    ----------
    power_up_ns : when the sensor's own clock was at zero
    window_ns : for so long pulses must be steady ("Require PPS lock", delay; 63-9243 Rev D, appendix G)
    requires_valid : whether only sentences of status A set the clock ("Require GPS receiver valid")
    sentence_delay_ns : where no pulse comes by a line, how long before its sentence a second began; None for a line that pulses
    """

    def __init__(
        self, power_up_ns: int, *, window_ns: int, requires_valid: bool, sentence_delay_ns: int | None
    ) -> None:
        self._window_ns, self._requires_valid, self._delay_ns = window_ns, requires_valid, sentence_delay_ns
        self._lock = threading.RLock()  # `receive` takes pulses
        self._buffer = b""
        self._pulses = self._sentences = self._refused = 0
        self._zero_ns = power_up_ns
        """Instant at which the clock showed a whole hour."""
        self._edge_ns: int | None = None
        self._steady_since_ns: int | None = None
        self._is_bad = False
        self._set_ns: int | None = None
        self.sentence = b""
        """Last sentence, with CR and LF; empty before the first."""

    def pulse(self, t_ns: int) -> None:
        """Take the rising edge of a pulse.

        It pulls the fraction of a second to the edge: at once at first, in small parts once pulses are steady.
        """
        with self._lock:
            self._pulses += 1
            since_ns = _LOST_NS + 1 if self._edge_ns is None else t_ns - self._edge_ns
            off_ns = (t_ns - self._zero_ns + S_NS // 2) % S_NS - S_NS // 2
            is_first = since_ns > _LOST_NS
            self._is_bad = not is_first and abs(since_ns - S_NS) > _STEADY_NS  # no second apart
            if is_first or self._is_bad:
                self._steady_since_ns = t_ns
            self._zero_ns += off_ns if is_first or self._is_bad else off_ns // _SHARE
            self._edge_ns = t_ns

    def receive(self, data: bytes, t_ns: int) -> None:
        """Take bytes of the serial line."""
        with self._lock:
            self._buffer += data
            while found := _LINE.match(self._buffer):
                self._buffer = self._buffer[found.end() :]
                self._take(found[0].strip(), t_ns)
            self._buffer = b"" if len(self._buffer) > _LONGEST else self._buffer

    def state_at(self, t_ns: int) -> PpsState:
        """State of the pulse, as position packets report it (63-9243 Rev D, section 9.3.3)."""
        with self._lock:
            if self._edge_ns is None or t_ns - self._edge_ns > _LOST_NS:
                return PpsState.ABSENT
            if self._is_bad:
                return PpsState.ERROR
            steady = self._steady_since_ns is not None and t_ns - self._steady_since_ns >= self._window_ns
            is_set = self._set_ns is not None and t_ns - self._set_ns < _STALE_NS
            return PpsState.LOCKED if steady and is_set else PpsState.SYNCHRONIZING

    def clock_ns(self, t_ns: int) -> int:
        """Read the sensor's clock, in ns past its hour."""
        with self._lock:
            return (t_ns - self._zero_ns) % HOUR_NS

    @property
    def heard(self) -> Heard:
        """Result so far."""
        with self._lock:
            return Heard(self._pulses, self._sentences, self._refused)

    def _take(self, line: bytes, t_ns: int) -> None:
        """Take a line: an RMC sentence names the second of the edge before it."""
        if not line.startswith(b"$GPRMC,"):
            return
        try:
            named_ns, valid = rmc_time(line + b"\r\n")
        except PacketError:
            self._refused += 1
            self._is_bad = True
            return
        self._sentences += 1
        self.sentence = line + b"\r\n"
        if self._delay_ns is not None:
            self.pulse(t_ns - self._delay_ns)
        if named_ns is not None and (valid or not self._requires_valid):
            self._set_ns = t_ns
            if self._edge_ns is not None and t_ns - self._edge_ns < _LOST_NS:
                # Whole seconds alone: the fraction is that of the pulse.
                shown_ns = (self._edge_ns - self._zero_ns + S_NS // 2) // S_NS * S_NS
                self._zero_ns -= (named_ns - shown_ns) % HOUR_NS


def parse_rmc(sentence: bytes) -> GnssFix:
    """Read a sentence back, ASCII that ends with CR and LF.

    Raises
    ------
    PacketError : no `$GPRMC`, a wrong checksum, no CR LF, or a field that is missing or no number
    """
    fields = fields_of(sentence)
    try:
        return GnssFix(
            t_ns=utc_ns(fields[8], fields[0]),
            valid={"A": True, "V": False}[fields[1]],
            latitude_deg=_degrees(fields[2], 2, {"N": 1, "S": -1}[fields[3]]),
            longitude_deg=_degrees(fields[4], 3, {"E": 1, "W": -1}[fields[5]]),
            speed_m_s=_number(fields[6]) * KNOT_M_S,
            course_deg=_number(fields[7]),
        )
    except (ValueError, KeyError, IndexError) as error:
        raise PacketError("NMEA sentence", repr(sentence), "the fields of RMC, all filled") from error


def _degrees(field: str, width: int, sign: int) -> float:
    degrees, minutes = int(field[:width]), _number(field[width:])
    if minutes >= 60:
        raise ValueError(field)
    return sign * (degrees + minutes / 60)


def _number(field: str) -> float:
    """Read a plain number without sign; float alone would take nan and 1e9."""
    if not field.replace(".", "", 1).isdecimal():
        raise ValueError(field)
    return float(field)
