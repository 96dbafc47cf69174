"""The calibration files, read as their consumers read them."""

import math
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import velodyne_decoder
import yaml

from vlp16emu.sensor.beams import BEAM_TABLES
from vlp16emu.types import SensorModel

SENSORS = {
    "vlp-16": "VLP-16",
    "puck-hi-res": "Puck-Hi-Res",
    "hdl-32e": "HDL-32E",
    "vlp-32c": "VLP-32C",
    "vls-128": "VLS-128",
}
ROOT = Path(__file__).parents[2]
sensors = pytest.mark.parametrize("model", SENSORS)


def stated(model):
    """Return elevation and azimuth offset in degrees, and vertical correction in mm, of each laser."""
    table = BEAM_TABLES[SensorModel(model)]
    offsets_mm = 1e3 * table.vertical_offset_m
    return list(zip(table.elevation_deg.tolist(), table.azimuth_offset_deg.tolist(), offsets_mm, strict=True))


ZERO = (
    *("dist_correction", "dist_correction_x", "dist_correction_y", "horiz_offset_correction"),
    *("min_intensity", "focal_distance", "focal_slope"),
)


def veloview_calibration(path):
    """Read a file as VeloView does: five lists under DB, lengths in cm. PCL wants a part of it."""
    database = ET.parse(path).getroot()
    assert database.tag == "boost_serialization"
    database = database.find("DB")
    colors = [
        [float(item.text) for item in rgb.findall("item")] for rgb in database.findall("colors_/item/rgb")
    ]
    assert all(len(color) == 3 and all(0 <= part <= 1 for part in color) for color in colors)
    enabled = sum(item.text == "1" for item in database.findall("enabled_/item"))
    intensity = [
        [int(item.text) for item in database.findall(f"{name}/item")]
        for name in ("minIntensity_", "maxIntensity_")
    ]
    assert [len(colors), *map(len, intensity)] == [enabled] * 3
    lasers = {}
    for px in database.findall("points_/item/px"):
        values = {child.tag: float(child.text) for child in px}
        lasers[int(values.pop("id_"))] = values
    assert sorted(lasers) == list(range(enabled))
    return float(database.find("distLSB_").text) / 100, lasers


@sensors
def test_ros_file(protocol, models, model):
    """The YAML file has all keys that velodyne_pointcloud reads: elevations and opposite azimuth offsets
    (rad), vertical corrections (m), the scale, else zeros."""
    document = yaml.safe_load(
        (protocol / "calibration" / f"{SENSORS[model]}.yaml").read_text(encoding="utf-8")
    )
    beams = stated(model)
    scale_m = models[model]["packet"]["distance_mm"] / 1000
    assert (document["num_lasers"], document["distance_resolution"]) == (len(beams), scale_m)
    assert document["lasers"] == [
        dict.fromkeys(ZERO, 0.0)
        | {
            "laser_id": laser,
            "rot_correction": -math.radians(offset_deg),
            "vert_correction": math.radians(elevation_deg),
            "vert_offset_correction": pytest.approx(correction_mm / 1000, abs=1e-6),
            "max_intensity": 255,
        }
        for laser, (elevation_deg, offset_deg, correction_mm) in enumerate(beams)
    ]


@sensors
def test_veloview_file(protocol, models, model):
    """The XML file holds the stated elevations and opposite azimuth offsets (deg), vertical corrections (cm)
    and distance scale, else zeros."""
    scale_m, lasers = veloview_calibration(protocol / "calibration" / f"{SENSORS[model]}.xml")
    assert scale_m == models[model]["packet"]["distance_mm"] / 1000
    beams = stated(model)
    for laser, values in lasers.items():
        elevation_deg, offset_deg, correction_mm = beams[laser]
        assert values.pop("vertCorrection_") == elevation_deg
        assert values.pop("rotCorrection_", 0.0) == -offset_deg
        assert values.pop("vertOffsetCorrection_") == pytest.approx(correction_mm / 10, abs=1e-4)
        assert set(values.values()) == {0.0}
    assert len(lasers) == len(beams)


@sensors
def test_velodyne_decoder_reads_the_file(protocol, model):
    """velodyne_decoder loads the YAML file and finds the stated beams in it."""
    path = protocol / "calibration" / f"{SENSORS[model]}.yaml"
    seen = yaml.safe_load(velodyne_decoder.Calibration.read(str(path)).to_string())
    beams = stated(model)
    assert seen["num_lasers"] == len(beams)
    for laser in seen["lasers"]:
        elevation_deg, offset_deg, correction_mm = beams[laser["laser_id"]]
        assert laser["vert_correction"] == pytest.approx(math.radians(elevation_deg), abs=1e-7)
        assert laser["rot_correction"] == pytest.approx(-math.radians(offset_deg), abs=1e-7)
        assert laser["vert_offset_correction"] == pytest.approx(correction_mm / 1000, abs=1e-6)


def test_they_are_written_by_the_tool(protocol, tmp_path):
    """`tools/calibration` writes the files as they are, and no others are there."""
    command = [sys.executable, ROOT / "tools" / "calibration", tmp_path]
    subprocess.run(command, check=True, capture_output=True)
    written, kept = (
        {path.name: path.read_bytes() for path in folder.iterdir()}
        for folder in (tmp_path, protocol / "calibration")
    )
    assert written == kept
