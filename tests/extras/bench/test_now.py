"""Packets of another time, sent as of the present."""

from threading import Event

import pytest

from vlp16emu.extras.bench.retime import Present, stamp_ns
from vlp16emu.sinks import Pacer
from vlp16emu.types import Packet, PacketKind

S_NS, HOUR_NS = 1_000_000_000, 3_600_000_000_000
AGE_NS = 1_327_104


class Clock(Event):
    """A clock that only waiting for its event moves on."""

    def __init__(self, now_ns):
        super().__init__()
        self.now_ns = now_ns

    def __call__(self):
        return self.now_ns

    def wait(self, timeout):
        self.now_ns += 0 if self.is_set() else round(timeout * S_NS)


def data(made_ns):
    """A packet of one instant, with its stamp in whole microseconds."""
    payload = bytearray(1206)
    payload[1200:1204] = (made_ns % HOUR_NS // 1000).to_bytes(4, "little")
    payload[1204:] = b"\x37\x22"
    return Packet(PacketKind.DATA, made_ns + AGE_NS, bytes(payload))


@pytest.mark.parametrize("now_ns", [1_795_000_000_123_456_789, 1_795_003_599_999_000_000, 3 * S_NS])
def test_stamps_are_those_of_the_clock(now_ns):
    """Stamp and age of the first packet make the time at which it leaves, in the second after now; later
    ones follow."""
    clock = Clock(now_ns)
    packets = [data(1_779_000_000 * S_NS + 250_000_000 + step * 10_000_000) for step in range(3)]
    present = Present(clock_ns=clock)
    present.start(packets[0], Pacer(1.0, clock_ns=clock), clock)
    assert 0 <= clock.now_ns - now_ns < S_NS
    assert [stamp_ns(present.shift(packet)) for packet in packets] == [
        (clock.now_ns - AGE_NS + step * 10_000_000) % HOUR_NS for step in range(3)
    ]
    assert present.moved_s * S_NS == clock.now_ns - packets[0].due_ns


def test_a_stream_that_is_to_stop_does_not_wait():
    """Where the stop event is set, beginning returns at once."""
    clock = Clock(5 * S_NS + 1)
    clock.set()
    Present(clock_ns=clock).start(data(10 * S_NS), Pacer(1.0, clock_ns=clock), clock)
    assert clock.now_ns == 5 * S_NS + 1
