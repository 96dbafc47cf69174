"""Packets of another time: stamps and sentences moved by whole seconds, so that everything between two seconds stays as it is."""

import re
import struct
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor
from threading import Event

import numpy as np

from vlp16emu.extras.bench.imu_frame import moved_imu
from vlp16emu.packets import layout
from vlp16emu.packets.position import STAMP_LEAD_NS
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.sinks import PacketSink
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
    PacketKind.DATA: _offset(layout.DATA_PAYLOAD, "timestamp_us"),
    PacketKind.POSITION: _offset(layout.POSITION_PAYLOAD, "timestamp_us"),
}
_PPS_AT = _offset(layout.POSITION_PAYLOAD, "pps")
_MODE_AT = _offset(layout.DATA_PAYLOAD, "return_mode")
_DUAL = bytes([layout.RETURN_MODE_BYTE[ReturnMode.DUAL]])
_SENTENCE = slice(_offset(layout.POSITION_PAYLOAD, "sentence"), _offset(layout.POSITION_PAYLOAD, "unused_tail"))


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
    return layout.SEQUENCES_PER_PACKET[ReturnMode.DUAL if is_dual else ReturnMode.STRONGEST] * SEQUENCE_NS


def moved(packet: Packet, by_s: int, now_ns: int | None = None) -> Packet:
    """Move the stamp of a packet, and the time and date of its sentence, where it has them.

    Parameters
    ----------
    by_s : whole seconds, of either sign
    now_ns : UTC at which the packet is sent, where the date of the sentence may be another one than that of the
        capture: then the sentence is moved by whole hours too, to that hour
    """
    payload = bytearray(packet.payload)
    if packet.kind is PacketKind.NMEA:
        payload[:] = _moved_sentence(packet.payload, by_s, now_ns)
    elif packet.kind is PacketKind.IMU:
        payload[:] = moved_imu(packet.payload, by_s)
    elif has_stamp(packet):
        stamp_us = (stamp_ns(packet) + by_s * S_NS) % HOUR_NS // US_NS
        _STAMP.pack_into(payload, _STAMP_AT[packet.kind], stamp_us)
        if packet.kind is PacketKind.POSITION:
            payload[_SENTENCE] = _moved_sentence(packet.payload[_SENTENCE], by_s, now_ns)
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
        payload += bytes(layout.POSITION_BYTES - len(payload))
        payload[_PPS_AT] = pps
        payload[_SENTENCE] = sentence[: layout.SENTENCE_BYTES].ljust(layout.SENTENCE_BYTES, b"\0")
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
    clock, day = (f"{utc:{form}}".encode() for form in ("%H%M%S", "%d%m%y"))
    body = b"%b,%b%b,%b%b%b" % (found["kind"], clock, found["decimals"], found["place"], day, found["rest"])
    return b"$%b*%02X%b" % (body, reduce(xor, body), field[found.end() :])


class NowSink(PacketSink):
    """Passes packets on, moved by a whole number of seconds into the present of the system's clock.

    Because seconds stay whole, the pulses of the receiver, its sentences and the stamps stay as far apart as they were. For that
    the stream begins at the instant that has the first packet's fraction of a second: it waits for less than one.

    Parameters
    ----------
    sink : where they go
    clock_ns : UTC
    """

    def __init__(self, sink: PacketSink, *, clock_ns: Callable[[], int] = time.time_ns) -> None:
        self._sink, self._clock_ns = sink, clock_ns
        self._ahead_ns = 0
        self.moved_s = 0
        """Whole seconds from the time of the packets to the present; known when the first one leaves, as `began_ns`."""
        self.began_ns = 0  # UTC at which that is by the sensor's clock

    def begin(self, first: Packet, stop: Event) -> int:
        """Wait for the instant at which the first packet leaves, or until the stream is to stop.

        Returns
        -------
        Time since the instant, in ns; negative before it
        """
        sent_ns, now_ns = self._sent_ns(first), self._clock_ns()
        at_ns = now_ns + (sent_ns - now_ns) % S_NS
        stop.wait((at_ns - now_ns) / S_NS)
        self._start(first, sent_ns, at_ns)
        return self._clock_ns() - at_ns

    def join(self, first: Packet, left_ns: int) -> None:
        """Begin where a clock runs already, by which the first packet leaves in some time, or left some time ago."""
        sent_ns, due_ns = self._sent_ns(first), self._clock_ns() + left_ns
        self._start(first, sent_ns, sent_ns + round((due_ns - sent_ns) / S_NS) * S_NS)

    def _sent_ns(self, first: Packet) -> int:
        """Return the UTC at which a packet leaves by its own stamp, or is due without one."""
        if not has_stamp(first):
            return first.due_ns
        moved(first, 0, first.due_ns)  # Python loads what parses dates in the first one's time, 3 ms
        made_ns = stamp_ns(first)
        hour_ns = (first.due_ns - age_ns(first) - made_ns + HOUR_NS // 2) // HOUR_NS * HOUR_NS
        return hour_ns + made_ns + age_ns(first)

    def _start(self, first: Packet, sent_ns: int, at_ns: int) -> None:
        self.moved_s, self.began_ns, self._ahead_ns = (at_ns - sent_ns) // S_NS, at_ns, at_ns - first.due_ns

    def send(self, packet: Packet) -> None:
        """Send one packet; errors are the sink's."""
        self._sink.send(moved(packet, self.moved_s, packet.due_ns + self._ahead_ns))
