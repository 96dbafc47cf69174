"""UDP datagrams in frames of any link type that carries IP, behind tags, labels and tunnels."""

from typing import NamedTuple

_ETHERNET = 1
_ETHERTYPE_AT = {_ETHERNET: 12, 113: 14, 276: 0, 104: 2, 138: 16}
"""Offset of the EtherType by link type: Ethernet, Linux cooked (SLL, SLL2), Cisco HDLC, IP over FireWire.
Source of all link types: www.tcpdump.org/linktypes.html."""
_BODY_AT = {_ETHERNET: 14, 113: 16, 276: 20, 104: 4, 138: 18}
_MAC_AT = {_ETHERNET: 6, 113: 6, 276: 12}
_BARE_IP_AT = {101: 0, 12: 0, 14: 0, 228: 0, 229: 0, 0: 4, 108: 4, 109: 12}
"""Offset of the IP header by link type: raw IP, BSD loopback, OpenBSD's encapsulation."""
_PPP_AT = {9: 0, 50: 0, 166: 1, 204: 1, 51: 6}
"""Offset of PPP by link type: serial, with a byte of direction, behind PPPoE."""
LINK_TYPES = frozenset({*_ETHERTYPE_AT, *_BARE_IP_AT, *_PPP_AT})
"""Link types that are read."""

_IPV4, _IPV6, _TAGS = 0x0800, 0x86DD, (0x8100, 0x88A8, 0x9100)
_MPLS, _PPPOE, _BRIDGED, _LLC = (0x8847, 0x8848), 0x8864, 0x6558, (0x0001, 0x0004)
"""EtherTypes of IEEE 802 and RFC 3032, 2516, 1701; the last are those of SLL for 802.3 and 802.2."""
_SMALLEST_ETHERTYPE = 0x0600
_PPP_IP = (0x0021, 0x0057)
_UDP, _IP_IN_IP, _IP6_IN_IP, _GRE = 17, 4, 41, 47
_FRAGMENT6, _AUTHENTICATION, _EXTENSIONS6 = 44, 51, (0, 43, 60, 51, 44)
"""Protocol numbers of IANA; headers that may stand in front of the payload of IPv6 (RFC 8200)."""
_VXLAN = (4789).to_bytes(2)
"""UDP port of RFC 7348."""
PLAIN_AT, PLAIN_BODY, _UNFRAGMENTED = 14, 34, (b"\x40\0", b"\0\0")
"""Offsets of IP and UDP header of a plain frame, and its flags: don't fragment, or none."""
_MOST_LAYERS = 8


class Ip(NamedTuple):
    """An IP packet in a frame."""

    at: int
    """Offset of its header in the frame."""
    body: int
    """Offset of its content, behind header and extensions."""
    end: int
    """Offset of its end by its own length; what is behind is padding."""
    protocol: int
    fragment: int
    """Offset in the datagram, bytes."""
    more: bool
    """More fragments follow."""
    key: bytes
    """Addresses, identification and protocol, the same for all fragments of a datagram."""


def is_plain(link_type: int, frame: bytes) -> bool:
    """Return whether a frame is whole UDP over IPv4 without options, on Ethernet without tags, in no tunnel: nearly all are."""
    return (
        link_type == _ETHERNET
        and frame[12:15] == b"\x08\x00\x45"
        and frame[23:24] == b"\x11"
        and frame[20:22] in _UNFRAGMENTED
        and frame[36:38] != _VXLAN
    )


def mac_of(link_type: int, frame: bytes) -> bytes:
    """Return the sender's address on the link; empty if the link type has none."""
    at = _MAC_AT.get(link_type)
    return b"" if at is None else frame[at : at + 6]


def ip_in(link_type: int, frame: bytes) -> Ip | None:
    """Find the innermost IP packet; None if there is none that is whole to its body."""
    if link_type in _BARE_IP_AT:
        at: int | None = _BARE_IP_AT[link_type]
    elif link_type in _PPP_AT:
        at = _behind_ppp(frame, _PPP_AT[link_type])
    elif link_type in _ETHERTYPE_AT:
        kind = int.from_bytes(frame[_ETHERTYPE_AT[link_type] :][:2])
        at = _BODY_AT[link_type] if kind == _IPV4 else _behind(frame, kind, _BODY_AT[link_type])
    else:
        return None
    ip = None
    for _ in range(_MOST_LAYERS):
        found = None if at is None else _ip_at(frame, at)
        if found is None:
            return ip
        ip, at = found, _inside(frame, found)
        if at is None:
            return ip
    return ip


