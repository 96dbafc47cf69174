"""The tables of models: against themselves, our numbers, and the beams of velodyne_decoder."""

import math

import numpy as np
import pytest
import velodyne_decoder
import yaml

from vlp16emu.packets import layout
from vlp16emu.sensor import beams as sensor
from vlp16emu.types import ReturnMode, SensorModel

BUNDLED = {
    SensorModel.VLP_16: velodyne_decoder.Model.VLP16,
    SensorModel.PUCK_HI_RES: velodyne_decoder.Model.PuckHiRes,
    SensorModel.HDL_32E: velodyne_decoder.Model.HDL32E,
    SensorModel.VLP_32C: velodyne_decoder.Model.VLP32C,
    SensorModel.VLS_128: velodyne_decoder.Model.AlphaPrime,
}


def test_each_model_has_a_table(models):
    """There is a table for each model, and no other, and each section names its source."""
    assert set(models) == {model.value for model in SensorModel}
    for name, table in models.items():
        for section in ("packet", "firing", "frame", "motor", "beams"):
            assert table[section]["source"].strip(), (name, section)


@pytest.mark.parametrize("model", SensorModel)
def test_firing_times(models, model):
    """Lasers fire in groups at their slots, which end before the next sequence; lists are as long as the
    lasers, or repeat."""
    firing, beams = models[model]["firing"], models[model]["beams"]
    lasers = len(beams["elevation_deg"])
    assert len(firing["slots"]) * firing["lasers_per_slot"] == lasers
    assert firing["slots"] == sorted(set(firing["slots"]))
    assert (firing["slots"][-1] + 1) * firing["slot_ns"] < firing["sequence_ns"]
    assert lasers % len(beams["azimuth_offset_deg"]) == 0
    made = sensor.BEAM_TABLES[model]
    expected_ns = [
        firing["slots"][laser // firing["lasers_per_slot"]] * firing["slot_ns"] for laser in range(lasers)
    ]
    assert made.firing_ns.tolist() == expected_ns
    assert made.sequence_ns == firing["sequence_ns"]
    offsets_deg = beams["azimuth_offset_deg"]
    assert made.azimuth_offset_deg.tolist() == [offsets_deg[n % len(offsets_deg)] for n in range(lasers)]
    assert sorted(made.ring.tolist()) == list(range(lasers))


@pytest.mark.parametrize(
    ("model", "sequences", "dual", "blocks"),
    [("vlp-16", 24, 12, 12), ("hdl-32e", 12, 6, 12), ("vlp-32c", 12, 6, 12), ("vls-128", 3, 1, 8)],
)
def test_packets_hold_whole_sequences(model, sequences, dual, blocks):
    """A packet has as many firing sequences as fit in whole, twice in dual return: of a VLS-128 one, in eight
    blocks."""
    single, twice = (
        layout.layout_of(SensorModel(model), mode) for mode in (ReturnMode.LAST, ReturnMode.DUAL)
    )
    assert (single.sequences, single.blocks) == (sequences, 12)
    assert (twice.sequences, twice.blocks) == (dual, blocks)
    for one in (single, twice):
        slots = one.places[:, 0]
        assert sorted(slots.tolist()) == list(range(32 * one.blocks))
        assert (np.diff(one.places[:, 3]) >= 0).all()


@pytest.mark.parametrize(
    ("model", "tolerance_mm"),
    [("vlp-16", 0.06), ("puck-hi-res", 0.5), ("hdl-32e", 6e-4), ("vlp-32c", 6e-4), ("vls-128", 6e-4)],
)
def test_all_beams_pass_the_lens(models, model, tolerance_mm):
    """The stated lens radius explains every vertical correction of the VLP-16 to the last digit of the
    table."""
    beams, made = models[model]["beams"], sensor.BEAM_TABLES[SensorModel(model)]
    assert beams["lens_radius_mm"] == pytest.approx(made.lens_radius_m * 1e3)
    through_mm = [-beams["lens_radius_mm"] * math.tan(math.radians(deg)) for deg in beams["elevation_deg"]]
    assert made.vertical_offset_m * 1e3 == pytest.approx(through_mm, abs=tolerance_mm)
    assert made.vertical_offset_m * 1e3 == pytest.approx(beams["vertical_correction_mm"], rel=1e-12)


@pytest.mark.parametrize("model", BUNDLED)
def test_velodyne_decoder_agrees_on_beams(models, model):
    """Elevations, azimuth offsets and the unit of distance are those of the calibration that
    velodyne_decoder brings along, whose rotation correction is subtracted."""
    theirs = yaml.safe_load(velodyne_decoder.Calibration.default_calibs[BUNDLED[model]].to_string())
    made = sensor.BEAM_TABLES[model]
    by_laser = sorted(theirs["lasers"], key=lambda laser: laser["laser_id"])
    stated_rad = [(laser["vert_correction"], -laser.get("rot_correction", 0.0)) for laser in by_laser]
    ours_deg = np.stack([made.elevation_deg, made.azimuth_offset_deg], axis=1)
    assert np.degrees(stated_rad) == pytest.approx(ours_deg, abs=1e-4)
    assert theirs["distance_resolution"] * 1000 == pytest.approx(models[model]["packet"]["distance_mm"])
