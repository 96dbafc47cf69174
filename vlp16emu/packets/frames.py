"""Ethernet, IPv4 and UDP headers of a real VLP-16.

The two streams differ: data frames have a fixed header without a UDP checksum, position frames count their
identification up and have a checksum. Measured on the frames of two real units; payload sizes are from
63-9243 Rev D, sections 9.3.2 (p. 56) and 9.3.3 (p. 60).
"""

import struct
from dataclasses import dataclass
from functools import lru_cache
from ipaddress import IPv4Address

from vlp16emu.packets.layout import DATA_BYTES

DATA_PORT = 2368
"""UDP port of data packets, source and by default destination. Source: 63-9243 Rev D, section 9.3.2, p.
56."""
POSITION_PORT = 8308  # UDP port of position packets, likewise. Source: 63-9243 Rev D, section 9.3.3, p. 60.
DATA_TTL = 255  # Time to live of data frames, measured
POSITION_TTL = 64  # Time to live of position frames, measured

_IP_HEADER_BYTES = 20
_UDP_HEADER_BYTES = 8
_IP = slice(14, 34)
_IDENTIFICATION = slice(18, 20)
_IP_CHECKSUM = slice(24, 26)
_ADDRESSES = slice(26, 34)
_UDP_CHECKSUM = slice(40, 42)
_IPV4 = 0x0800
_VERSION_AND_LENGTH = 0x45
_DONT_FRAGMENT = 0x4000
_UDP = 17
"""EtherType, first byte of the IPv4 header, its flag, and its protocol (RFC 791)."""


@dataclass(frozen=True, slots=True)
class Link:
    """Addresses and ports of a sensor's frames."""

    source_mac: bytes  # 6 bytes
    destination_mac: bytes  # 6 bytes
    source: str  # IPv4 address, dotted
    destination: str  # IPv4 address, dotted
    data_port: int = DATA_PORT  # UDP port of data packets at the destination
    position_port: int = POSITION_PORT  # UDP port of position packets at the destination
    identification: int = 0  # Identification of the first position frame; it counts up


FACTORY_LINK = Link(
    # 60:76:88 is Velodyne's; 38 is seen on newer units, the last two bytes identify the unit.
    source_mac=bytes.fromhex("607688380001"),
    destination_mac=b"\xff" * 6,
    source="192.168.1.201",
    destination="255.255.255.255",
)
"""A sensor with factory settings. Source: 63-9243 Rev D, section 10.2.3.12 (addresses)."""


@lru_cache
def data_header(link: Link, payload_bytes: int = DATA_BYTES) -> bytes:
    """Headers of data packets, the same for all.

    They have 42 bytes, on which readers with fixed offsets rely: identification 0, don't fragment, UDP
    checksum 0 (none).
    """
    header = bytearray(_header(link, DATA_PORT, link.data_port, payload_bytes, DATA_TTL, _DONT_FRAGMENT))
    header[_IP_CHECKSUM] = _checksum(header[_IP])
    return bytes(header)


def position_frame(link: Link, payload: bytes, number: int) -> bytes:
    """Frame of a position packet with a payload of 512 bytes, or fewer if truncated.

    Its identification is the first one plus `number`, the count of position packets before it, modulo 2**16.
    """
    header = bytearray(_header(link, POSITION_PORT, link.position_port, len(payload), POSITION_TTL, 0))
    header[_IDENTIFICATION] = (link.identification + number & 0xFFFF).to_bytes(2)
    header[_IP_CHECKSUM] = _checksum(header[_IP])
    # The sum includes addresses, protocol and length; a sum of 0 is sent as ones (RFC 768).
    pseudo = header[_ADDRESSES] + struct.pack(">2H", _UDP, _UDP_HEADER_BYTES + len(payload))
    padding = bytes(len(payload) % 2)
    checksum = _checksum(pseudo + header[_ADDRESSES.stop :] + payload + padding)
    header[_UDP_CHECKSUM] = b"\xff\xff" if checksum == b"\0\0" else checksum
    return bytes(header) + payload


@lru_cache
def _header(link: Link, port: int, to_port: int, payload_bytes: int, ttl: int, fragment: int) -> bytes:
    """Ethernet II, IPv4 and UDP header, identification and checksums 0."""
    udp_bytes = _UDP_HEADER_BYTES + payload_bytes
    ethernet = struct.pack(">6s6sH", link.destination_mac, link.source_mac, _IPV4)
    ip = struct.pack(
        ">2B3H2BH4s4s",
        *(_VERSION_AND_LENGTH, 0, _IP_HEADER_BYTES + udp_bytes, 0, fragment, ttl, _UDP, 0),
        *(IPv4Address(link.source).packed, IPv4Address(link.destination).packed),
    )
    return ethernet + ip + struct.pack(">4H", port, to_port, udp_bytes, 0)


def _checksum(data: bytes | bytearray) -> bytes:
    """Internet checksum of an even number of bytes, not all 0 (RFC 1071): words are summed modulo 65535."""
    return (-int.from_bytes(data) % 0xFFFF).to_bytes(2)
