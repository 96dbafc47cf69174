"""The calibration files, read as their consumers read them."""

import math
from xml.etree import ElementTree as ET

import pytest
import velodyne_decoder
import yaml

SENSORS = {"vlp-16": "VLP-16", "puck-hi-res": "Puck-Hi-Res"}
sensors = pytest.mark.parametrize("model", SENSORS)


ZERO = (
    *(
        "rot_correction",
        "dist_correction",
        "dist_correction_x",
        "dist_correction_y",
        "horiz_offset_correction",
    ),
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
def test_ros_file(protocol, timing, data_packet, model):
    """The YAML file has all keys that velodyne_pointcloud reads: elevations (rad), vertical corrections
    (m), the scale, else zeros."""
    document = yaml.safe_load(
        (protocol / "calibration" / f"{SENSORS[model]}.yaml").read_text(encoding="utf-8")
    )
    scale_m = next(row for row in data_packet["record"] if row["name"] == "distance")["scale"]
    assert (document["num_lasers"], document["distance_resolution"]) == (16, scale_m)
    table = timing["beams"][model]
    assert document["lasers"] == [
        dict.fromkeys(ZERO, 0.0)
        | {
            "laser_id": laser,
            "vert_correction": math.radians(table["elevation_deg"][laser]),
            "vert_offset_correction": pytest.approx(table["vertical_correction_mm"][laser] / 1000, abs=1e-12),
            "max_intensity": 255,
        }
        for laser in timing["firing"]["order"]
    ]


@sensors
def test_veloview_file(protocol, timing, model):
    """The XML file holds the stated elevations (deg), vertical corrections (cm) and distance scale, else
    zeros."""
    scale_m, lasers = veloview_calibration(protocol / "calibration" / f"{SENSORS[model]}.xml")
    table = timing["beams"][model]
    assert scale_m == 0.002
    for laser, values in lasers.items():
        assert values.pop("vertCorrection_") == table["elevation_deg"][laser]
        correction_cm = table["vertical_correction_mm"][laser] / 10
        assert values.pop("vertOffsetCorrection_") == pytest.approx(correction_cm, abs=1e-9)
        assert set(values.values()) == {0.0}
    assert len(lasers) == 16


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
