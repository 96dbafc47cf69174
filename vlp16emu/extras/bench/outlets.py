"""Outputs beside the packets of the sensors: sentences and pulses of a receiver, and inertial samples.

They leave by serial ports or UDP.
"""

import errno
import heapq
import os
import queue
import select
import socket
import stat
import termios
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from io import UnsupportedOperation
from operator import itemgetter
from typing import Any, TypeVar

from vlp16emu.engine import Engine
from vlp16emu.errors import OutputError, RunError, ScenarioError
from vlp16emu.extras.bench.imu_frame import IMU_FRAME, imu_frames
from vlp16emu.extras.imu.sampler import ImuSampler
from vlp16emu.output import unless_ending
from vlp16emu.packets import rmc
from vlp16emu.run.options import host_and_port
from vlp16emu.run.part import OutletPart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.sinks import PacketSink
from vlp16emu.sinks.udp import resolve
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import MS_NS, S_NS

PULSE_NS = 100 * MS_NS  # length of a pulse: the sensor needs 20 to 200 ms (User's Manual of the HDL-32E)
PULSE_HIGH, PULSE_LOW = b"\1", b"\0"
_READS_PER_S = 50
"""Span of samples that are read together: not longer, because live poses are unknown far ahead."""

_Beat = tuple[
    int, Packet | Callable[[], Packet]
]  # due time of a packet, and the packet or a function that returns it


