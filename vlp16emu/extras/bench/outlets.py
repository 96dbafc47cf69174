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
from vlp16emu.hosts import host_and_port, resolve
from vlp16emu.output import unless_ending
from vlp16emu.packets import rmc
from vlp16emu.run.part import OutletPart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.sinks import PacketSink
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import MS_NS, S_NS

PULSE_NS = 100 * MS_NS  # length of a pulse: the sensor needs 20 to 200 ms (User's Manual of the HDL-32E)
PULSE_HIGH, PULSE_LOW = b"\1", b"\0"
_READS_PER_S = 50
"""Number of times a second that samples are read together: not fewer, because live poses are unknown far
ahead."""

_DuePacket = tuple[int, Packet | Callable[[], Packet]]
"""Due time of a packet, and the packet or a function that returns it."""


class DevicePackets:
    """Packets of the GPS receiver and the inertial unit of a scene, beside those of its sensors.

    They are computed in the order of a run, and not before their time.

    Parameters
    ----------
    kinds : NMEA, PPS or IMU

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

    def merge_with(self, packets: Iterator[Packet], start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Merge the packets of a span since the first pulse with those of the devices.

        At equal due times `packets` come first.
        """
        if not self._kinds:
            return packets
        makers = {
            PacketKind.NMEA: self._sentences,
            PacketKind.PPS: self._pulses,
            PacketKind.IMU: self._samples,
        }
        streams = [makers[kind](self._numbers(kind, start_ns, stop_ns)) for kind in self._kinds]
        sensor_packets = ((packet.due_ns, packet) for packet in packets)
        packets_due = heapq.merge(sensor_packets, *streams, key=itemgetter(0))
        return (packet if isinstance(packet, Packet) else packet() for _, packet in packets_due)

    def count(self, start_ns: int, stop_ns: int) -> dict[PacketKind, int]:
        """Return the number of packets of the devices in a span since the first pulse, by kind."""
        return {kind: len(self._numbers(kind, start_ns, stop_ns)) for kind in self._kinds}

    def _numbers(self, kind: PacketKind, start_ns: int, stop_ns: int) -> range:
        """Return the numbers of packets in a span."""
        return range(self._first_number(kind, start_ns), self._first_number(kind, stop_ns))

    def _first_number(self, kind: PacketKind, since_ns: int) -> int:
        """Return the number of the first packet at a time since the first pulse, or later.

        It is a UTC second, an edge of a pulse since 1970 (two a second), or a sample.
        """
        if kind is PacketKind.IMU:
            return -(-since_ns * self._rate_hz // S_NS)
        utc_ns = self._start_ns + since_ns
        if kind is PacketKind.NMEA:
            return -(-(utc_ns - self._delay_ns) // S_NS)
        rising = -(-utc_ns // S_NS)
        falling = -(-(utc_ns - PULSE_NS) // S_NS)
        return rising + falling

    def _sentences(self, seconds: range) -> Iterator[_DuePacket]:
        for second in seconds:  # with the same delay after its second as on the sensor's line
            yield second * S_NS + self._delay_ns, partial(self._sentence, second * S_NS)

    def _sentence(self, second_ns: int) -> Packet:
        assert self._receiver is not None  # or no sentence is among the kinds
        return Packet(PacketKind.NMEA, second_ns + self._delay_ns, rmc(self._receiver.fix(second_ns)))

    def _pulses(self, numbers: range) -> Iterator[_DuePacket]:
        for number in numbers:
            second, is_end = divmod(number, 2)
            due_ns = second * S_NS + is_end * PULSE_NS
            level = (PULSE_HIGH, PULSE_LOW)[is_end]
            yield due_ns, Packet(PacketKind.PPS, due_ns, level)

    def _samples(self, numbers: range) -> Iterator[_DuePacket]:
        imu = self._imu
        ready = dict[int, Packet]()  # by number of the sample
        assert isinstance(imu, ImuSampler)

        def sample(number: int) -> Packet:
            """Return a sample; samples of 20 ms are read together."""
            if number not in ready:
                ready.clear()
                count = min(max(self._rate_hz // _READS_PER_S, 1), numbers.stop - number)
                samples = imu.read(number, count)
                stamps_ns = samples.t_ns if samples.stamp_ns is None else samples.stamp_ns
                arrivals_ns = samples.t_ns + imu.late_ns(number, count)
                frames = imu_frames(
                    number, stamps_ns, samples.angular_rate_rad_s, samples.specific_force_m_s2
                )
                packets = map(partial(Packet, PacketKind.IMU), arrivals_ns.tolist(), frames)
                ready.update(enumerate(packets, number))
            return ready[number]

        for number in numbers:
            due_ns = self._start_ns + number * S_NS // self._rate_hz + int(imu.late_ns(number, 1)[0])
            yield due_ns, partial(sample, number)


_T = TypeVar("_T")

_RETRY_S = 1.0  # period of attempts to open a device that has vanished
PATIENCE_S = 0.25
"""Greatest time that a message waits for the line, and that writing takes: a quarter of a receiver's
second."""
_MOST_WAITING = 4096
"""Greatest number of waiting messages: more than an inertial unit has samples in that time."""
_SCHEMES = ("socket", "rfc2217")
"""Schemes of URLs that lead to a port elsewhere; others of pyserial are for its own tests, or open files."""
_LINELESS = ("socket://",)  # ports that accept the setting of a line without an error, but have no line


@dataclass(frozen=True, slots=True)
class Away:
    """A time during which a device was gone."""

    at_s: float  # since the port was opened
    away_s: float  # duration until the device was back, or the stream ended


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


def has_line(action: Callable[[], object]) -> bool:
    """Return True if a port has the line that `action` sets or reads; a pseudo-terminal has none."""
    try:
        action()
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
    scheme, separator, address = name.partition("://")
    if separator:
        if scheme not in _SCHEMES or not address:
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
    """A serial port at 8N1 without flow control, which opens a vanished device again once it is back.

    It is for one thread, which reads and writes by `use`.

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
        self._errors = (serial.SerialException, OSError, termios.error)
        self._timeout_error = serial.SerialTimeoutException
        self._away_since_s: float | None = None
        self._opened_s = time.monotonic()
        self._tried_s = self._opened_s
        self.away: tuple[Away, ...] = ()
        """Past times without the device."""
        try:
            self._port: Any = unless_ending(self._open)
        except self._errors as error:
            error_number = getattr(error, "errno", None)
            found = os.strerror(error_number) if error_number else str(error)
            raise OutputError(f"{where} {name}", found, _PORT) from None
        except ValueError as error:
            raise OutputError(f"{where} {name}", str(error), _PORT) from None
        may_have_line = line is not None and not name.startswith(_LINELESS)
        self.has_line = may_have_line and has_line(lambda: setattr(self._port, str(line), False))

    def use(self, action: Callable[[Any], _T]) -> _T | None:
        """Call `action` with the port of pyserial, to read or write; None if the device is away or busy."""
        if self._away_since_s is not None and not self._is_back():
            return None
        try:
            return action(self._port)
        except self._timeout_error:
            return None
        except self._errors:
            self._away_since_s = self._tried_s = time.monotonic()
            self.close(for_good=False)
            return None

    def close(self, *, for_good: bool = True) -> None:
        """Close the port, if it is open; unless `for_good`, the time without the device goes on."""
        if for_good:
            self._note_away()
        with suppress(*self._errors):
            self._port.close()

    def _open(self) -> Any:  # a class of pyserial, which has no types
        import serial

        patience = {"timeout": PATIENCE_S, "write_timeout": PATIENCE_S}
        port = serial.serial_for_url(self.name, self._baud, **patience, do_not_open=True)
        if self.line:
            setattr(port, self.line, False)
        port.open()
        return port

    def _is_back(self) -> bool:
        if time.monotonic() < self._tried_s + _RETRY_S:
            return False
        self._tried_s = time.monotonic()
        with suppress(*self._errors, ValueError):
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
        self._waiting = queue.Queue[tuple[float, Packet] | None](_MOST_WAITING)
        self._messages = 0
        self._bytes = 0
        self._dropped = 0
        self._pulses = 0
        self._thread = threading.Thread(target=self._run, name=f"serial {port.name}", daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        with suppress(queue.Full):
            self._waiting.put_nowait(None)
        self._thread.join(2 * PATIENCE_S)  # a daemon: a thread that hangs in a driver is abandoned

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
        return OutletResult(
            to=port.name,
            messages=self._messages,
            bytes=self._bytes,
            dropped=self._dropped,
            away=port.away,
            line=port.line,
            pulses=self._pulses if port.has_line else None,
        )

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            since_s, packet = item
            if packet.kind is PacketKind.PPS:
                self._set_line(high=any(packet.payload))
            elif time.monotonic() - since_s > PATIENCE_S or not self._write(packet.payload):
                self._dropped += 1
        self._set_line(high=False)
        self._port.close()

    def _write(self, payload: bytes) -> bool:
        def write(port: Any) -> int | None:
            """Write once there is room, which pyserial would poll for on a whole core; None without room."""
            with suppress(UnsupportedOperation):  # a port without descriptor, such as loop://
                if not select.select([], [port.fileno()], [], PATIENCE_S)[1]:
                    return None
            length: int = port.write(payload)
            return length

        if (length := self._port.use(write)) is None:
            return False
        self._messages += 1
        self._bytes += length
        return True

    def _set_line(self, *, high: bool) -> None:
        def set_line(port: Any) -> bool:
            setattr(port, str(self._port.line), high)
            return True

        if self._port.has_line:
            self._pulses += bool(self._port.use(set_line)) and high


_GPS_BAUD = 9600  # rate of the sensor's input (63-9243 Rev D, section 7.4)
_BAUD = 921_600
_BITS_PER_BYTE = 10  # on the line: start, eight, stop
_IMU_OUT = "--imu-out"


class OutletSinks(OutletPart):
    """Sinks of sentences, pulses and inertial samples beside the packets of the sensors.

    Parameters
    ----------
    stream : stream of a scene, with options that ask for outlets

    Raises the errors of `Emulator.stream`.
    """

    def __init__(self, stream: SceneStream) -> None:
        outlets = stream.options.outlets
        assert outlets is not None
        self._stream = stream
        pulse_line = None if outlets.gps_pps == "off" else outlets.gps_pps
        self.kinds: list[PacketKind] = []
        """Kinds of packets to make."""
        if outlets.gps_out:
            self.kinds.append(PacketKind.NMEA)
            if pulse_line:
                self.kinds.append(PacketKind.PPS)
        if outlets.imu_out:
            self.kinds.append(PacketKind.IMU)
        DevicePackets(stream.emulator.engine, self.kinds)  # refuses a scene that lacks a device
        self.sinks: dict[PacketKind, SerialSink | ImuUdpSink] = {}
        self.look_ahead = 0
        """Packets that a stream computes further ahead, because of samples between sensor packets."""
        with ExitStack() as stack:
            if outlets.gps_out:
                port = SerialSink(SerialPort(outlets.gps_out, _GPS_BAUD, "--gps-out", pulse_line))
                stack.push(port)
                self.sinks[PacketKind.NMEA] = port
                self.sinks[PacketKind.PPS] = port
            if outlets.imu_out:
                imu = stream.emulator.scenario.imu
                assert imu is not None
                self.look_ahead = 2 * imu.rate_hz
                samples = _imu_sink(outlets.imu_out, imu.rate_hz)
                stack.push(samples)
                self.sinks[PacketKind.IMU] = samples
            self._open = stack.pop_all()

    def end(self, _error: BaseException | None) -> None:
        """Close the sinks, once the packets that wait for them have left."""
        self._open.close()

    @property
    def result(self) -> dict[PacketKind, OutletResult]:
        """Results by kind; packets that the stream skipped count as dropped."""
        skipped = self._stream.report.skipped
        results = {}
        for kind, sink in self.sinks.items():
            result = sink.result
            results[kind] = replace(result, dropped=result.dropped + skipped[kind])
        return results


def _imu_sink(to: str, rate_hz: int) -> "SerialSink | ImuUdpSink":
    """Open the sink of samples.

    Raises InputError if `to` names none, OutputError if a serial line is too slow for the rate.
    """
    if to.startswith("serial:"):
        limit_hz = _BAUD // (_BITS_PER_BYTE * IMU_FRAME.itemsize)
        if rate_hz > limit_hz:
            expected = f"at most {limit_hz} on a line of {_BAUD} baud, or udp://"
            raise OutputError(f"{_IMU_OUT} {to}", f"found imu.rate_hz = {rate_hz}", expected)
        return SerialSink(SerialPort(to.removeprefix("serial:"), _BAUD, _IMU_OUT))
    return ImuUdpSink(*host_and_port(to, _IMU_OUT, "udp://HOST:PORT, or serial:PORT", "udp://"))


class ImuUdpSink(PacketSink):
    """Sink that sends samples by UDP, one per datagram: in groups they would be late."""

    def __init__(self, host: str, port: int) -> None:
        self._to = (resolve(host), port)
        self._samples = 0
        self._bytes = 0
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
        return OutletResult(to=f"udp://{host}:{port}", messages=self._samples, bytes=self._bytes, dropped=0)
