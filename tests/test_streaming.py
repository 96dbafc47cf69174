"""The engine of a stream."""

from collections import Counter

import pytest

from vlp16emu import Emulator
from vlp16emu.run.feed import PacketFeed
from vlp16emu.scenario import load


@pytest.mark.parametrize(
    ("settings", "ahead_s"), [([], 0.4), (["sensor.return_mode=dual", "rig=[{}]"], 0.4), ([], 1000.0)]
)
def test_what_is_left_out_is_counted_and_the_rest_stays(each_unit, settings, ahead_s):
    """Sent ahead, the engine gives exactly the packets before and after, none beyond the end, and counts
    those between."""
    emulator = Emulator(load(each_unit, settings), threads=1)
    whole = list(emulator.packets(0.0, 1.0))
    engine, got = PacketFeed(emulator.engine, 0.0, 1.0), []
    for packet in engine:
        got.append(packet)
        if len(got) == 200:
            from_ns = packet.due_ns + round(ahead_s * 1e9)
            engine.go_on_from(from_ns)
    assert got == whole[:200] + [packet for packet in whole if packet.due_ns >= from_ns]
    kinds = Counter(packet.kind for packet in whole)
    assert engine.skipped == kinds - Counter(packet.kind for packet in got)
