"""Datagrams."""

import socket
from contextlib import suppress
from dataclasses import replace

import pytest
from listening import opened, port_of
from sinks.kit import make_packets

from vlp16emu.errors import OutputError, RunError
from vlp16emu.hosts import LOOPBACK
from vlp16emu.packets import FACTORY_LINK
from vlp16emu.sinks import UdpSink
from vlp16emu.types import Packet, PacketKind


@pytest.fixture
def receivers():
    """Two sockets on free ports of the loopback."""
    with opened(5) as data, opened(5) as position:
        yield data, position


def test_datagrams_arrive_at_their_ports(receivers):
    """Data and position payloads arrive unchanged and in order, each at its own port, from two free ports."""
    packets = make_packets(50)
    data, position = receivers
    data_port, position_port = map(port_of, receivers)
    with UdpSink([replace(FACTORY_LINK, data_port=data_port, position_port=position_port)]) as sink:
        for packet in packets:
            sink.send(packet)
    for receiver, kind, count in ((data, PacketKind.DATA, 40), (position, PacketKind.POSITION, 10)):
        received = [receiver.recvfrom(2000) for _ in range(count)]
        assert [payload for payload, _ in received] == [p.payload for p in packets if p.kind is kind]
        assert {sender[0] for _, sender in received} == {LOOPBACK}
        assert not {sender[1] for _, sender in received} & {2368, 8308}
    assert sink.sent == [{PacketKind.DATA: 40, PacketKind.POSITION: 10}]
    assert sink.latest_position == [packets[-1].payload]


def test_loopback_is_the_default():
    """Without an address everything goes to this machine; a name stands for its IPv4 address."""
    with UdpSink() as sink:
        assert list(sink._to[0].values()) == [("127.0.0.1", 2368), ("127.0.0.1", 8308)]
    with UdpSink(host="localhost") as sink:
        assert sink.address == "127.0.0.1"


def test_nobody_listening_does_not_end_the_stream():
    """Sending on goes well where every datagram is answered by port unreachable; who listens then gets
    what comes next."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
        closed.bind((LOOPBACK, 0))
        port = closed.getsockname()[1]
    with UdpSink([replace(FACTORY_LINK, data_port=port, position_port=port)]) as sink:
        for packet in make_packets(200):
            sink.send(packet)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
            late.bind((LOOPBACK, port))
            late.settimeout(5)
            sink.send(packet)
            assert late.recv(2000) == packet.payload
    assert sink.sent[0].total() == 201


def test_broadcast_is_asked_for_only_where_it_is_meant():
    """The loopback's broadcast address gets sockets that may broadcast, an ordinary address does not."""
    for host, allowed in (("127.255.255.255", 1), ("127.0.0.1", 0), ("127.0.0.7", 0)):
        with UdpSink(host=host) as sink:
            options = {
                s.getsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST) for s in sink._sockets[0].values()
            }
        assert options == {allowed}


@pytest.mark.parametrize(
    ("host", "line"),
    [
        ("", "destination: nothing; expected the IPv4 address or the name of a host"),
        ("0.0.0.0", "destination: 0.0.0.0, which is no host; expected"),
        ("::1", "destination: ::1, an IPv6 address; expected the IPv4 address"),
        ("a..b", r"destination: 'a\.\.b', which is unknown; expected"),
    ],
)
def test_impossible_destination_is_refused(host, line):
    """What is no IPv4 host is bad input, reported in one line."""
    with pytest.raises(OutputError, match=line) as caught:
        UdpSink(host=host)
    assert caught.value.exit_code == 2


def test_foreign_source_address_is_refused():
    """Sending as a sensor from an address that this machine does not have names address, port and reason."""
    with pytest.raises(
        OutputError,
        match=r"192\.0\.2\.201:2368: Cannot assign requested address; expected .*: sudo ip addr add "
        r"192\.0\.2\.201/24",
    ):
        UdpSink([replace(FACTORY_LINK, source="192.0.2.201")], as_sensor=True)
    for name in "", "\udcff":  # the system takes the empty name for any interface; the other is no text
        with pytest.raises(OutputError, match=r"^interface .*: No such device; expected one of .*lo"):
            UdpSink(interface=name)


def test_port_in_use_is_refused():
    """Sending as a sensor needs its port; where another program has it, the error names it and nothing
    stays open."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        with suppress(OSError):  # then somebody else has it, which does as well
            other.bind(("127.0.0.9", 8308))
        with pytest.raises(
            OutputError, match=r"127\.0\.0\.9:(2368|8308): Address already in use; expected a free port"
        ):
            UdpSink([replace(FACTORY_LINK, source="127.0.0.9")], as_sensor=True)


def test_what_cannot_be_sent_is_an_error():
    """A datagram that the system refuses ends the run and reports what had been sent before; NMEA by
    Ethernet is a programming error."""
    with UdpSink() as sink:
        sink.send(Packet(PacketKind.DATA, 0, bytes(1206)))
        with pytest.raises(
            RunError, match=r"127\.0\.0\.1:2368: Message too long at packet 2; those before it"
        ):
            sink.send(Packet(PacketKind.DATA, 1, bytes(70_000)))
    assert sink.sent[0].total() == 1
    with UdpSink() as sink, pytest.raises(ValueError, match="nmea"):
        sink.send(Packet(PacketKind.NMEA, 0, b"$GPRMC"))
