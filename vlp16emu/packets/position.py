"""Position packets: the 512 bytes with GPS state and sentence, and their send times.

Measurements on a real unit (57 packets in 0.38 s, January 2016, 600 rpm, strongest return): the
packets come from two timers. One ticks every 10.00 ms, the other every 16 data packets of single
return, 21.234 ms; the packets scatter by 0.1 to 0.3 ms around either. If ticks are close,
the second packet waits until 1.85 ms after the first (never less than 1.47 ms), and if they
coincide only one packet is sent. This gives intervals of about 1.8, 9 and 9.8 ms, with a mean of 6.86 ms
and a standard deviation of 3.17 ms. Here the first timer ticks 70 times in 33 ticks of the second, every
10.010 ms, so that the pattern repeats after 102 packets and 0.7007 s: 145.57 packets per second.
"""

import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vlp16emu.errors import InputError
from vlp16emu.packets.data import timestamp_us
from vlp16emu.packets.layout import POSITION_BYTES, POSITION_PAYLOAD, SENTENCE_BYTES, SEQUENCES_PER_PACKET
from vlp16emu.random import Purpose, uniform
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import I8, PpsState, ReturnMode
from vlp16emu.units import US_NS

PositionRate = Literal["measured", "manual"]
"""Rate of position packets: 146 per second with the spacing of real units, or the manual's 53.8."""

STAMP_LEAD_NS = 350 * US_NS
"""Time between the stamp of a position packet, on the sensor's clock, and its sending.

Measured on the same unit: the median delay from stamp to arrival is 0.979 ms less than for data packets,
which is 1.327 ms from the first firing to the end of the packet.
"""

_TIMESTAMP_US = struct.Struct("<I")
_AT = {name: field[1] for name, field in (POSITION_PAYLOAD.fields or {}).items()}
_DATA_PERIOD_NS = SEQUENCES_PER_PACKET[ReturnMode.STRONGEST] * SEQUENCE_NS


@dataclass(frozen=True, slots=True)
class _Schedule:
    """Periodic instants, with each packet late by a random part of `jitter_ns`."""

    pattern_ns: I8
    cycle_ns: int
    jitter_ns: int


def _two_timers() -> _Schedule:
    """Merge the two timers of the real unit over one cycle."""
    cycle_ns = 33 * 16 * _DATA_PERIOD_NS
    timer_ns = np.arange(70) * cycle_ns // 70
    every_16_ns = np.arange(1, 33) * 16 * _DATA_PERIOD_NS  # tick 0 coincides with the timer's
    pattern_ns = np.sort(np.concatenate([timer_ns, every_16_ns]))
    for i in range(1, len(pattern_ns)):
        pattern_ns[i] = max(pattern_ns[i], pattern_ns[i - 1] + 1_850 * US_NS)
    # Twice 0.19 ms of scatter keeps 1.47 ms between packets that wait for each other.
    return _Schedule(pattern_ns, cycle_ns, 380 * US_NS)


_SCHEDULES: dict[PositionRate, _Schedule] = {
    "measured": _two_timers(),
    # One per 14 data packets of single return: 63-9243 Rev D, section 8.2.2, p. 50.
    "manual": _Schedule(np.zeros(1, np.int64), 14 * _DATA_PERIOD_NS, 0),
}


def positions_from_ns(rate: PositionRate, start_ns: int, phase: float) -> int:
    """Return the instant from which position packets are counted.

    At `start_ns`, `phase` of their pattern has passed.
    """
    return start_ns - int(phase * _SCHEDULES[rate].cycle_ns)


def position_due_ns(rate: PositionRate, seed: int, start_ns: int, first: int, count: int) -> I8:
    """Return the send times (count,) of position packets in UTC ns, in any return mode.

    They increase from `start_ns` on, where the count of packets begins; `first` is the number of the first
    packet, from 0. Source: 63-9243 Rev D, section 8.2.3.
    """
    schedule = _SCHEDULES[rate]
    cycle, place = np.divmod(np.arange(first, first + count), len(schedule.pattern_ns))
    late = uniform(seed, Purpose.POSITION_PACKET, first, count) * schedule.jitter_ns
    return start_ns + cycle * schedule.cycle_ns + schedule.pattern_ns[place] + late.astype(np.int64)


def first_position_packet(rate: PositionRate, seed: int, start_ns: int, t_ns: int) -> int:
    """Find the first position packet that is sent at or after `t_ns` UTC.

    Other parameters as in `position_due_ns`.
    """
    schedule = _SCHEDULES[rate]
    # With any jitter, a packet planned before this instant is sent before t_ns.
    cycle, rest_ns = divmod(t_ns - start_ns - schedule.jitter_ns, schedule.cycle_ns)
    place = int(np.searchsorted(schedule.pattern_ns, rest_ns))
    number = max(0, cycle * len(schedule.pattern_ns) + place)
    return number + int(position_due_ns(rate, seed, start_ns, number, 1)[0] < t_ns)


def pack_position(clock_ns: int, pps: PpsState, sentence: bytes) -> bytes:
    """Write one position packet; fields that firmware of 2016 leaves zero are zero.

    Parameters
    ----------
    clock_ns : the sensor's clock `STAMP_LEAD_NS` before the packet is sent; whole hours are dropped
    pps : state of the pulse-per-second input
    sentence : last received NMEA sentence, with CR LF; empty if none was received

    Raises InputError for a sentence longer than 128 bytes, not ASCII, or without CR LF at its end.
    """
    if len(sentence) > SENTENCE_BYTES:
        raise InputError("pack_position: sentence", f"{len(sentence)} bytes", f"at most {SENTENCE_BYTES}")
    if sentence and not (sentence.isascii() and sentence.endswith(b"\r\n") and b"\0" not in sentence):
        raise InputError("pack_position: sentence", repr(sentence), "ASCII that ends with CR LF")
    packet = bytearray(POSITION_BYTES)
    _TIMESTAMP_US.pack_into(packet, _AT["timestamp_us"], timestamp_us(clock_ns))
    packet[_AT["pps"]] = pps
    packet[_AT["sentence"] : _AT["sentence"] + len(sentence)] = sentence
    return bytes(packet)
