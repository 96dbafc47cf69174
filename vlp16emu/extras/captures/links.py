"""UDP datagrams in frames of any link type that carries IP, also behind tags, labels and tunnels.

Numbers are those of dpkt. Its parsers are not used: they give no offsets of headers, join no fragments, and
do not read 802.11, AVS, PPI, PKTAP, NFLOG, Cisco HDLC, ERSPAN, VXLAN and Geneve.
"""

import struct
from collections import Counter
from typing import NamedTuple

from dpkt import pcap
from dpkt.ethernet import (
    ETH_TYPE_8021AD,
    ETH_TYPE_8021Q,
    ETH_TYPE_IP,
    ETH_TYPE_IP6,
    ETH_TYPE_MPLS,
    ETH_TYPE_MPLS_MCAST,
    ETH_TYPE_QINQ1,
    ETH_TYPE_TEB,
    ETH_TYPE_PPPoE,
)
from dpkt.ip import (
    IP_PROTO_AH,
    IP_PROTO_DSTOPTS,
    IP_PROTO_FRAGMENT,
    IP_PROTO_GRE,
    IP_PROTO_HOPOPTS,
    IP_PROTO_IP6,
    IP_PROTO_IPIP,
    IP_PROTO_ROUTING,
    IP_PROTO_UDP,
)
from dpkt.ppp import PPP_IP, PPP_IP6

_ETHERTYPE_AT = {
    pcap.DLT_EN10MB: (12, 14),
    pcap.DLT_LINUX_SLL: (14, 16),
    pcap.DLT_LINUX_SLL2: (0, 20),
    pcap.DLT_C_HDLC: (2, 4),
    pcap.DLT_APPLE_IP_OVER_IEEE1394: (16, 18),
}
"""Offsets of the EtherType and of what follows the header, by link type. Source of all link types:
www.tcpdump.org/linktypes.html."""
_BARE_IP_AT = {
    **dict.fromkeys((12, 14, 101), 0),  # raw IP on Linux, on OpenBSD and in files
    pcap.DLT_IPV4: 0,
    pcap.DLT_IPV6: 0,
    pcap.DLT_NULL: 4,
    108: 4,  # loopback of OpenBSD
    109: 12,  # encapsulation of OpenBSD
}
"""Offset of the IP header by link type."""
_PPP_AT = {
    pcap.DLT_PPP: 0,
    pcap.DLT_PPP_SERIAL: 0,
    pcap.DLT_PPP_PPPD: 1,
    pcap.DLT_PPP_WITH_DIR: 1,
    pcap.DLT_PPP_ETHER: 6,
}
"""Offset of PPP by link type."""
_WRAPPED = {
    pcap.DLT_IEEE802_11_RADIO: ("<H", 2, None),
    pcap.DLT_IEEE802_11_RADIO_AVS: (">I", 4, None),
    pcap.DLT_PPI: ("<H", 2, 4),
    pcap.DLT_PKTAP: ("<I", 0, 8),
    pcap.DLT_USER2: ("<I", 0, 8),  # PKTAP of older macOS
}
"""Link types with a header of their own in front: format and offset of its length, and offset of the inner
link type, which is IEEE 802.11 if there is no such field."""
_LINK_TYPES = frozenset(
    {*_ETHERTYPE_AT, *_BARE_IP_AT, *_PPP_AT, *_WRAPPED, pcap.DLT_IEEE802_11, pcap.DLT_NFLOG}
)
_NFLOG_PAYLOAD = 9

_LLC = (0x0001, 0x0004)  # 802.3 and 802.2 in the place of an EtherType of SLL
_SMALLEST_ETHERTYPE = 0x0600
_EXTENSIONS6 = (IP_PROTO_HOPOPTS, IP_PROTO_ROUTING, IP_PROTO_DSTOPTS, IP_PROTO_AH, IP_PROTO_FRAGMENT)
"""Headers that may stand in front of the payload of IPv6 (RFC 8200)."""
_VXLAN = (4789).to_bytes(2)  # UDP ports of RFC 7348 and RFC 8926
_GENEVE = (6081).to_bytes(2)
# EtherTypes of mirrored traffic in GRE (draft-foschiano-erspan)
_ERSPAN = 0x88BE
_ERSPAN_3 = 0x22EB
_MOST_LAYERS = 8
_INCOMPLETE = 64  # greatest number of incomplete datagrams kept
_NO_FRAGMENTS = "datagrams whose other IP fragments are missing (capture with `udp or ip[6:2] & 0x1fff != 0`)"


class Ip(NamedTuple):
    """An IP packet in a frame."""

    at: int  # offset of its header in the frame
    body: int  # offset of its content, after header and extensions
    end: int  # offset of its end by its own length; padding follows
    protocol: int
    fragment: int  # offset in the datagram, bytes
    more: bool  # more fragments follow
    key: bytes  # addresses, identification and protocol, the same for all fragments of a datagram


