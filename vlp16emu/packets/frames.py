"""Ethernet, IPv4 and UDP headers as a real VLP-16 puts them around its payloads.

The two streams leave different hands, and it shows: data frames carry a fixed header without a UDP
checksum, position frames count their identification up and carry one. Measured on the frames of two
real units; the payload sizes are those of 63-9243 Rev D, sections 9.3.2 (p. 56) and 9.3.3 (p. 60).
Who only sends by UDP needs no frames, and so no dpkt, which takes 40 ms to load.
"""

from dataclasses import dataclass
from ipaddress import IPv4Address

from vlp16emu.errors import PacketError
from vlp16emu.packets.layout import DATA_BYTES, POSITION_BYTES

__all__ = [
    "DATA_PORT",
    "DATA_TTL",
    "FACTORY_LINK",
    "HEADER_BYTES",
    "POSITION_PORT",
    "POSITION_TTL",
    "Link",
    "data_header",
    "position_frame",
]

DATA_PORT = 2368
"""UDP port of data packets, source and, unless set otherwise, destination. Source: 63-9243 Rev D, section 9.3.2, p. 56."""
POSITION_PORT = 8308
"""UDP port of position packets, likewise. Source: 63-9243 Rev D, section 9.3.3, p. 60."""
DATA_TTL = 255
"""Time to live of data frames, measured."""
POSITION_TTL = 64
"""Time to live of position frames, measured."""

_IP_HEADER_BYTES = 20
_UDP_HEADER_BYTES = 8
HEADER_BYTES = 14 + _IP_HEADER_BYTES + _UDP_HEADER_BYTES
"""Ethernet, IPv4 without options, UDP: payloads start here, and readers with fixed offsets rely on it."""


@dataclass(frozen=True, slots=True)
class Link:
    """Who sends to whom."""

    source_mac: bytes
    """6 bytes."""
    destination_mac: bytes
    """6 bytes."""
    source: str
    """IPv4 address, dotted."""
    destination: str
    """IPv4 address, dotted."""
    data_port: int = DATA_PORT
    """UDP port of data packets at the destination."""
    position_port: int = POSITION_PORT
    """UDP port of position packets at the destination."""


FACTORY_LINK = Link(
    # 60:76:88 is Velodyne's; 38 is seen on newer units, the last two bytes are the unit's own.
    source_mac=bytes.fromhex("607688380001"),
    destination_mac=b"\xff" * 6,
    source="192.168.1.201",
    destination="255.255.255.255",
)
"""A sensor as it leaves the box. Source: 63-9243 Rev D, section 10.2.3.12 (addresses)."""


def data_header(link: Link) -> bytes:
    """Everything in front of the payload of a data packet, the same for each of them.

    Identification 0, don't fragment, and UDP checksum 0, which stands for none.

    Returns
    -------
    42 bytes
    """
    import dpkt

    udp = dpkt.udp.UDP(sport=DATA_PORT, dport=link.data_port, ulen=_UDP_HEADER_BYTES + DATA_BYTES, sum=0)
    ip = dpkt.ip.IP(
        len=_IP_HEADER_BYTES + _UDP_HEADER_BYTES + DATA_BYTES,
        id=0,
        df=1,
        ttl=DATA_TTL,
        p=dpkt.ip.IP_PROTO_UDP,
        src=IPv4Address(link.source).packed,
        dst=IPv4Address(link.destination).packed,
    )
    # dpkt fills in lengths and checksums from the payload it holds, and here it holds none.
    ip.sum = dpkt.in_cksum(ip.pack_hdr())
    return _ethernet(link) + ip.pack_hdr() + udp.pack_hdr()


def position_frame(link: Link, payload: bytes, number: int) -> bytes:
    """Whole frame of a position packet.

    Parameters
    ----------
    payload : 512 bytes
    number : position packets since power-up; its low 16 bits are the identification

    Raises
    ------
    PacketError
        If the payload is not 512 bytes long.
    """
    import dpkt

    if len(payload) != POSITION_BYTES:
        raise PacketError(f"position packet {number}", f"{len(payload)} bytes", f"{POSITION_BYTES}")
    udp = dpkt.udp.UDP(
        sport=POSITION_PORT, dport=link.position_port, ulen=_UDP_HEADER_BYTES + len(payload), data=payload
    )
    ip = dpkt.ip.IP(
        id=number & 0xFFFF,
        ttl=POSITION_TTL,
        p=dpkt.ip.IP_PROTO_UDP,
        src=IPv4Address(link.source).packed,
        dst=IPv4Address(link.destination).packed,
        data=udp,
    )
    return _ethernet(link) + bytes(ip)


def _ethernet(link: Link) -> bytes:
    """Ethernet II header, 14 bytes."""
    import dpkt

    header = dpkt.ethernet.Ethernet(
        dst=link.destination_mac, src=link.source_mac, type=dpkt.ethernet.ETH_TYPE_IP
    )
    return bytes(header.pack_hdr())
