"""Samples of the inertial unit as datagrams, or on a serial line."""

import socket
from typing import Self
from urllib.parse import urlsplit

from vlp16emu.errors import OutputError, RunError
from vlp16emu.packets import IMU_FRAME
from vlp16emu.sinks.serial_port import SerialPort, SerialSink
from vlp16emu.sinks.sink import Outlet, OutletResult
from vlp16emu.sinks.udp import resolve
from vlp16emu.types import Packet

_BAUD = 921_600
_BITS = 10
"""Of a byte on the line: start, eight, stop."""
_WHERE = "--imu-out"


def imu_outlet(to: str, rate_hz: int) -> Outlet:
    """Open the way that samples go.

    Parameters
    ----------
    to : udp://HOST:PORT; or serial: and a device or URL of pyserial, at 921600 baud
    rate_hz : of the samples

    Raises
    ------
    OutputError
        where it is neither, or cannot be opened, or a serial line is too slow for the rate
    """
    if to.startswith("serial:"):
        most_hz = _BAUD // (_BITS * IMU_FRAME.itemsize)
        if rate_hz > most_hz:
            found = f"found imu.rate_hz = {rate_hz}"
            raise OutputError(
                f"{_WHERE} {to}", found, f"at most {most_hz} on a line of {_BAUD} baud, or udp://"
            )
        return SerialSink(SerialPort(to.removeprefix("serial:"), _BAUD, _WHERE))
    try:
        parts = urlsplit(to)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if to != f"udp://{host}:{port}":
        raise OutputError(_WHERE, f"found {to}", "udp://HOST:PORT, or serial:PORT")
    return ImuUdpSink(str(host), int(port or 0))


class ImuUdpSink:
    """Sends samples by UDP, one to a datagram: together they would be late by the time between them.

    Parameters
    ----------
    host, port : of the receiver

    Raises
    ------
    OutputError
        where the host is unknown
    """

    def __init__(self, host: str, port: int) -> None:
        self._to = (resolve(host), port)
        self._samples = self._bytes = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, packet: Packet) -> None:
        """Send one sample.

        Raises
        ------
        RunError
            where the system cannot send any more
        """
        try:
            self._bytes += self._socket.sendto(packet.payload, self._to)
        except OSError as error:
            where = "{}:{}".format(*self._to)
            raise RunError(f"{where}: {error.strerror} at sample {self._samples + 1}") from error
        self._samples += 1

    @property
    def result(self) -> OutletResult:
        """What has left so far."""
        host, port = self._to
        return OutletResult(f"udp://{host}:{port}", self._samples, self._bytes, 0)
