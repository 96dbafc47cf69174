"""Time stamps and sentences of packets, moved by whole seconds, so that everything between two seconds stays as it is."""

import re
import struct
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np

from vlp16emu.packets.imu import moved_imu
from vlp16emu.packets.layout import (
    DATA_PAYLOAD,
    POSITION_BYTES,
    POSITION_PAYLOAD,
    RETURN_MODE_BYTE,
    SENTENCE_BYTES,
    SEQUENCES_PER_PACKET,
)
from vlp16emu.packets.position import STAMP_LEAD_NS
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import Packet, PacketKind, PpsState, ReturnMode
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_STAMP = struct.Struct("<I")
_RMC = re.compile(
    rb"\$(?P<kind>G[A-Z]RMC),(?P<time>\d{6})(?P<decimals>(?:\.\d*)?)"
    rb",(?P<place>(?:[^,*]*,){7})(?P<date>\d{6})(?P<rest>,[^*]*)\*[0-9A-Fa-f]{2}"
)


def _offset(payload: np.dtype[np.void], field: str) -> int:
    assert payload.fields is not None
    return payload.fields[field][1]


_STAMP_AT = {
    PacketKind.DATA: _offset(DATA_PAYLOAD, "timestamp_us"),
    PacketKind.POSITION: _offset(POSITION_PAYLOAD, "timestamp_us"),
}
_PPS_AT = _offset(POSITION_PAYLOAD, "pps")
_MODE_AT = _offset(DATA_PAYLOAD, "return_mode")
_DUAL = bytes([RETURN_MODE_BYTE[ReturnMode.DUAL]])
_SENTENCE = slice(_offset(POSITION_PAYLOAD, "sentence"), _offset(POSITION_PAYLOAD, "unused_tail"))


def has_stamp(packet: Packet) -> bool:
    """Return whether a packet is long enough to hold its time stamp; one that is cut may not be."""
    return packet.kind in _STAMP_AT and len(packet.payload) >= _STAMP_AT[packet.kind] + _STAMP.size


def stamp_ns(packet: Packet) -> int:
    """Time stamp of a data or position packet, ns past the hour of the sensor's clock; of other packets ns past the hour of UTC."""
    if packet.kind not in _STAMP_AT:
        return packet.due_ns % HOUR_NS
    (stamp_us,) = _STAMP.unpack_from(packet.payload, _STAMP_AT[packet.kind])
    return int(stamp_us) * US_NS


def age_ns(packet: Packet) -> int:
    """Time from the stamp of a packet to its sending: of a data packet how long it takes to fill."""
    if packet.kind is not PacketKind.DATA:
        return STAMP_LEAD_NS if packet.kind is PacketKind.POSITION else 0
    is_dual = packet.payload[_MODE_AT:].startswith(_DUAL)
    return SEQUENCES_PER_PACKET[ReturnMode.DUAL if is_dual else ReturnMode.STRONGEST] * SEQUENCE_NS


def moved(packet: Packet, by_s: int, now_ns: int | None = None) -> Packet:
    """Move the stamp of a packet, and the time and date of its sentence, where it has them.

    Parameters
    ----------
    by_s : whole seconds, of either sign
    now_ns : UTC at which the packet is sent, where the date of the sentence may be another one than that of the
        capture: then the sentence is moved by whole hours too, to that hour
    """
    if packet.kind is PacketKind.PPS:
        return packet
    if packet.kind is PacketKind.NMEA:
        return replace(packet, payload=_moved_sentence(packet.payload, by_s, now_ns))
    if packet.kind is PacketKind.IMU:
        return replace(packet, payload=moved_imu(packet.payload, by_s))
    if not has_stamp(packet):
        return packet
    at, payload = _STAMP_AT[packet.kind], bytearray(packet.payload)
    _STAMP.pack_into(payload, at, (stamp_ns(packet) + by_s * S_NS) % HOUR_NS // US_NS)
    if packet.kind is PacketKind.POSITION:
        sentence = _moved_sentence(bytes(payload[_SENTENCE]), by_s, now_ns)
        payload[_SENTENCE] = sentence
    return replace(packet, payload=bytes(payload))


def restamped(packet: Packet, clock_ns: int, pps: PpsState, sentence: bytes) -> Packet:
    """Give a packet what another clock shows, and a position packet the state and sentence of another receiver too.

    Parameters
    ----------
    clock_ns : at the instant of the packet's stamp, ns past the hour
    sentence : with CR LF; its first 128 bytes are taken, empty for none
    """
    if not has_stamp(packet):
        return packet
    payload = bytearray(packet.payload)
    _STAMP.pack_into(payload, _STAMP_AT[packet.kind], clock_ns % HOUR_NS // US_NS)
    if packet.kind is PacketKind.POSITION:
        payload += bytes(POSITION_BYTES - len(payload))
        payload[_PPS_AT] = pps
        payload[_SENTENCE] = sentence[:SENTENCE_BYTES].ljust(SENTENCE_BYTES, b"\0")
    return replace(packet, payload=bytes(payload[: len(packet.payload)]))


def _moved_sentence(field: bytes, by_s: int, now_ns: int | None) -> bytes:
    """Move a sentence in its field; what is no RMC sentence with time and date stays."""
    found = _RMC.match(field)
    if found is None:
        return field
    try:
        utc = datetime.strptime((found["date"] + found["time"]).decode(), "%d%m%y%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        return field
    utc += timedelta(seconds=by_s)
    if now_ns is not None:
        utc += timedelta(hours=round((now_ns / S_NS - utc.timestamp()) / 3600))
    body = b"%b,%b%b,%b%b%b" % (
        found["kind"],
        f"{utc:%H%M%S}".encode(),
        found["decimals"],
        found["place"],
        f"{utc:%d%m%y}".encode(),
        found["rest"],
    )
    checksum = 0
    for byte in body:
        checksum ^= byte
    return b"$%b*%02X%b" % (body, checksum, field[found.end() :])
