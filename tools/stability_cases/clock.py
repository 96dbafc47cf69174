"""A day of packets, looked into wherever something rolls over."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from stability_cases.row import Row
from vlp16emu import Emulator
from vlp16emu.packets import STAMP_LEAD_NS, data_fields, decode_position
from vlp16emu.scenario import Scenario, load
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_SPAN_NS = 8_000_000
"""Of each look: six data packets, and a position packet at least."""
_PERIOD_NS = 24 * 55_296
"""Of data packets in single return (63-9243 Rev D, section 8.1)."""
_BLOCK_NS = 2 * 55_296
_LOOKS = {
    "24 h from 31 December 2027": ("2027-12-31T11:59:59.123457Z", range(24), range(1, 9)),
    "leap day of 2028": ("2028-02-28T23:03:04.999999Z", (0, 24), ()),
}
"""By case: start, which full hours after it, and at which multiples of an odd span besides."""
_ODD_NS = 10_007 * S_NS + 77


def _looks_ns(start_ns: int, hours: Sequence[int], odd: Sequence[int]) -> list[int]:
    """List times since the start: the start itself, shortly before full hours, and some in between."""
    first_ns = -start_ns % HOUR_NS - _SPAN_NS // 2
    return sorted([0, *(first_ns + hour * HOUR_NS for hour in hours), *(n * _ODD_NS for n in odd)])


def _data_errors(scenario: Scenario, packets: list[Packet]) -> tuple[int, int, int]:
    """How many data packets leave at a wrong nanosecond, have a wrong stamp, or a wrong azimuth in a block.

    By whole numbers: from 0 on at 600 rpm the head turns by 36 hundredths of a degree in 100 us.
    """
    due_ns = np.array([packet.due_ns for packet in packets])
    fields = data_fields(np.frombuffer(b"".join(p.payload for p in packets), np.uint8).reshape(len(packets), -1))
    since_ns = due_ns - scenario.start_ns
    stamps = np.array([(due - _PERIOD_NS) % HOUR_NS // US_NS for due in due_ns.tolist()])
    fired_ns = since_ns[:, None] - _PERIOD_NS + _BLOCK_NS * np.arange(12)
    azimuth = fired_ns * 36 // 100_000 % 36_000
    wrong = (fields["blocks"]["azimuth_cdeg"] != azimuth).any(axis=1)
    return (int((since_ns % _PERIOD_NS != 0).sum()), int((fields["timestamp_us"] != stamps).sum()), int(wrong.sum()))


def _named(sentence: bytes) -> datetime:
    words = sentence.decode("ascii").split(",")
    return datetime.strptime(f"{words[9]} {words[1]}", "%d%m%y %H%M%S.%f").replace(tzinfo=UTC)


def _position_errors(scenario: Scenario, packets: list[Packet]) -> tuple[int, int]:
    """How many position packets have a wrong stamp, or a sentence of another second than the one last reported."""
    stamps = sentences = 0
    for packet in packets:
        reported, stamp_ns = decode_position(packet.payload), packet.due_ns - STAMP_LEAD_NS
        stamps += reported.time_ns != stamp_ns % HOUR_NS // US_NS * US_NS
        delay_ns = round(scenario.gps.sentence_delay_s * S_NS)
        whole_s = (stamp_ns - delay_ns) // S_NS
        sentences += _named(reported.sentence) != datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=whole_s)
    return stamps, sentences


def day() -> Iterator[Row]:
    """Look into 24 hours from the end of a year on, and into a leap day."""
    for name, (start, hours, odd) in _LOOKS.items():
        settings = "gps.connected=true", "sensor.start_azimuth_deg=0", f"start_utc={start}"
        scenario = load("static_bench", settings)
        emulator = Emulator(scenario)
        packets = [
            packet
            for since_ns in _looks_ns(scenario.start_ns, hours, odd)
            for packet in emulator.packets(since_ns / S_NS, (since_ns + _SPAN_NS) / S_NS)
        ]
        data = [packet for packet in packets if packet.kind is PacketKind.DATA]
        others = [packet for packet in packets if packet.kind is PacketKind.POSITION]
        due, stamp, azimuth = _data_errors(scenario, data)
        case = f"{name}, {len(data)} data packets"
        yield Row(case, "due off its nanosecond", due, 0)
        yield Row(case, "stamp off its microsecond", stamp, 0)
        yield Row(case, "azimuth off its hundredth", azimuth, 0)
        stamp, sentence = _position_errors(scenario, others)
        case = f"{name}, {len(others)} position packets"
        yield Row(case, "stamp off its microsecond", stamp, 0)
        yield Row(case, "$GPRMC of another second", sentence, 0)
