"""A day of packets, looked into wherever something rolls over."""

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.packets import STAMP_LEAD_NS, data_fields, decode_position
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_SPAN_NS = 8_000_000  # of each look: six data packets, and a position packet at least
_PERIOD_NS = 24 * 55_296  # of data packets in single return (63-9243 Rev D, section 8.1)
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


def _named(sentence: bytes) -> datetime:
    words = sentence.decode("ascii").split(",")
    return datetime.strptime(f"{words[9]} {words[1]}", "%d%m%y %H%M%S.%f").replace(tzinfo=UTC)


@pytest.mark.parametrize(("start", "hours", "odd"), _LOOKS.values(), ids=_LOOKS)
def test_a_day(start, hours, odd):
    """Packets leave at their nanosecond with the right stamp and azimuth, and the sentence is that of the second last reported.

    By whole numbers: from 0 on at 600 rpm the head turns by 36 hundredths of a degree in 100 us.
    """
    settings = "gps.connected=true", "sensor.start_azimuth_deg=0", f"start_utc={start}"
    scenario = load("static_bench", settings)
    emulator = Emulator(scenario)
    packets = [
        packet
        for since_ns in _looks_ns(scenario.start_ns, hours, odd)
        for packet in emulator.packets(since_ns / S_NS, (since_ns + _SPAN_NS) / S_NS)
    ]
    data = [packet for packet in packets if packet.kind is PacketKind.DATA]
    due_ns = np.array([packet.due_ns for packet in data])
    fields = data_fields(np.frombuffer(b"".join(p.payload for p in data), np.uint8).reshape(len(data), -1))
    fired_ns = due_ns - scenario.start_ns - _PERIOD_NS
    assert not (fired_ns % _PERIOD_NS).any()
    assert fields["timestamp_us"].tolist() == [(due - _PERIOD_NS) % HOUR_NS // US_NS for due in due_ns.tolist()]
    azimuth = (fired_ns[:, None] + _BLOCK_NS * np.arange(12)) * 36 // 100_000 % 36_000
    np.testing.assert_array_equal(fields["blocks"]["azimuth_cdeg"], azimuth)
    delay_ns = round(scenario.gps.sentence_delay_s * S_NS)
    for packet in (packet for packet in packets if packet.kind is PacketKind.POSITION):
        reported, stamp_ns = decode_position(packet.payload), packet.due_ns - STAMP_LEAD_NS
        assert reported.time_ns == stamp_ns % HOUR_NS // US_NS * US_NS
        assert _named(reported.sentence) == datetime.fromtimestamp((stamp_ns - delay_ns) // S_NS, UTC)
