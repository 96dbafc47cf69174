"""A real GPS receiver on a serial port, whose pulses and sentences set the clock and the state in packets."""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from vlp16emu.engine.gps_input import STALE_NS, pps_state
from vlp16emu.errors import OutputError, PacketError
from vlp16emu.extras.bench.outlets import PATIENCE_S, Away, SerialPort, has_line
from vlp16emu.extras.bench.retime import age_ns, restamp
from vlp16emu.motion.settings import Gps
from vlp16emu.packets import STAMP_LEAD_NS
from vlp16emu.packets.nmea import rmc_time
from vlp16emu.run.part import StreamPart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.sinks import TOLERANCE_NS
from vlp16emu.types import Packet, PacketKind, PpsState
from vlp16emu.units import HOUR_NS, MS_NS, S_NS, seconds_to_ns

_LINE = re.compile(rb"[^\r\n]*[\r\n]+")
_LONGEST = 256  # bytes without an end of line that are no sentence: twice the space of a position packet
_STEADY_NS = 5 * MS_NS
"""Greatest error of a steady pulse against its second: so far off is a pulse that is exact to a microsecond,
for a program that polls a line every millisecond beside other programs (assumption)."""
_LOST_NS = S_NS + S_NS // 2  # time without a pulse after which pulses count as lost
_CORRECTION_DIVISOR = 8
"""A pulse corrects the clock's error divided by this, so that stamps do not show the jitter of polling."""


@dataclass(frozen=True, slots=True)
class LineInput:
    """Number of pulses and sentences of a receiver so far."""

    pulses: int = 0
    sentences: int = 0  # valid sentences
    refused: int = 0  # garbled RMC sentences; other sentences are ignored


