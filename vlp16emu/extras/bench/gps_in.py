"""A real GPS receiver on a serial port, and packets stamped by the clock that it sets."""

import errno
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from vlp16emu.errors import OutputError
from vlp16emu.extras.bench.gps_line import GpsLine, Heard
from vlp16emu.extras.bench.options import GpsIn
from vlp16emu.extras.bench.retime import age_ns, restamped
from vlp16emu.extras.bench.serial_port import Away, SerialPort
from vlp16emu.motion.settings import Gps
from vlp16emu.packets import STAMP_LEAD_NS
from vlp16emu.sinks import TOLERANCE_NS, PacketSink
from vlp16emu.types import Packet, PacketKind, PpsState
from vlp16emu.units import seconds_to_ns

_BAUD = 9600
"""63-9243 Rev D, section 7.4."""
_LOOK_S = 0.001
"""From one look at the line to the next."""
_AWAY_S = 0.1
"""From one look for a device that has vanished to the next; `SerialPort` tries once a second."""


@dataclass(frozen=True, slots=True)
class GpsInResult:
    """Input from a receiver, and the clock that it set."""

    port: str
    heard: Heard
    state: PpsState
    """At the end."""
    away: tuple[Away, ...]
    """Times at which the device was not there."""


class GpsReader:
    """Listens to a receiver in a thread of its own; a context manager.

    Parameters
    ----------
    gps_in : where it is
    gps : of the scene: the window of the pulse, which sentences set the clock, and when they come
    powered_for_s : time since power-up, from which the clock counts before it is set

    Raises
    ------
    OutputError
        If the port cannot be opened, or has no such line
    """

    def __init__(self, gps_in: GpsIn, gps: Gps, powered_for_s: float) -> None:
        self._pulse = None if gps_in.pulse == "sentence" else gps_in.pulse
        self._port = SerialPort(gps_in.port, _BAUD, "--gps-in")
        if self._pulse and self._port.use(self._has_line) is False:
            self._port.close()
            raise OutputError(f"--gps-in {gps_in.port}", f"no line {self._pulse.upper()}", "--gps-in-pulse sentence")
        self.line = GpsLine(
            time.monotonic_ns() - seconds_to_ns(powered_for_s),
            window_ns=seconds_to_ns(gps.pps_window_s),
            requires_valid=gps.requires_valid,
            sentence_delay_ns=None if self._pulse else seconds_to_ns(gps.sentence_delay_s),
        )
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"gps in {gps_in.port}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def sink(self, way: PacketSink) -> PacketSink:
        """Return a sink that stamps packets by the clock of the receiver."""
        return GpsInSink(way, self.line)

    @property
    def result(self) -> GpsInResult:
        """Result so far."""
        state = self.line.state_at(time.monotonic_ns())
        return GpsInResult(self._port.name, self.line.heard, state, self._port.away)

    def _has_line(self, port: Any) -> bool:  # a class of pyserial, which has no types
        try:
            getattr(port, str(self._pulse))
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                return False
            raise
        return True

    def _run(self) -> None:
        """Body of the thread."""
        was_high = True
        while not self._over.is_set():
            if (found := self._port.use(self._look)) is None:
                self._over.wait(_AWAY_S)
                continue
            data, high, at_ns = found
            if high and not was_high:
                self.line.pulse(at_ns)
            was_high = high
            if data:
                self.line.receive(data, at_ns)
            if data or self._pulse:  # characters that come one by one are taken together, whatever sends them
                self._over.wait(_LOOK_S)
        self._port.close()

    def _look(self, port: Any) -> tuple[bytes, bool, int]:  # as above
        """Read what is there, or wait for a character where no line is to be looked at; and the line, and when it was."""
        if self._pulse:
            high, at_ns = bool(getattr(port, self._pulse)), time.monotonic_ns()
            return (port.read(port.in_waiting) if port.in_waiting else b""), high, at_ns
        data = port.read(1)
        return (data + (port.read(port.in_waiting) if data and port.in_waiting else b""), False, time.monotonic_ns())


class GpsInSink(PacketSink):
    """Passes packets on with the stamps, state and sentence that the sensor would have with that receiver on its line.

    Instants of packets are as far apart as they are due, however late each is sent: stamps show no jitter of the host. Only where
    the stream is late by more than the tolerance they are counted from then on, by `clock_ns`, the clock of the line's instants.
    """

    def __init__(self, sink: PacketSink, line: GpsLine, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._sink, self._line, self._clock_ns = sink, line, clock_ns
        self._ahead_ns: int | None = None

    def send(self, packet: Packet) -> None:
        """Send one packet; errors as of the sink."""
        if packet.kind not in (PacketKind.DATA, PacketKind.POSITION):
            self._sink.send(packet)
            return
        now_ns = self._clock_ns()
        if self._ahead_ns is None or abs(now_ns - packet.due_ns - self._ahead_ns) > TOLERANCE_NS:
            self._ahead_ns = now_ns - packet.due_ns
        sent_ns = packet.due_ns + self._ahead_ns
        if packet.kind is PacketKind.POSITION:
            made_ns = sent_ns - STAMP_LEAD_NS
        else:
            made_ns = sent_ns - (age_ns(packet) if packet.fired_ns is None else packet.due_ns - packet.fired_ns)
        line = self._line
        stamped = restamped(packet, line.clock_ns(made_ns), line.state_at(made_ns), line.sentence)
        self._sink.send(stamped)