class Beside:
    """Packets of the kinds NMEA, PPS and IMU, computed in the order of a run and not before their time.

    Raises `ScenarioError` if the scene has no such device.
    """

    def __init__(self, engine: Engine, kinds: Collection[PacketKind]) -> None:
        scenario = engine.scenario
        parts = engine.parts
        if not scenario.gps.connected and not {PacketKind.NMEA, PacketKind.PPS}.isdisjoint(kinds):
            raise ScenarioError("gps.connected", "found false", "true, for a receiver to be played")
        if scenario.imu is None and PacketKind.IMU in kinds:
            raise ScenarioError("imu", "no such table in the scene", "[imu], such as imu.preset=consumer")
        self._start_ns = scenario.start_ns
        self._delay_ns = parts.gps.sentence_delay_ns
        self._receiver = engine.receiver
        self._imu = parts.imu
        self._kinds = kinds
        self._rate_hz = scenario.imu.rate_hz if scenario.imu else 0

    def among(self, packets: Iterator[Packet], start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Merge the packets of a span since the first pulse with the additional ones.

        At equal due times `packets` come first.
        """
        if not self._kinds:
            return packets
        made = {PacketKind.NMEA: self._sentences, PacketKind.PPS: self._pulses, PacketKind.IMU: self._samples}
        streams = [made[kind](self._numbers(kind, start_ns, stop_ns)) for kind in self._kinds]
        others = ((packet.due_ns, packet) for packet in packets)
        beats = heapq.merge(others, *streams, key=itemgetter(0))
        return (what if isinstance(what, Packet) else what() for _, what in beats)

    def count(self, start_ns: int, stop_ns: int) -> dict[PacketKind, int]:
        """Return the number of additional packets in a span since the first pulse, by kind."""
        return {kind: len(self._numbers(kind, start_ns, stop_ns)) for kind in self._kinds}

    def _numbers(self, kind: PacketKind, start_ns: int, stop_ns: int) -> range:
        """Return the numbers of packets in a span.

        They are UTC seconds, edges of pulses since 1970 (two a second), or samples.
        """
        if kind is PacketKind.IMU:
            return range(*(-(-since_ns * self._rate_hz // S_NS) for since_ns in (start_ns, stop_ns)))
        span_ns = [self._start_ns + since_ns for since_ns in (start_ns, stop_ns)]
        if kind is PacketKind.NMEA:
            return range(*(-(-(utc_ns - self._delay_ns) // S_NS) for utc_ns in span_ns))
        return range(*(-(-utc_ns // S_NS) + -(-(utc_ns - PULSE_NS) // S_NS) for utc_ns in span_ns))

    def _sentences(self, seconds: range) -> Iterator[_Beat]:
        for second in seconds:  # with the same delay after its second as on the sensor's line
            yield second * S_NS + self._delay_ns, partial(self._sentence, second * S_NS)

    def _sentence(self, second_ns: int) -> Packet:
        assert self._receiver is not None  # or no sentence is among the kinds
        return Packet(PacketKind.NMEA, second_ns + self._delay_ns, rmc(self._receiver.fix(second_ns)))

    def _pulses(self, numbers: range) -> Iterator[_Beat]:
        for number in numbers:
            second, is_end = divmod(number, 2)
            due_ns = second * S_NS + is_end * PULSE_NS
            level = (PULSE_HIGH, PULSE_LOW)[is_end]
            yield due_ns, Packet(PacketKind.PPS, due_ns, level)

    def _samples(self, numbers: range) -> Iterator[_Beat]:
        imu = self._imu
        ready = dict[int, Packet]()
        assert isinstance(imu, ImuSampler)

        def sample(number: int) -> Packet:
            """Return a sample; samples of 20 ms are read together."""
            if number not in ready:
                ready.clear()
                count = min(max(self._rate_hz // _READS_PER_S, 1), numbers.stop - number)
                read = imu.read(number, count)
                stamps_ns = read.t_ns if read.stamp_ns is None else read.stamp_ns
                frames = imu_frames(number, stamps_ns, read.angular_rate_rad_s, read.specific_force_m_s2)
                for at, (due_ns, frame) in enumerate(zip(stamps_ns.tolist(), frames, strict=True), number):
                    ready[at] = Packet(PacketKind.IMU, due_ns, frame)
            return ready[number]

        for number in numbers:
            due_ns = self._start_ns + number * S_NS // self._rate_hz + int(imu.late_ns(number, 1)[0])
            yield due_ns, partial(sample, number)


T = TypeVar("T")

_RETRY_S = 1.0  # period of attempts to open a device that has vanished
_PATIENCE_S = 0.25
"""Greatest time that a message waits for the line, and that writing takes: a quarter of a receiver's
second."""
_WAITING = 4096  # greatest number of waiting messages: more than samples of an inertial unit in that time
_SCHEMES = ("socket", "rfc2217")
"""Schemes of URLs that lead to a port elsewhere; others of pyserial are for its own tests, or open files."""
_LINELESS = ("socket://",)  # ports that accept the setting of a line without an error, but have no line


@dataclass(frozen=True, slots=True)
class Away:
    """A time without the device."""

    at_s: float  # time since the port was opened
    away_s: float  # until the device was back, or the stream ended


@dataclass(frozen=True, slots=True)
class OutletResult:
    """Messages sent by an outlet."""

    to: str
    messages: int  # sentences, or samples
    bytes: int
    dropped: int  # messages that were too late: the device was away or busy
    away: tuple[Away, ...] = ()
    line: str | None = None  # line of the pulses, rts or dtr
    pulses: int | None = None  # pulses on that line; None if the port has no such line


def has_line(act: Callable[[], object]) -> bool:
    """Return True if a port has the line that `act` sets or reads; a pseudo-terminal has none."""
    try:
        act()
    except OSError as error:
        if error.errno in (errno.ENOTTY, errno.EINVAL):
            return False
        raise
    return True


_PORT = "a serial port of this machine, socket://HOST:PORT or rfc2217://HOST:PORT"


def _check_port(name: str, where: str) -> None:
    """Raise OutputError for a name that is no character device, and no URL of a port elsewhere.

    A FIFO without a reader would wait without end, and `spy://?file=PATH` of pyserial empties PATH.
    """
    scheme, mark, rest = name.partition("://")
    if mark:
        if scheme not in _SCHEMES or not rest:
            raise OutputError(where, f"found '{name}'", _PORT)
        return
    try:
        kind = os.stat(name).st_mode  # noqa: PTH116  # the name as pyserial opens it
    except (OSError, ValueError) as error:
        found = error.strerror if isinstance(error, OSError) else "no name of a device"
        raise OutputError(f"{where} {name}".rstrip(), str(found), _PORT) from None
    if not stat.S_ISCHR(kind):
        raise OutputError(f"{where} {name}", "is no character device", _PORT)


class SerialPort:
    """A port at 8N1 without flow control that is opened again, once a second, after its device has vanished.

    For one thread. `use` reads and writes.

    Parameters
    ----------
    name : name of a device, or a URL: socket://HOST:PORT or rfc2217://HOST:PORT
    baud : bits per second
    where : option or key that names the port
    line : rts or dtr, low from the start; None leaves both as they are

    Raises OutputError if it cannot be opened at first.
    """

    def __init__(self, name: str, baud: int, where: str, line: str | None = None) -> None:
        import serial  # here: few runs need it

        _check_port(name, where)
        self.name = name
        self._baud = baud
        self.line = line
        self._error = (serial.SerialException, OSError, termios.error)
        self._slow = serial.SerialTimeoutException
        self._away_since_s: float | None = None
        self._opened_s = self._tried_s = time.monotonic()
        self.away: tuple[Away, ...] = ()  # past times without the device
        try:
            self._port: Any = unless_ending(self._open)
        except self._error as error:
            code = getattr(error, "errno", None)
            found = os.strerror(code) if code else str(error)
            raise OutputError(f"{where} {name}", found, _PORT) from None
        except ValueError as error:
            raise OutputError(f"{where} {name}", str(error), _PORT) from None
        is_there = line is not None and not name.startswith(_LINELESS)
        self.has_line = is_there and has_line(lambda: setattr(self._port, str(line), False))

    def use(self, act: Callable[[Any], T]) -> T | None:
        """Call `act` with the port of pyserial, to read or write. None if the device is away or busy."""
        if self._away_since_s is not None and not self._is_back():
            return None
        try:
            return act(self._port)
        except self._slow:
            return None
        except self._error:
            self._away_since_s = self._tried_s = time.monotonic()
            self.close(for_good=False)
            return None

    def close(self, *, for_good: bool = True) -> None:
        """Close the port, if it is open."""
        if for_good:
            self._note_away()
        with suppress(*self._error):
            self._port.close()

    def _open(self) -> Any:  # a class of pyserial, which has no types
        import serial

        patience = {"timeout": _PATIENCE_S, "write_timeout": _PATIENCE_S}
        port = serial.serial_for_url(self.name, self._baud, **patience, do_not_open=True)
        if self.line:
            setattr(port, self.line, False)
        port.open()
        return port

    def _is_back(self) -> bool:
        if time.monotonic() < self._tried_s + _RETRY_S:
            return False
        self._tried_s = time.monotonic()
        with suppress(*self._error, ValueError):
            self._port = self._open()
            self._note_away()
        return self._away_since_s is None

    def _note_away(self) -> None:
        if (since_s := self._away_since_s) is not None:
            self.away += (Away(since_s - self._opened_s, time.monotonic() - since_s),)
            self._away_since_s = None


class SerialSink(PacketSink):
    """Sink that writes packets to a serial port, and pulses to its line.

    It has a thread of its own, so that a port never delays others.
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
        self._thread.join(2 * _PATIENCE_S)  # a daemon: a thread that hangs in a driver is abandoned

    def send(self, packet: Packet) -> None:
        """Queue one packet for the line; returns at once."""
        try:
            self._waiting.put_nowait((time.monotonic(), packet))
        except queue.Full:
            self._dropped += packet.kind is not PacketKind.PPS

    @property
    def result(self) -> OutletResult:
        """Result so far."""
        port = self._port
        counts = (self._messages, self._bytes, self._dropped)
        return OutletResult(port.name, *counts, port.away, port.line, self._pulses if port.has_line else None)

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
            """Wait for room first: pyserial would poll for it and use a whole core."""
            with suppress(UnsupportedOperation):  # a port without descriptor, such as loop://
                if not select.select([], [port.fileno()], [], _PATIENCE_S)[1]:
                    return None
            written: int = port.write(payload)
            return written

        if (written := self._port.use(put)) is None:
            return False
        self._messages = self._messages + 1
        self._bytes = self._bytes + written
        return True

    def _set_line(self, *, high: bool) -> None:
        def act(port: Any) -> bool:
            setattr(port, str(self._port.line), high)
            return True

        if self._port.has_line:
            self._pulses += bool(self._port.use(act)) and high


_GPS_BAUD = 9600  # rate of the sensor's input (63-9243 Rev D, section 7.4)
_BAUD = 921_600
_BITS = 10  # of a byte on the line: start, eight, stop
_WHERE = "--imu-out"


class OutletSinks(OutletPart):
    """Sinks of sentences, pulses and inertial samples beside the packets of the sensors.

    Parameters
    ----------
    stream : stream of a scene, with options that ask for outlets

    Raises the errors of `Emulator.stream`.
    """

    def __init__(self, stream: SceneStream) -> None:
        asked = stream.options.outlets
        assert asked is not None
        self._stream = stream
        self.kinds: list[PacketKind] = []  # kinds of packets to make
        if asked.gps_out:
            self.kinds += [PacketKind.NMEA] if asked.gps_pps == "off" else [PacketKind.NMEA, PacketKind.PPS]
        if asked.imu_out:
            self.kinds.append(PacketKind.IMU)
        Beside(stream.emulator.engine, self.kinds)  # refuses a scene that lacks a device
        self.sinks: dict[PacketKind, SerialSink | ImuUdpSink] = {}
        self.look_ahead = 0
        """Packets that a stream computes further ahead, because of samples between sensor packets."""
        with ExitStack() as stack:
            if asked.gps_out:
                line = None if asked.gps_pps == "off" else asked.gps_pps
                port = SerialSink(SerialPort(asked.gps_out, _GPS_BAUD, "--gps-out", line))
                stack.push(port)
                self.sinks[PacketKind.NMEA] = self.sinks[PacketKind.PPS] = port
            if asked.imu_out:
                imu = stream.emulator.scenario.imu
                assert imu is not None
                self.look_ahead = 2 * imu.rate_hz
                samples = _imu_sink(asked.imu_out, imu.rate_hz)
                stack.push(samples)
                self.sinks[PacketKind.IMU] = samples
            self._open = stack.pop_all()

    def end(self, _error: BaseException | None) -> None:
        """Close the sinks, after what waits for them is sent."""
        self._open.close()

    @property
    def result(self) -> dict[PacketKind, OutletResult]:
        """Results by kind; packets that the stream skipped count as dropped."""
        skipped = self._stream.report.skipped
        sent = {kind: sink.result for kind, sink in self.sinks.items()}
        return {kind: replace(one, dropped=one.dropped + skipped[kind]) for kind, one in sent.items()}


def _imu_sink(to: str, rate_hz: int) -> "SerialSink | ImuUdpSink":
    """Open the sink of samples.

    Raises InputError if `to` names none, OutputError if a serial line is too slow for the rate.
    """
    if to.startswith("serial:"):
        most_hz = _BAUD // (_BITS * IMU_FRAME.itemsize)
        if rate_hz > most_hz:
            found = f"found imu.rate_hz = {rate_hz}"
            raise OutputError(
                f"{_WHERE} {to}", found, f"at most {most_hz} on a line of {_BAUD} baud, or udp://"
            )
        return SerialSink(SerialPort(to.removeprefix("serial:"), _BAUD, _WHERE))
    return ImuUdpSink(*host_and_port(to, _WHERE, "udp://HOST:PORT, or serial:PORT", "udp://"))


class ImuUdpSink(PacketSink):
    """Sink that sends samples by UDP, one per datagram: in groups they would be late."""

    def __init__(self, host: str, port: int) -> None:
        self._to = (resolve(host), port)
        self._samples = self._bytes = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, packet: Packet) -> None:
        """Send one sample; `RunError` if the system cannot send it."""
        try:
            self._bytes += self._socket.sendto(packet.payload, self._to)
        except OSError as error:
            where = "{}:{}".format(*self._to)
            raise RunError(f"{where}: {error.strerror} at sample {self._samples + 1}") from error
        self._samples += 1

    @property
    def result(self) -> OutletResult:
        """Result so far."""
        host, port = self._to
        return OutletResult(f"udp://{host}:{port}", self._samples, self._bytes, 0)