class GpsLine:
    """The sensor's end of the line from a receiver; safe to use from several threads.

    Instants are readings of one clock of the host, in ns.

    Parameters
    ----------
    gps : table of the scene: time for which pulses must be steady, and if only sentences of status A set the
        clock
    power_up_ns : instant at which the sensor's own clock was zero
    is_pulsed : False without a line for pulses: then a second begins `gps.sentence_delay_s` before its
        sentence
    """

    def __init__(self, gps: Gps, power_up_ns: int, *, is_pulsed: bool) -> None:
        self._gps = gps
        self._is_pulsed = is_pulsed
        self._lock = threading.RLock()  # `receive` takes pulses
        self._buffer = b""
        self.heard = LineInput()
        """Number of pulses and sentences so far."""
        self._zero_ns = power_up_ns  # instant at which the clock showed a whole hour
        self._edge_ns: int | None = None
        self._steady_since_ns: int | None = None
        self._is_bad = False
        self._set_ns: int | None = None
        self.sentence = b""
        """Last sentence, with CR and LF; empty before the first."""

    def pulse(self, t_ns: int) -> None:
        """Take the rising edge of a pulse.

        It sets the fraction of a second to the edge: at once at first, in small steps when pulses are steady.
        """
        with self._lock:
            self.heard = replace(self.heard, pulses=self.heard.pulses + 1)
            since_ns = _LOST_NS + 1 if self._edge_ns is None else t_ns - self._edge_ns
            off_ns = (t_ns - self._zero_ns + S_NS // 2) % S_NS - S_NS // 2
            is_first = since_ns > _LOST_NS
            self._is_bad = not is_first and abs(since_ns - S_NS) > _STEADY_NS  # not a second apart
            if is_first or self._is_bad:
                self._steady_since_ns = t_ns
            self._zero_ns += off_ns if is_first or self._is_bad else off_ns // _CORRECTION_DIVISOR
            self._edge_ns = t_ns

    def receive(self, data: bytes, t_ns: int) -> None:
        """Take bytes of the serial line."""
        with self._lock:
            self._buffer += data
            while match := _LINE.match(self._buffer):
                self._buffer = self._buffer[match.end() :]
                self._take_line(match[0].strip(), t_ns)
            self._buffer = b"" if len(self._buffer) > _LONGEST else self._buffer

    def state_at(self, t_ns: int) -> PpsState:
        """Return the state of the pulse in position packets (63-9243 Rev D, section 9.3.3)."""
        with self._lock:
            window_ns = seconds_to_ns(self._gps.pps_window_s)
            return pps_state(
                is_pulsed=self._edge_ns is not None and t_ns - self._edge_ns <= _LOST_NS,
                is_wrong=self._is_bad,
                is_steady=self._steady_since_ns is not None and t_ns - self._steady_since_ns >= window_ns,
                is_set=self._set_ns is not None and t_ns - self._set_ns < STALE_NS,
            )

    def clock_ns(self, t_ns: int) -> int:
        """Return the sensor's clock, in ns past its hour."""
        with self._lock:
            return (t_ns - self._zero_ns) % HOUR_NS

    def _take_line(self, line: bytes, t_ns: int) -> None:
        """Take a line: an RMC sentence names the second of the edge before it."""
        if not line.startswith(b"$GPRMC,"):
            return
        try:
            sentence_ns, is_valid = rmc_time(line + b"\r\n")
        except PacketError:
            self.heard = replace(self.heard, refused=self.heard.refused + 1)
            self._is_bad = True
            return
        self.heard = replace(self.heard, sentences=self.heard.sentences + 1)
        self.sentence = line + b"\r\n"
        if not self._is_pulsed:
            self.pulse(t_ns - seconds_to_ns(self._gps.sentence_delay_s))
        if sentence_ns is not None and (is_valid or not self._gps.requires_valid):
            self._set_ns = t_ns
            if self._edge_ns is not None and t_ns - self._edge_ns < _LOST_NS:
                # Only whole seconds: the pulse gives the fraction.
                shown_ns = (self._edge_ns - self._zero_ns + S_NS // 2) // S_NS * S_NS
                self._zero_ns -= (sentence_ns - shown_ns) % HOUR_NS


_BAUD = 9600  # 63-9243 Rev D, section 7.4
_POLL_S = 0.001  # period of polling of the line
_AWAY_S = 0.1  # period of polling for a vanished device; `SerialPort` tries once a second


@dataclass(frozen=True, slots=True)
class GpsInResult:
    """Input from a receiver, and the clock that it set."""

    port: str
    heard: LineInput
    state: PpsState  # at the end
    away: tuple[Away, ...]  # times without the device


class GpsReader(StreamPart):
    """Reader of a receiver in a thread of its own, which sets stamps, state and sentence of packets.

    Instants of packets follow their due times, even if they are sent late: stamps show no jitter of the host.
    Only if the stream is late by more than `TOLERANCE_NS`, instants are counted again from the host's clock.

    Parameters
    ----------
    stream : stream of a scene, with options that name the port and the line; the scene gives the window of
        the pulse, the sentences that set the clock, their delay, and the time since power-up, which the
        clock shows before it is set

    Raises OutputError if the port cannot be opened, or has no such line.
    """

    def __init__(self, stream: SceneStream) -> None:
        gps_in = stream.options.gps_in
        assert gps_in is not None
        self._emulator = stream.emulator
        self._pulse = None if gps_in.pulse == "sentence" else gps_in.pulse
        self._port = SerialPort(gps_in.port, _BAUD, "--gps-in")
        if self._pulse and self._port.use(self._has_pulse_line) is False:
            self._port.close()
            raise OutputError(
                f"--gps-in {gps_in.port}", f"no line {self._pulse.upper()}", "--gps-in-pulse sentence"
            )
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"gps in {gps_in.port}", daemon=True)
        self._stamps: LineStamps

    def begin(self) -> None:
        """Power up the sensor, and listen to the line."""
        scenario = self._emulator.scenario
        powered_for_s = self._emulator.parts.units[0].section.powered_for_s or 0.0
        power_up_ns = time.monotonic_ns() - seconds_to_ns(powered_for_s)
        self.line = GpsLine(scenario.gps, power_up_ns, is_pulsed=self._pulse is not None)
        self._stamps = LineStamps(self.line)
        self._thread.start()

    def leaving(self, packet: Packet) -> Packet:
        """Return a packet with the clock that the receiver sets."""
        return self._stamps.stamp(packet)

    def end(self, _error: BaseException | None) -> None:
        """Stop listening, and close the port."""
        self._over.set()
        if self._thread.ident is None:  # it closes the port
            self._port.close()
        else:
            self._thread.join(PATIENCE_S)  # a daemon: a thread that waits for a host elsewhere is abandoned

    @property
    def result(self) -> GpsInResult:
        """Result so far."""
        state = self.line.state_at(time.monotonic_ns())
        return GpsInResult(self._port.name, self.line.heard, state, self._port.away)

    def _has_pulse_line(self, port: Any) -> bool:
        return has_line(partial(getattr, port, str(self._pulse)))

    def _run(self) -> None:
        was_high = True
        while not self._over.is_set():
            if (reading := self._port.use(self._poll)) is None:
                self._over.wait(_AWAY_S)
                continue
            data, is_high, at_ns = reading
            if is_high and not was_high:
                self.line.pulse(at_ns)
            was_high = is_high
            if data:
                self.line.receive(data, at_ns)
            if data or self._pulse:  # collect single characters
                self._over.wait(_POLL_S)
        self._port.close()

    def _poll(self, port: Any) -> tuple[bytes, bool, int]:
        """Return the bytes that have come, the state of the line, and the instant.

        Without a line of pulses, wait for a character.
        """
        if self._pulse:
            is_high = bool(getattr(port, self._pulse))
            at_ns = time.monotonic_ns()
            data = port.read(port.in_waiting) if port.in_waiting else b""
            return data, is_high, at_ns
        data = port.read(1)
        if data and port.in_waiting:
            data += port.read(port.in_waiting)
        return data, False, time.monotonic_ns()


class LineStamps:
    """Stamps of packets by the clock of a line.

    Parameters
    ----------
    line : the sensor's end of the line
    clock_ns : clock of its instants
    """

    def __init__(self, line: GpsLine, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._line = line
        self._clock_ns = clock_ns
        self._ahead_ns: int | None = None

    def stamp(self, packet: Packet) -> Packet:
        """Return a data or position packet with its stamp by the line; other packets as they are."""
        if packet.kind not in (PacketKind.DATA, PacketKind.POSITION):
            return packet
        now_ns = self._clock_ns()
        if self._ahead_ns is None or abs(now_ns - packet.due_ns - self._ahead_ns) > TOLERANCE_NS:
            self._ahead_ns = now_ns - packet.due_ns
        sent_ns = packet.due_ns + self._ahead_ns
        if packet.kind is PacketKind.POSITION:
            made_ns = sent_ns - STAMP_LEAD_NS
        elif packet.fired_ns is None:
            made_ns = sent_ns - age_ns(packet)
        else:
            made_ns = sent_ns - (packet.due_ns - packet.fired_ns)
        line = self._line
        return restamp(packet, line.clock_ns(made_ns), line.state_at(made_ns), line.sentence)
