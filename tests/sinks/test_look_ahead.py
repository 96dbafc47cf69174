"""Packets that are computed ahead."""

import itertools
import threading

import pytest
from sinks.kit import PERIOD_NS

from vlp16emu.sinks import LookAhead
from vlp16emu.types import Packet, PacketKind


def endless(made):
    """Make packets without end, and count them in a list."""
    for i in itertools.count():
        made.append(i)
        yield Packet(PacketKind.DATA, i * PERIOD_NS, b"")


def test_look_ahead_is_bounded():
    """The thread computes the buffer and one packet more, then waits until one is taken."""
    made = []
    with LookAhead(endless(made), 10, threading.Event()) as ahead:
        ahead.fill()
        first = ahead.take()
        ahead.fill()
        ahead.fill()
        assert first.due_ns == 0
        assert len(made) <= 12


class Numbered:
    """Packets that carry the number of a generation, which begin again on demand."""

    def __init__(self, count):
        self.count, self.next, self.generation = count, 0, 0

    def __iter__(self):
        return self

    def __next__(self):
        if self.next == self.count:
            raise StopIteration
        self.next += 1
        return Packet(PacketKind.DATA, (self.next - 1) * PERIOD_NS, bytes([self.generation]))

    def restart(self, due_ns):
        """Go on from a time, or from where they are if that is earlier."""
        self.next, self.generation = min(self.next, -(-due_ns // PERIOD_NS)), self.generation + 1


@pytest.mark.parametrize("capacity", [8, 64, 500])
@pytest.mark.parametrize("cuts", [[40], [40, 40], [90, 60], [60, 90], [299]])
def test_what_is_made_anew_follows_what_is_sent_without_a_gap(cuts, capacity):
    """From each cut on packets are of a later generation; none is lost, none comes twice, also where all
    had been computed."""
    packets, stop = Numbered(300), threading.Event()
    with LookAhead(packets, capacity, stop) as ahead:
        ahead.fill()
        taken = []
        while len(taken) < 30:
            taken.append(ahead.take())
        for cut in cuts:
            ahead.redo(cut * PERIOD_NS, packets.restart)
        while (packet := ahead.take()) is not None:
            taken.append(packet)
    assert [packet.due_ns for packet in taken] == [i * PERIOD_NS for i in range(300)]
    generations = [packet.payload[0] for packet in taken]
    assert generations == sorted(generations)
    assert set(generations[:30]) == {0}
    assert min(generations[max(cuts) :]) > 0
