"""The share of a core that sending takes."""

import pytest

from vlp16emu.extras.doctor import sending_share
from vlp16emu.types import Packet, PacketKind


@pytest.mark.parametrize(("packets", "low", "high"), [(0, 0.0, 0.0), (190, 1e-9, 1.0)])
def test_sending_takes_a_part_of_a_core(packets, low, high):
    """A quarter of a second of packets, sent in real time, takes more than nothing and less than a core; no packets, nothing."""
    made = [Packet(PacketKind.DATA, i * 1_327_104, bytes(1206)) for i in range(packets)]
    assert low <= sending_share(made) <= high
