"""Serial ports: one that is kept open whatever becomes of its device, and a thread that writes to it in time."""

import errno
import os
import queue
import select
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from io import UnsupportedOperation
from typing import Any, Protocol, TypeVar

from vlp16emu.errors import OutputError
from vlp16emu.sinks import PacketSink
from vlp16emu.types import Packet, PacketKind

T = TypeVar("T")

_RETRY_S = 1.0
"""How often a device that is away is looked for."""
_PATIENCE_S = 0.25
"""How long a message may wait for the line, and for how long one is written at most: a quarter of a receiver's second."""
_WAITING = 4096
"""Messages that wait at most: more than an inertial unit takes in that time."""
_LINELESS = ("socket://",)
"""Ports that take the setting of a line without an error, and have none."""


@dataclass(frozen=True, slots=True)
class Away:
    """One time that a device was not there."""

    at_s: float
    """Time since the port was opened."""
    away_s: float
    """Until it was there again, or the stream ended."""


@dataclass(frozen=True, slots=True)
class OutletResult:
    """Messages that left by an outlet."""

    to: str
    messages: int
    """Sentences, or samples."""
    bytes: int
    dropped: int
    """Messages that were too late: the device was away, or took no more."""
    away: tuple[Away, ...] = ()
    line: str | None = None
    """Line of the pulses, rts or dtr."""
    pulses: int | None = None
    """Pulses on that line; None if the port has no such line."""


class Outlet(PacketSink, Protocol):
    """A sink that reports what it sent."""

    @property
    def result(self) -> OutletResult:
        """Messages that left so far."""


class SerialPort:
    """A port at 8N1 without flow control that is opened again, once a second, when its device has vanished.

    Of one thread. Reading and writing is done by `use`.

    Parameters
    ----------
    name : of a device, or a URL of pyserial: socket://HOST:PORT, rfc2217://HOST:PORT, loop://
    baud : bits per second
    where : option or key that names the port
    line : rts or dtr, low from the start; None leaves both as they are

    Raises
    ------
    OutputError : where it cannot be opened at first
    """

    def __init__(self, name: str, baud: int, where: str, line: str | None = None) -> None:
        import serial  # here: few runs need it

        self.name, self._baud, self.line = name, baud, line
        self._error, self._slow = _errors(), serial.SerialTimeoutException
        self._away_since_s: float | None = None
        self._opened_s = self._tried_s = time.monotonic()
        self._away = list[Away]()
        try:
            self._port: Any = self._open()
        except self._error as error:
            code = getattr(error, "errno", None)
            found = os.strerror(code) if code else str(error)
            expected = "a serial port of this machine, or a URL such as socket://HOST:PORT"
            raise OutputError(f"{where} {name}", found, expected) from None
        except ValueError as error:
            raise OutputError(f"{where} {name}", str(error), "a device, or a URL of pyserial") from None
        self.has_line = line is not None and self._has(line)
        """Whether the port has it; a pseudo-terminal has none."""

    def use(self, act: Callable[[Any], T]) -> T | None:
        """Let `act` read or write: the port is pyserial's. None where the device is away, or takes no more."""
        if self._away_since_s is not None and not self._is_back():
            return None
        try:
            return act(self._port)
        except self._slow:
            return None
        except self._error:
            self._away_since_s = self._tried_s = time.monotonic()
            self._shut()
            return None

    def close(self) -> None:
        """Close the port, if it is open."""
        if self._away_since_s is not None:
            self._note_away()
        self._shut()

    @property
    def away(self) -> tuple[Away, ...]:
        """Times at which the device was not there, that of now left out."""
        return tuple(self._away)

    def _open(self) -> Any:  # a class of pyserial, which has no types
        import serial

        port = serial.serial_for_url(
            self.name, self._baud, timeout=_PATIENCE_S, write_timeout=_PATIENCE_S, do_not_open=True
        )
        if self.line:
            setattr(port, self.line, False)
        port.open()
        return port

    def _has(self, line: str) -> bool:
        if self.name.startswith(_LINELESS):
            return False
        try:
            setattr(self._port, line, False)
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                return False
            raise
        return True

    def _is_back(self) -> bool:
        if time.monotonic() < self._tried_s + _RETRY_S:
            return False
        self._tried_s = time.monotonic()
        with suppress(*self._error, ValueError):
            self._port = self._open()
            self._note_away()
            return True
        return False

    def _note_away(self) -> None:
        assert self._away_since_s is not None
        now_s = time.monotonic()
        self._away.append(Away(self._away_since_s - self._opened_s, now_s - self._away_since_s))
        self._away_since_s = None

    def _shut(self) -> None:
        with suppress(*self._error):
            self._port.close()


def _errors() -> tuple[type[Exception], ...]:
    """Errors that a port raises whose device is gone."""
    import serial

    try:
        import termios
    except ImportError:  # Windows has none
        return serial.SerialException, OSError
    return serial.SerialException, OSError, termios.error


class SerialSink(Outlet):
    """Writes packets to a serial port, and pulses to its line; a thread of its own does it, so that a port never holds up others.

    Parameters
    ----------
    port : of the thread from now on
    """

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        self._waiting = queue.Queue[tuple[float, Packet] | None](_WAITING)
        self._messages = self._bytes = self._dropped = self._pulses = 0
        self._thread = threading.Thread(target=self._run, name=f"serial {port.name}", daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        with suppress(queue.Full):
            self._waiting.put_nowait(None)
        self._thread.join(2 * _PATIENCE_S)  # a daemon: one that hangs in a driver is left behind

    def send(self, packet: Packet) -> None:
        """Let one packet leave as soon as the line is free; returns at once."""
        try:
            self._waiting.put_nowait((time.monotonic(), packet))
        except queue.Full:
            self._dropped += packet.kind is not PacketKind.PPS

    @property
    def result(self) -> OutletResult:
        """Result so far."""
        port, counts = self._port, (self._messages, self._bytes, self._dropped)
        pulses = self._pulses if port.has_line else None
        return OutletResult(port.name, *counts, port.away, port.line, pulses)

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            since_s, packet = item
            if packet.kind is PacketKind.PPS:
                self._set_line(high=any(packet.payload))
            elif time.monotonic() - since_s > _PATIENCE_S or not self._write(packet.payload):
                self._dropped += 1
        self._set_line(high=False)
        self._port.close()

    def _write(self, payload: bytes) -> bool:
        def put(port: Any) -> int | None:
            """Wait for room first: pyserial would ask for it again and again, and take a core for that."""
            with suppress(UnsupportedOperation):  # a port without descriptor, such as loop://
                if not select.select([], [port.fileno()], [], _PATIENCE_S)[1]:
                    return None
            written: int = port.write(payload)
            return written

        if (written := self._port.use(put)) is None:
            return False
        self._messages, self._bytes = self._messages + 1, self._bytes + written
        return True

    def _set_line(self, *, high: bool) -> None:
        line = self._port.line
        if line and self._port.has_line:

            def set_line(port: Any) -> bool:
                setattr(port, line, high)
                return True

            self._pulses += bool(self._port.use(set_line)) and high
