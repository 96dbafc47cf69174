"""What leaves beside the packets of the sensors, and by which way."""

import socket
from collections import Counter
from dataclasses import replace
from typing import Self
from urllib.parse import urlsplit

from vlp16emu.errors import OutputError, RunError
from vlp16emu.extras.bench.imu_frame import IMU_FRAME
from vlp16emu.extras.bench.options import Outlets
from vlp16emu.extras.bench.serial_port import Outlet, OutletResult, SerialPort, SerialSink
from vlp16emu.motion import Imu
from vlp16emu.sinks import PacketSink
from vlp16emu.sinks.udp import resolve
from vlp16emu.types import Packet, PacketKind

_GPS_BAUD = 9600
"""What the sensor takes (63-9243 Rev D, section 7.4)."""
_BAUD = 921_600
_BITS = 10
"""Of a byte on the line: start, eight, stop."""
_WHERE = "--imu-out"


class Ways(PacketSink):
    """The ways that sentences, pulses and inertial samples take beside the packets of the sensors; a sink of all of them."""

    def __init__(self, asked: Outlets) -> None:
        self._asked, self._ways = asked, dict[PacketKind, Outlet]()
        self._sensors: PacketSink

    def __exit__(self, *_: object) -> None:
        for way in dict.fromkeys(self._ways.values()):
            way.__exit__()

    @property
    def kinds(self) -> tuple[PacketKind, ...]:
        """Kinds of packets to make."""
        gps = (PacketKind.NMEA, PacketKind.PPS)[: 1 if self._asked.gps_pps == "off" else 2]
        return (*(gps if self._asked.gps_out else ()), *((PacketKind.IMU,) if self._asked.imu_out else ()))

    def look_ahead(self, imu: Imu | None) -> int:
        """Packets that a stream computes further ahead, because of samples between those of the sensors."""
        return 2 * imu.rate_hz if self._asked.imu_out and imu else 0

    def open(self, sensors: PacketSink, imu: Imu | None) -> Self:
        """Open what there is beside `sensors`, the sink of data and position packets; `OutputError` if a port or receiver is none."""
        self._sensors = sensors
        if self._asked.gps_out:
            line = None if self._asked.gps_pps == "off" else self._asked.gps_pps
            port = SerialSink(SerialPort(self._asked.gps_out, _GPS_BAUD, "--gps-out", line))
            self._ways[PacketKind.NMEA] = self._ways[PacketKind.PPS] = port
        if self._asked.imu_out and imu:
            self._ways[PacketKind.IMU] = imu_outlet(self._asked.imu_out, imu.rate_hz)
        return self

    def send(self, packet: Packet) -> None:
        """Send one packet by the way of its kind; errors are the sink's."""
        self._ways.get(packet.kind, self._sensors).send(packet)

    def results(self, skipped: Counter[PacketKind]) -> tuple[OutletResult | None, OutletResult | None]:
        """Return what left of the receiver and of the inertial unit, if it does, with what the stream skipped among the dropped."""

        def result(kind: PacketKind) -> OutletResult | None:
            sent = self._ways[kind].result if kind in self._ways else None
            return sent and replace(sent, dropped=sent.dropped + skipped[kind])

        return result(PacketKind.NMEA), result(PacketKind.IMU)


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
