"""Sending of packets as UDP datagrams, for one sensor or all sensors of a rig."""

import errno
import socket
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack

from vlp16emu.errors import OutputError, RunError
from vlp16emu.hosts import LOOPBACK, resolve
from vlp16emu.packets.frames import DATA_PORT, DATA_TTL, FACTORY_LINK, POSITION_PORT, POSITION_TTL, Link
from vlp16emu.types import Packet, PacketKind, PacketSink

# Linux socket options that Python does not name. Source: linux/in.h and asm-generic/socket.h.
_SO_NO_CHECK = 11
_IP_MTU_DISCOVER = 10
_IP_PMTUDISC_DONT = 0
_IP_PMTUDISC_DO = 2

_PORTS = {PacketKind.DATA: DATA_PORT, PacketKind.POSITION: POSITION_PORT}  # source port of a sensor by kind
_OF_SENSOR = {
    # No UDP checksum, don't fragment and therefore identification 0.
    DATA_PORT: (
        (socket.SOL_SOCKET, _SO_NO_CHECK, 1),
        (socket.IPPROTO_IP, socket.IP_TTL, DATA_TTL),
        (socket.IPPROTO_IP, _IP_MTU_DISCOVER, _IP_PMTUDISC_DO),
    ),
    # Fragmentation allowed, hence an identification that counts up: by one on a sensor, by one or two at this
    # rate on Linux between unconnected sockets.
    POSITION_PORT: (
        (socket.IPPROTO_IP, socket.IP_TTL, POSITION_TTL),
        (socket.IPPROTO_IP, _IP_MTU_DISCOVER, _IP_PMTUDISC_DONT),
    ),
}
"""Options of a sensor's sockets, by port."""


class UdpSink(PacketSink):
    """Sends the data and position packets of each unit from two separate, unconnected sockets.

    A connected socket would give a running identification to frames that must have 0, and would report
    refusals of a host on which no program listens yet.

    Parameters
    ----------
    links : addresses of each unit; packets go to their ports
    host : address or name of the receiver; may be a broadcast address
    as_sensor : send from the units' own addresses, which must be this machine's, with the ports and header
        fields of a real sensor; else from any address, any free ports, and with headers as the system makes
        them
    interface : network interface for all packets; None for the system's routes

    Raises OutputError if the host is unknown or unreachable, or the interface, address or port to send from
    is not available.
    """

    def __init__(
        self,
        links: Sequence[Link] = (FACTORY_LINK,),
        host: str = LOOPBACK,
        *,
        as_sensor: bool = False,
        interface: str | None = None,
    ) -> None:
        self.sent = [Counter[PacketKind]() for _ in links]  # Packets sent so far by each unit, by kind
        self.latest_position = [b""] * len(links)
        """Payload of the last position packet sent by each unit; empty before the first."""
        self._interface = interface
        self._sources = [link.source if as_sensor else None for link in links]
        with ExitStack() as stack:
            self._sockets = [
                {kind: stack.enter_context(_open(port, source, interface)) for kind, port in _PORTS.items()}
                for source in self._sources
            ]
            self._to = [dict[PacketKind, tuple[str, int]]() for _ in links]
            for unit, link in enumerate(links):
                self.redirect(unit, host, link.data_port, link.position_port)
            self._open = stack.pop_all()

    def __exit__(self, *_: object) -> None:
        self._open.close()

    @property
    def address(self) -> str:
        """IPv4 address that packets of the first unit are sent to."""
        return self._to[0][PacketKind.DATA][0]

    def redirect(self, unit: int, host: str, data_port: int, position_port: int) -> None:
        """Send the packets of a unit to another receiver from now on; from any thread.

        Raises OutputError if the host is unknown or unreachable; then nothing changes.
        """
        address = resolve(host)
        if _is_broadcast(address, self._sources[unit], self._interface):
            for opened in self._sockets[unit].values():
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        # One assignment, because `send` runs on another thread and must see both ports change together.
        self._to[unit] = {
            PacketKind.DATA: (address, data_port),
            PacketKind.POSITION: (address, position_port),
        }

    def send(self, packet: Packet) -> None:
        """Send one packet.

        Raises RunError if the system can no longer send, for instance because the link is down; ValueError
        for an NMEA packet, which is sent by serial line, not by Ethernet.
        """
        unit = packet.unit
        kind = packet.kind
        if kind not in _PORTS:
            raise ValueError(f"found a packet of kind {kind}, expected data or position")
        address, port = self._to[unit][kind]
        try:
            self._sockets[unit][kind].sendto(packet.payload, (address, port))
        except OSError as error:
            where = f"{address}:{port}: {error.strerror} at packet {self.sent[unit].total() + 1}"
            raise RunError(f"{where}; those before it have been sent") from error
        self.sent[unit][kind] += 1
        if kind is PacketKind.POSITION:
            self.latest_position[unit] = packet.payload


def _is_broadcast(address: str, as_sensor: str | None, interface: str | None) -> bool:
    """Query the routing table with a temporary socket that sends nothing.

    Whether 192.168.1.255 is a broadcast address depends on the netmask of the interface, which only the
    system knows: it refuses broadcast addresses to a socket without SO_BROADCAST.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        _bind(probe, as_sensor, interface, 0)
        try:
            probe.connect((address, DATA_PORT))
        except PermissionError:
            return True
        except OSError as error:
            raise OutputError(f"destination {address}", str(error.strerror), "an address in reach") from error
    return False


def _open(sensor_port: int, as_sensor: str | None, interface: str | None) -> socket.socket:
    with ExitStack() as stack:
        opened = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        _bind(opened, as_sensor, interface, sensor_port)
        for option in _OF_SENSOR[sensor_port] if as_sensor is not None else ():
            opened.setsockopt(*option)
        stack.pop_all()
    return opened


def _bind(opened: socket.socket, as_sensor: str | None, interface: str | None, port: int) -> None:
    if interface is not None:
        name = interface.encode(errors="replace") or b"?"  # an empty name would be any interface
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, name)
        except OSError as error:
            expected = f"one of {', '.join(_interfaces())}, and Linux 5.7 or the capability CAP_NET_RAW"
            raise OutputError(f"interface {interface}", str(error.strerror), expected) from error
    if as_sensor is None:
        return
    try:
        opened.bind((as_sensor, port))
    except OSError as error:
        expected = "a free port"
        if error.errno == errno.EADDRNOTAVAIL:
            device = interface or _interfaces()[0]
            expected = f"an address of this machine: sudo ip addr add {as_sensor}/24 dev {device}"
        raise OutputError(f"{as_sensor}:{port}", str(error.strerror), expected) from error


def _interfaces() -> list[str]:
    names = sorted(name for _, name in socket.if_nameindex())
    return sorted(names, key=lambda name: name == "lo")
