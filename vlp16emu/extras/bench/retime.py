"""Packets moved in time: stamps and sentences change by whole seconds, so fractions of a second stay."""

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

from vlp16emu.extras.bench.imu_frame import shift_imu_frame
from vlp16emu.packets import layout
from vlp16emu.packets.position import STAMP_LEAD_NS
from vlp16emu.sinks import Pacer
from vlp16emu.types import Packet, PacketKind, PpsState
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
_SENTENCE = slice(
    _offset(layout.POSITION_PAYLOAD, "sentence"), _offset(layout.POSITION_PAYLOAD, "unused_tail")
)


def has_stamp(packet: Packet) -> bool:
    """Return True if a packet is long enough to have its time stamp; a truncated packet may not be."""
    return packet.kind in _STAMP_AT and len(packet.payload) >= _STAMP_AT[packet.kind] + _STAMP.size


def stamp_ns(packet: Packet) -> int:
    """Return the time stamp of a data or position packet, in ns past the hour of the sensor's clock.

    Of other packets it is the due time, in ns past the hour of UTC.
    """
    if packet.kind not in _STAMP_AT:
        return packet.due_ns % HOUR_NS
    (stamp_us,) = _STAMP.unpack_from(packet.payload, _STAMP_AT[packet.kind])
    return int(stamp_us) * US_NS


def age_ns(packet: Packet) -> int:
    """Return the time from the stamp of a packet to its sending: for a data packet the time to fill it."""
    if packet.kind is not PacketKind.DATA:
        return STAMP_LEAD_NS if packet.kind is PacketKind.POSITION else 0
    factory = packet.payload[_MODE_AT:] or b"\0"  # a truncated packet has none, or no product
    return layout.layout_of_bytes(factory[0], factory[-1]).age_ns


def shift_packet(packet: Packet, by_s: int, now_ns: int | None = None) -> Packet:
    """Return a packet with its stamp, and the time and date of its sentence if it has them, moved.

    Parameters
    ----------
    by_s : whole seconds, of either sign
    now_ns : UTC at which the packet is sent, if the date of the sentence may differ from the date of the
        capture: then the sentence is also moved by whole hours, to the hour of `now_ns`
    """
    payload = bytearray(packet.payload)
    if packet.kind is PacketKind.NMEA:
        payload[:] = _shift_sentence(packet.payload, by_s, now_ns)
    elif packet.kind is PacketKind.IMU:
        payload[:] = shift_imu_frame(packet.payload, by_s)
    elif has_stamp(packet):
        stamp_us = (stamp_ns(packet) + by_s * S_NS) % HOUR_NS // US_NS
        _STAMP.pack_into(payload, _STAMP_AT[packet.kind], stamp_us)
        if packet.kind is PacketKind.POSITION:
            payload[_SENTENCE] = _shift_sentence(packet.payload[_SENTENCE], by_s, now_ns)
    return replace(packet, payload=bytes(payload))


def restamp(packet: Packet, clock_ns: int, pps: PpsState, sentence: bytes) -> Packet:
    """Return a packet with the stamp of another clock.

    A position packet also gets the state and sentence of another receiver.

    Parameters
    ----------
    clock_ns : clock at the instant of the packet's stamp, ns past the hour
    sentence : sentence with CR LF, cut to its first 128 bytes; empty for none
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


def _shift_sentence(field: bytes, by_s: int, now_ns: int | None) -> bytes:
    """Return the field of a sentence, in which an RMC sentence with time and date is moved; others stay."""
    match = _RMC.match(field)
    if match is None:
        return field
    try:
        utc = datetime.strptime((match["date"] + match["time"]).decode(), "%d%m%y%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        return field
    utc += timedelta(seconds=by_s)
    if now_ns is not None:
        utc += timedelta(hours=round((now_ns / S_NS - utc.timestamp()) / 3600))
    time_of_day = f"{utc:%H%M%S}".encode()
    date = f"{utc:%d%m%y}".encode()
    body = b"%b,%b%b,%b%b%b" % (
        match["kind"],
        time_of_day,
        match["decimals"],
        match["place"],
        date,
        match["rest"],
    )
    return b"$%b*%02X%b" % (body, reduce(xor, body), field[match.end() :])


class Present:
    """Shift of packets by whole seconds to the present of the system's clock.

    Intervals between pulses of the receiver, sentences and stamps do not change. The stream begins at the
    instant with the first packet's fraction of a second: it waits for less than a second.

    Parameters
    ----------
    clock_ns : clock of the system, UTC
    """

    def __init__(self, *, clock_ns: Callable[[], int] = time.time_ns) -> None:
        self._clock_ns = clock_ns
        self._ahead_ns = 0
        self.moved_s = 0
        """Whole seconds from the time of the packets to the present; set when the first packet leaves."""

    def start(self, first: Packet, pacer: Pacer, stop: Event) -> None:
        """Start the clock of a stream; wait for the instant at which the first packet leaves, or for `stop`.

        A clock that already runs, as in a live run, is joined.
        """
        stamped_ns = self._stamped_ns(first)
        if pacer.first_due_ns is None:
            now_ns = self._clock_ns()
            at_ns = now_ns + (stamped_ns - now_ns) % S_NS
            stop.wait((at_ns - now_ns) / S_NS)
            pacer.begin(first.due_ns, self._clock_ns() - at_ns)
        else:
            due_ns = self._clock_ns() + pacer.deadline_ns(first.due_ns) - pacer.now_ns()
            at_ns = stamped_ns + round((due_ns - stamped_ns) / S_NS) * S_NS
        self.moved_s = (at_ns - stamped_ns) // S_NS
        self._ahead_ns = at_ns - first.due_ns

    def shift(self, packet: Packet) -> Packet:
        """Return a packet moved to the present."""
        return shift_packet(packet, self.moved_s, self.utc_ns(packet.due_ns))

    def utc_ns(self, due_ns: int) -> int:
        """Return the UTC by the sensor's clock at which a packet with a due time leaves."""
        return due_ns + self._ahead_ns

    def _stamped_ns(self, first: Packet) -> int:
        """Return the UTC at which a packet leaves by its own stamp, or its due time if it has none."""
        if not has_stamp(first):
            return first.due_ns
        shift_packet(first, 0, first.due_ns)  # the first call loads Python's parser of dates, 3 ms
        past_hour_ns = stamp_ns(first) + age_ns(first)
        hour_ns = (first.due_ns - past_hour_ns + HOUR_NS // 2) // HOUR_NS * HOUR_NS
        return hour_ns + past_hour_ns