class Unwrapper:
    """Finder of UDP in the frames of one capture, which joins IP fragments (RFC 791, section 3.2)."""

    def __init__(self) -> None:
        self._held = dict[bytes, dict[int, tuple[bytes, Ip]]]()
        self._dropped = 0
        self._unread = Counter[str]()

    @property
    def missed(self) -> Counter[str]:
        """Frames and datagrams that could not be read so far, by cause."""
        return self._unread + Counter({_NO_FRAGMENTS: self._dropped + len(self._held)})

    def udp_in(self, link_type: int, frame: bytes) -> tuple[bytes, int, int] | None:
        """Return a frame with a whole datagram, and the offsets of its IP and UDP headers.

        It is None if `frame` completes no datagram.
        """
        if link_type not in _LINK_TYPES:
            self._unread[f"frames of link type {link_type}, which is not read"] += 1
            return None
        ip = _ip_in(link_type, frame)
        if ip is None or ip.protocol != IP_PROTO_UDP:
            return None
        if ip.fragment or ip.more:
            return self._joined(frame, ip)
        return frame, ip.at, ip.body

    def _joined(self, frame: bytes, ip: Ip) -> tuple[bytes, int, int] | None:
        """Return the frame of the first fragment with the bytes of all fragments.

        It is there when the last fragment has arrived.
        """
        held = self._held.setdefault(ip.key, {})
        held[ip.fragment] = frame, ip
        parts = list[bytes]()
        at = 0
        while at in held:
            part, ip = held[at]
            parts.append(part[ip.body : ip.end])
            if not ip.more:
                del self._held[ip.key]
                first, begin = held[0]
                return first[: begin.body] + b"".join(parts), begin.at, begin.body
            if not parts[-1]:
                break
            at += len(parts[-1])
        if len(self._held) > _INCOMPLETE:
            del self._held[next(iter(self._held))]
            self._dropped += 1
        return None


def _ip_in(link_type: int, frame: bytes) -> Ip | None:
    """Find the innermost IP packet; None if there is none with complete headers."""
    begin = 0
    if link_type in _WRAPPED:  # a header with its own length, and perhaps an inner link type
        form, length_at, kind_at = _WRAPPED[link_type]
        try:
            (begin,) = struct.unpack_from(form, frame, length_at)
            link_type = (
                pcap.DLT_IEEE802_11 if kind_at is None else struct.unpack_from("<I", frame, kind_at)[0]
            )
        except struct.error:
            return None
    if link_type in _ETHERTYPE_AT:
        kind_at, body = _ETHERTYPE_AT[link_type]
        kind = int.from_bytes(frame[begin + kind_at : begin + kind_at + 2])
        at: int | None = _ip_after(frame, kind, begin + body)
    elif link_type in _BARE_IP_AT:
        at = begin + _BARE_IP_AT[link_type]
    elif link_type in _PPP_AT:
        at = _behind_ppp(frame, begin + _PPP_AT[link_type])
    elif link_type == pcap.DLT_IEEE802_11:
        at = _ip_in_wifi(frame, begin)
    elif link_type == pcap.DLT_NFLOG:
        at = _ip_in_nflog(frame)
    else:
        return None
    ip = None
    for _ in range(_MOST_LAYERS):
        found = None if at is None else _ip_at(frame, at)
        if found is None:
            break
        ip = found
        at = _ip_in_tunnel(frame, ip)
    return ip


def _ip_in_wifi(frame: bytes, at: int) -> int | None:
    """Find the IP header in a data frame of IEEE 802.11 that is not encrypted."""
    kind = frame[at : at + 1]
    flags = frame[at + 1 : at + 2]
    if not flags or kind[0] & 0x4C != 0x08 or flags[0] & 0x40:
        return None
    quality = bool(kind[0] & 0x80)
    at += 24 + 6 * (flags[0] & 3 == 3) + 2 * quality + 4 * (quality and flags[0] >> 7)
    return _ip_after(frame, 0, at)