def _behind(frame: bytes, kind: int, at: int) -> int | None:
    """Find the IP header behind an EtherType whose content begins at `at`."""
    for _ in range(_MOST_LAYERS):
        if kind in (_IPV4, _IPV6):
            return at
        if kind in _TAGS:
            kind, at = int.from_bytes(frame[at + 2 : at + 4]), at + 4
        elif kind in _MPLS:
            while at + 4 <= len(frame) and not frame[at + 2] & 1:  # the lowest label has this bit
                at += 4
            return at + 4
        elif kind == _PPPOE:
            return _behind_ppp(frame, at + 6)
        elif kind == _BRIDGED:
            kind, at = int.from_bytes(frame[at + 12 : at + 14]), at + 14
        elif (kind < _SMALLEST_ETHERTYPE or kind in _LLC) and frame[at : at + 3] == b"\xaa\xaa\x03":
            kind, at = int.from_bytes(frame[at + 6 : at + 8]), at + 8
        else:
            return None
    return None


def _behind_ppp(frame: bytes, at: int) -> int | None:
    if frame[at : at + 2] == b"\xff\x03":
        at += 2
    if frame[at : at + 2] in (b"\x0f\x00", b"\x8f\x00"):  # Cisco HDLC instead
        return _behind(frame, int.from_bytes(frame[at + 2 : at + 4]), at + 4)
    short = frame[at : at + 1] in (b"\x21", b"\x57")  # RFC 1661, section 6.5: the protocol in one byte
    kind = int.from_bytes(frame[at : at + 2 - short])
    return at + 2 - short if kind in _PPP_IP else None


def _ip_at(frame: bytes, at: int) -> Ip | None:
    version = frame[at] >> 4 if at < len(frame) else 0
    if version == 4 and len(frame) >= at + 20:  # RFC 791
        body, words = at + 4 * (frame[at] & 0x0F), int.from_bytes(frame[at + 6 : at + 8])
        end = at + int.from_bytes(frame[at + 2 : at + 4])
        end = end if end > at else len(frame)  # 0 where the network card cuts the datagram up
        if body < at + 20:
            return None
        protocol, fragment = frame[at + 9], (words & 0x1FFF) * 8
        key = frame[at + 12 : at + 20] + frame[at + 4 : at + 6] + frame[at + 9 : at + 10]
        return Ip(at, body, end, protocol, fragment, bool(words & 0x2000), key)
    return _ip6_at(frame, at) if version == 6 and len(frame) >= at + 40 else None  # RFC 8200


def _ip6_at(frame: bytes, at: int) -> Ip | None:
    protocol, body, fragment, more = frame[at + 6], at + 40, 0, False
    end, key = body + int.from_bytes(frame[at + 4 : at + 6]), frame[at + 8 : at + 40]
    while protocol in _EXTENSIONS6 and body + 8 <= len(frame):
        before, protocol, size = protocol, frame[body], frame[body + 1]
        if before == _FRAGMENT6:
            words = int.from_bytes(frame[body + 2 : body + 4])
            fragment, more, key = words & 0xFFF8, bool(words & 1), key + frame[body + 4 : body + 8]
        body += 8 if before == _FRAGMENT6 else (size + 2) * 4 if before == _AUTHENTICATION else (size + 1) * 8
        if fragment:
            break
    return Ip(at, body, end, protocol, fragment, more, key)


def _inside(frame: bytes, ip: Ip) -> int | None:
    """Find the IP header of a packet in a tunnel."""
    at = ip.body
    if ip.fragment or ip.more:
        return None
    if ip.protocol in (_IP_IN_IP, _IP6_IN_IP):
        return at
    if ip.protocol == _GRE and at + 4 <= len(frame):
        flags, kind = frame[at], int.from_bytes(frame[at + 2 : at + 4])
        return _behind(frame, kind, at + 4 + 4 * sum(bool(flags & bit) for bit in (0x80, 0x20, 0x10)))
    if ip.protocol == _UDP and frame[at + 2 : at + 4] == _VXLAN:
        return _behind(frame, _BRIDGED, at + 16)
    return None
