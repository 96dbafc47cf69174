"""Calibration and beams as velodyne_decoder understands them."""

import math

import pytest
import velodyne_decoder
import yaml

SENSORS = {"vlp-16": "VLP-16", "puck-hi-res": "Puck-Hi-Res"}
sensors = pytest.mark.parametrize("model", SENSORS)


@sensors
def test_velodyne_decoder_reads_the_file(protocol, timing, model):
    """velodyne_decoder loads the YAML file and finds the stated beams in it."""
    path = protocol / "calibration" / f"{SENSORS[model]}.yaml"
    seen = yaml.safe_load(velodyne_decoder.Calibration.read(str(path)).to_string())
    table = timing["beams"][model]
    assert seen["num_lasers"] == 16
    for laser in seen["lasers"]:
        elevation_rad = math.radians(table["elevation_deg"][laser["laser_id"]])
        assert laser["vert_correction"] == pytest.approx(elevation_rad, abs=1e-7)
        correction_m = table["vertical_correction_mm"][laser["laser_id"]] / 1000
        assert laser["vert_offset_correction"] == pytest.approx(correction_m, abs=1e-8)


@sensors
def test_velodyne_decoder_agrees_on_elevations(timing, model):
    """Our elevations are those of the calibration that velodyne_decoder brings along for the sensor."""
    bundled = {"vlp-16": velodyne_decoder.Model.VLP16, "puck-hi-res": velodyne_decoder.Model.PuckHiRes}[model]
    theirs = yaml.safe_load(velodyne_decoder.Calibration.default_calibs[bundled].to_string())["lasers"]
    for laser in theirs:
        elevation_rad = math.radians(timing["beams"][model]["elevation_deg"][laser["laser_id"]])
        assert laser["vert_correction"] == pytest.approx(elevation_rad, abs=1e-6)
    assert len(theirs) == 16
