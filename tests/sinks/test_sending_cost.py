"""What sending takes of a core."""

from vlp16emu.sinks import sending_share


def test_sending_takes_a_part_of_a_core(make_packets):
    """A quarter of a second of packets, sent in real time, takes more than nothing and less than a core."""
    assert 0 < sending_share(make_packets(190)) < 1


def test_nothing_to_send_takes_nothing():
    """Without packets the share is 0."""
    assert sending_share([]) == 0
