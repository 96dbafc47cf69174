"""What leaves beside the packets of the sensors, and by which way."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from urllib.parse import urlsplit

from vlp16emu.errors import OutputError, RunError
from vlp16emu.extras.bench.serial_port import SerialPort, SerialSink
from vlp16emu.motion import Imu
from vlp16emu.packets import IMU_FRAME
from vlp16emu.run.options import Outlets
from vlp16emu.sinks.sink import Outlet, OutletResult
from vlp16emu.sinks.udp import resolve
from vlp16emu.types import Packet, PacketKind

_GPS_BAUD = 9600  # what the sensor takes (63-9243 Rev D, section 7.4)
_BAUD = 921_600
_BITS = 10  # of a byte on the line: start, eight, stop
_WHERE = "--imu-out"


class Ways:
    """The ways that sentences, pulses and inertial samples take beside the packets of the sensors."""

    def __init__(self, asked: Outlets) -> None:
        self.gps_out, self.gps_pps, self.imu_out = asked.gps_out, asked.gps_pps, asked.imu_out

    @property
    def kinds(self) -> tuple[PacketKind, ...]:
        """Kinds of packets to make."""
        gps = (PacketKind.NMEA, PacketKind.PPS)[: 1 if self.gps_pps == "off" else 2]
        return (*(gps if self.gps_out else ()), *((PacketKind.IMU,) if self.imu_out else ()))

    def look_ahead(self, imu: Imu | None) -> int:
        """Packets that a stream computes further ahead, because of samples between those of the sensors."""
        return 2 * imu.rate_hz if self.imu_out and imu else 0

    @contextmanager
    def opened(self, imu: Imu | None) -> Iterator[dict[PacketKind, Outlet]]:
        """Open what there is, and give the way of each kind; `OutputError` if a port or the receiver of samples is none."""
        ways = dict[PacketKind, Outlet]()
        with ExitStack() as stack:
            if self.gps_out:
                line = None if self.gps_pps == "off" else self.gps_pps
                port = SerialPort(self.gps_out, _GPS_BAUD, "--gps-out", line)
                ways[PacketKind.NMEA] = ways[PacketKind.PPS] = stack.enter_context(SerialSink(port))
            if self.imu_out and imu:
                ways[PacketKind.IMU] = stack.enter_context(imu_outlet(self.imu_out, imu.rate_hz))
            yield ways


def imu_outlet(to: str, rate_hz: int) -> Outlet:
    """Open the way that samples go.

    Parameters
    ----------
    to : udp://HOST:PORT; or serial: and a device or URL of pyserial, at 921600 baud
    rate_hz : of the samples

    Raises
    ------
    OutputError
        If it is neither, or cannot be opened, or its host is unknown, or a serial line is too slow for the rate
    """
    if to.startswith("serial:"):
        most_hz = _BAUD // (_BITS * IMU_FRAME.itemsize)
        if rate_hz > most_hz:
            found = f"found imu.rate_hz = {rate_hz}"
            raise OutputError(f"{_WHERE} {to}", found, f"at most {most_hz} on a line of {_BAUD} baud, or udp://")
        return SerialSink(SerialPort(to.removeprefix("serial:"), _BAUD, _WHERE))
    try:
        parts = urlsplit(to)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if to != f"udp://{host}:{port}":
        raise OutputError(_WHERE, f"found {to}", "udp://HOST:PORT, or serial:PORT")
    return ImuUdpSink(str(host), int(port or 0))


class ImuUdpSink(Outlet):
    """Sends samples by UDP, one to a datagram: together they would be late by the time between them."""

    def __init__(self, host: str, port: int) -> None:
        self._to = (resolve(host), port)
        self._samples = self._bytes = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, packet: Packet) -> None:
        """Send one sample; `RunError` if the system cannot send any more."""
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
