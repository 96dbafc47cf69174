"""Firing times of timing.toml against packets/ and sensor/, and against themselves."""

import pytest

from vlp16emu.packets import layout
from vlp16emu.sensor import beams as sensor
from vlp16emu.types import ReturnMode


def test_periods_are_made_of_each_other(timing):
    """16 lasers and a recharge make a sequence, 2 sequences a block, 24 or 12 sequences a packet."""
    firing, packet = timing["firing"], timing["packet"]
    lasers_ns = firing["lasers"] * firing["laser_period_ns"]
    assert firing["sequence_period_ns"] == lasers_ns + firing["recharge_ns"]
    assert firing["block_period_ns"] == firing["sequences_per_block"] * firing["sequence_period_ns"]
    for name in ("single", "dual"):
        period_ns = packet[name]["sequences"] * firing["sequence_period_ns"]
        assert packet[name]["period_ns"] == packet["departure"]["after_first_firing_ns"][name] == period_ns
        assert packet[name]["rate_per_s"] == pytest.approx(1e9 / period_ns, rel=1e-4)
        records = packet[name]["blocks"] * firing["sequences_per_block"] * firing["lasers"]
        assert packet[name]["records_per_s"] == pytest.approx(packet[name]["rate_per_s"] * records, rel=1e-4)


def test_periods_of_packets_and_sensor(timing):
    """Packets are packed, and the head fires, with the stated periods and numbers of sequences."""
    firing = timing["firing"]
    assert (firing["lasers"], firing["sequences_per_block"]) == (layout.LASERS, layout.SEQUENCES_PER_BLOCK)
    assert firing["block_period_ns"] == layout.BLOCK_PERIOD_NS
    assert (firing["laser_period_ns"], firing["sequence_period_ns"]) == (sensor.LASER_NS, sensor.SEQUENCE_NS)
    for mode in ReturnMode:
        packet = timing["packet"]["dual" if mode is ReturnMode.DUAL else "single"]
        assert layout.SEQUENCES_PER_PACKET[mode] == packet["sequences"]
        assert packet["blocks"] == layout.BLOCKS_PER_PACKET
