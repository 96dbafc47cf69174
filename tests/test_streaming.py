"""The engine of a stream."""

from collections import Counter

import pytest

from vlp16emu import Emulator
from vlp16emu.run.stream import PacketFeed
from vlp16emu.scenario import load


@pytest.mark.parametrize("settings", [[], ["sensor.return_mode=dual", "rig=[{}]"]])
def test_what_is_left_out_is_counted_and_the_rest_stays(settings):
    """Sent ahead by 0.4 s, the engine gives exactly the packets before and after, and counts those between."""
    emulator = Emulator(load("static_bench", settings), threads=1)
    whole = list(emulator.packets(0.0, 1.0))
    engine, got = PacketFeed(emulator.engine, 0.0, 1.0), []
    for packet in engine:
        got.append(packet)
        if len(got) == 200:
            from_ns = packet.due_ns + 400_000_000
            engine.go_on_from(from_ns)
    assert got == whole[:200] + [packet for packet in whole if packet.due_ns >= from_ns]
    kinds = Counter(packet.kind for packet in whole)
    assert engine.skipped == kinds - Counter(packet.kind for packet in got)


def test_beyond_the_end_nothing_is_left():
    """An engine sent beyond the end of its run ends, and counts what it left out."""
    emulator = Emulator(load("static_bench"), threads=1)
    whole = sum(1 for _ in emulator.packets(0.0, 0.3))
    engine = PacketFeed(emulator.engine, 0.0, 0.3)
    last = [next(engine) for _ in range(50)][-1]
    engine.go_on_from(last.due_ns + 10**12)
    assert list(engine) == []
    assert engine.skipped.total() == whole - 50