def _ip_in_nflog(frame: bytes) -> int | None:
    """Find the packet in the fields of the netfilter log of Linux."""
    at = 4
    while at + 4 <= len(frame):
        length, kind = struct.unpack_from("<2H", frame, at)
        if kind == _NFLOG_PAYLOAD:
            return at + 4
        at += max(-(-length // 4) * 4, 4)
    return None


def _ip_after(frame: bytes, kind: int, at: int) -> int | None:
    """Find the IP header after an EtherType whose content begins at `at`."""
    for _ in range(_MOST_LAYERS):
        if kind in (ETH_TYPE_IP, ETH_TYPE_IP6):
            return at
        if kind in (ETH_TYPE_8021Q, ETH_TYPE_8021AD, ETH_TYPE_QINQ1):
            kind = int.from_bytes(frame[at + 2 : at + 4])
            at = at + 4
        elif kind in (ETH_TYPE_MPLS, ETH_TYPE_MPLS_MCAST):
            while at + 4 <= len(frame) and not frame[at + 2] & 1:  # the lowest label has this bit
                at += 4
            return at + 4
        elif kind == ETH_TYPE_PPPoE:
            return _behind_ppp(frame, at + 6)
        elif kind == ETH_TYPE_TEB:
            kind = int.from_bytes(frame[at + 12 : at + 14])
            at = at + 14
        elif (kind < _SMALLEST_ETHERTYPE or kind in _LLC) and frame[at : at + 3] == b"\xaa\xaa\x03":
            kind = int.from_bytes(frame[at + 6 : at + 8])
            at = at + 8
        else:
            return None
    return None


def _behind_ppp(frame: bytes, at: int) -> int | None:
    if frame[at : at + 2] == b"\xff\x03":
        at += 2
    if frame[at : at + 2] in (b"\x0f\x00", b"\x8f\x00"):  # Cisco HDLC instead
        return _ip_after(frame, int.from_bytes(frame[at + 2 : at + 4]), at + 4)
    short = frame[at : at + 1] in (b"\x21", b"\x57")  # RFC 1661, section 6.5: the protocol in one byte
    kind = int.from_bytes(frame[at : at + 2 - short])
    return at + 2 - short if kind in (PPP_IP, PPP_IP6) else None


def _ip_at(frame: bytes, at: int) -> Ip | None:
    version = frame[at] >> 4 if at < len(frame) else 0
    if version == 4 and len(frame) >= at + 20:  # RFC 791
        body = at + 4 * (frame[at] & 0x0F)
        words = int.from_bytes(frame[at + 6 : at + 8])
        end = at + int.from_bytes(frame[at + 2 : at + 4])
        end = end if end > at else len(frame)  # 0 if the network card segments the datagram
        if body < at + 20:
            return None
        protocol = frame[at + 9]
        fragment = (words & 0x1FFF) * 8
        key = frame[at + 12 : at + 20] + frame[at + 4 : at + 6] + frame[at + 9 : at + 10]
        return Ip(at, body, end, protocol, fragment, bool(words & 0x2000), key)
    return _ip6_at(frame, at) if version == 6 and len(frame) >= at + 40 else None  # RFC 8200


def _ip6_at(frame: bytes, at: int) -> Ip | None:
    protocol = frame[at + 6]
    body = at + 40
    fragment = 0
    more = False
    end = body + int.from_bytes(frame[at + 4 : at + 6])
    key = frame[at + 8 : at + 40]
    while protocol in _EXTENSIONS6 and body + 8 <= len(frame):
        before = protocol
        protocol = frame[body]
        size = frame[body + 1]
        if before == IP_PROTO_FRAGMENT:
            words = int.from_bytes(frame[body + 2 : body + 4])
            fragment = words & 0xFFF8
            more = bool(words & 1)
            key = key + frame[body + 4 : body + 8]
        body += (
            8 if before == IP_PROTO_FRAGMENT else (size + 2) * 4 if before == IP_PROTO_AH else (size + 1) * 8
        )
        if fragment:
            break
    return Ip(at, body, end, protocol, fragment, more, key)


def _ip_in_tunnel(frame: bytes, ip: Ip) -> int | None:
    at = ip.body
    if ip.fragment or ip.more:
        return None
    if ip.protocol in (IP_PROTO_IPIP, IP_PROTO_IP6):
        return at
    if ip.protocol == IP_PROTO_GRE and at + 4 <= len(frame):
        flags = frame[at]
        kind = int.from_bytes(frame[at + 2 : at + 4])
        at += 4 + 4 * sum(bool(flags & bit) for bit in (0x80, 0x20, 0x10))
        if kind == _ERSPAN:
            at = at + 8 * bool(flags & 0x10)  # type I has neither a number nor a header
            kind = ETH_TYPE_TEB
        elif kind == _ERSPAN_3:
            at = at + 12 + 8 * (at + 12 <= len(frame) and frame[at + 11] & 1)
            kind = ETH_TYPE_TEB
        return _ip_after(frame, kind, at)
    port = frame[at + 2 : at + 4] if ip.protocol == IP_PROTO_UDP else b""
    if port == _VXLAN:
        return _ip_after(frame, ETH_TYPE_TEB, at + 16)
    if port == _GENEVE and at + 16 <= len(frame):
        return _ip_after(
            frame, int.from_bytes(frame[at + 10 : at + 12]), at + 16 + 4 * (frame[at + 8] & 0x3F)
        )
    return None
