"""Firing times and beams of timing.toml against packets/ and sensor/, and against themselves."""

import math

import numpy as np
import pytest

from vlp16emu.packets import layout
from vlp16emu.sensor import beams as sensor
from vlp16emu.types import ReturnMode, SensorModel


def beams(timing, model):
    table = timing["beams"][model.value]
    return timing["beams"][table["same_as"]] if "same_as" in table else table


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


def test_beam_table(timing):
    """The sensor's beams are those of the manual, in wire order."""
    for model in SensorModel:
        stated, made = beams(timing, model), sensor.BEAM_TABLES[model]
        assert made.elevation_deg.tolist() == stated["elevation_deg"], model
        stated_m = np.array(stated["vertical_correction_mm"]) / 1e3
        assert made.vertical_offset_m == pytest.approx(stated_m, rel=1e-12), model


@pytest.mark.parametrize(
    ("model", "tolerance_mm"), [(SensorModel.VLP_16, 0.06), (SensorModel.PUCK_HI_RES, 0.5)]
)
def test_all_beams_pass_the_lens(timing, model, tolerance_mm):
    """The stated lens radius explains every vertical correction of the VLP-16 to the last digit of the
    table."""
    radius_mm = timing["beams"]["lens"]["radius_mm"]
    assert radius_mm == pytest.approx(sensor.LENS_RADIUS_M * 1e3)
    table = beams(timing, model)
    for elevation, correction in zip(table["elevation_deg"], table["vertical_correction_mm"], strict=True):
        assert correction == pytest.approx(-radius_mm * math.tan(math.radians(elevation)), abs=tolerance_mm)
