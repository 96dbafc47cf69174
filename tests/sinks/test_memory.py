"""The list of packets."""

from vlp16emu.sinks import MemorySink


def test_packets_are_kept_as_they_came(make_packets):
    """The list holds the very packets in the order of sending, also after closing."""
    packets = make_packets(5)
    with MemorySink() as sink:
        for packet in packets:
            sink.send(packet)
    assert all(kept is sent for kept, sent in zip(sink.packets, packets, strict=True))
