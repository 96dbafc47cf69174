"""Tables of the scene file: the sensor, its rig, the finish and the files of the user's things, where a
person goes, and presets."""

import numpy as np
import pytest
from pydantic import ValidationError

from vlp16emu.extras.imu.settings import Imu
from vlp16emu.extras.walk.settings import Gait
from vlp16emu.forest.settings import Forest, Terrain
from vlp16emu.motion.settings import Mount
from vlp16emu.scenario import load

FREE = "sensor.model=free"


def sensor(*settings):
    return load("static_bench", settings).sensor


def test_beams_are_spread_evenly_over_the_field_of_view():
    """Beams make equal steps from the lowest up, a single one looks at the middle, a list keeps its order;
    without a model it is a VLP-16."""
    free = sensor(FREE, "sensor.beams=64", "sensor.vertical_fov_deg=[-25, 15]")
    np.testing.assert_allclose(free.beam_elevations_deg, np.linspace(-25, 15, 64), atol=1e-12)
    assert sensor(FREE, "sensor.beams=1", "sensor.vertical_fov_deg=[-10, 4]").beam_elevations_deg == (-3.0,)
    assert sensor(FREE, "sensor.elevations_deg=[3, -20.5, 0]").beam_elevations_deg == (3.0, -20.5, 0.0)
    assert sensor("sensor.rpm=300").model == "vlp-16"


def rig(*tables, sensor=(), more=()):
    """Units of a scene beside the first."""
    first = [f"sensor.{setting}" for setting in sensor]
    return load("static_bench", [*first, f"rig=[{', '.join(tables)}]", *more]).rig


def test_a_unit_is_like_the_first_unless_it_says_otherwise():
    """Speed, mode and ranges are those of `[sensor]`; what the unit gives itself wins."""
    like, other = rig(
        "{}", "{rpm=1200, max_range_m=50.0}", sensor=["rpm=300", "return_mode='dual'", "max_range_m=80.0"]
    )
    assert (like.rpm, like.return_mode, like.max_range_m) == (300, "dual", 80.0)
    assert (other.rpm, other.return_mode, other.max_range_m) == (1200, "dual", 50.0)


def test_a_preset_of_its_own_takes_the_place_of_the_firsts():
    """Beside a unit with the errors of a real rotor another one turns evenly, and a third has what it
    gives itself."""
    like, even, own = rig(
        "{}", '{preset="steady"}', '{preset="unit", hum_deg=0.01}', sensor=["preset='unit'", "rpm=300"]
    )
    assert like.hum_deg > 0
    assert like.speed_error_rpm > 0
    assert (even.hum_deg, even.speed_error_rpm, even.rpm) == (0.0, 0.0, 300)
    assert (own.hum_deg, own.speed_error_rpm) == (0.01, like.speed_error_rpm)


def test_what_no_two_have_in_common_is_not_taken_over():
    """Name, address, ports and serial number count on from those of `[sensor]`; a unit with a start
    azimuth does not lock its phase."""
    _, third = rig("{}", "{}", sensor=["address='10.1.0.5'", "data_port=3000", "serial_number='0041'"])
    assert (third.name, third.address, third.serial_number) == ("unit_3", "10.1.0.7", "0043")
    assert (third.data_port, third.position_port) == (3002, 8310)
    (second,) = rig("{}", sensor=["data_port=3000", "position_port=3002"])
    assert (second.data_port, second.position_port) == (3001, 3003)
    (unit,) = rig("{start_azimuth_deg=10.0}", sensor=["phase_lock_deg=0.0"], more=["gps.connected=true"])
    assert (unit.phase_lock_deg, unit.start_azimuth_deg) == (None, 10.0)


SCENE = """\
schema = 1
title = "A plot"
[motion]
kind = "static"
[world]
kind = "plot"
stem_list = "lists/plot.csv"
dem = { file = "/srv/ground.npy", cell_m = 2, corner_m = [0, 0] }
[[world.meshes]]
file = "hut.obj"
unit = "m"
up = "z"
parts = [{ name = "roof", reflectance = 0.2 }]
places = [{ x_m = 1, y_m = 2 }]
"""


@pytest.fixture
def scene(tmp_path):
    def write(old="", new=""):
        assert old in SCENE
        path = tmp_path / "scene.toml"
        path.write_text(SCENE.replace(old, new, 1) if old else SCENE)
        return str(path)

    return write


def test_files_lie_beside_the_scene(scene, tmp_path, monkeypatch):
    """A relative path is from the folder of the scene, in a setting of any form from the current one; an
    absolute one stays as it is."""
    world = load(scene()).world
    assert (world.stem_list, world.dem.file) == (str(tmp_path / "lists/plot.csv"), "/srv/ground.npy")
    monkeypatch.chdir("/")
    for setting in (["world.stem_list=other.csv"], {"world.stem_list": "other.csv"}):
        assert load(scene(), setting).world.stem_list == "/other.csv"
    way = "motion={ kind = 'walk', way_points_file = 'way.csv' }"
    assert load("birch_walk", [way]).motion.way_points_file == "/way.csv"
    mesh = "{ file = 'a.obj', unit = 'm', up = 'z', places = [{ x_m = 1, y_m = 2 }] }"
    assert load(scene(), [f"world.meshes=[{mesh}]"]).world.meshes[0].file == "/a.obj"
    (gone := tmp_path / "gone").mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert load("static_bench").world.kind == "hall"  # without a current folder


AMPLITUDES = set(Gait.model_fields) - {"preset", "step_hz", "variation"}


@pytest.mark.parametrize(
    ("section", "word"),
    [(Gait, {"preset": "natural"}), (Imu, {"preset": "ideal"}), (Terrain, {"relief": "rolling"})],
)
def test_a_table_without_keys_is_its_default_preset(section, word):
    """What the default preset gives are the defaults; a preset that does not exist, or is no word, is an
    error of its key."""
    assert section.model_validate(word) == section()
    (key,) = word
    for unknown in ("brisk", 3, ["flat"]):
        with pytest.raises(ValidationError) as caught:
            section.model_validate({key: unknown})
        assert [error["loc"] for error in caught.value.errors()] == [(key,)]


def test_gaits_are_what_their_names_say():
    """Without gait no amplitude is left; the paper's has two sines; each amplitude of the strong gait
    exceeds the natural one."""
    moving = {
        preset: {name for name in AMPLITUDES if getattr(Gait(preset=preset), name)} for preset in Gait.presets
    }
    assert moving == {
        "none": set(),
        "paper": {"vertical_m", "sideways_m"},
        "natural": AMPLITUDES,
        "uneven": AMPLITUDES,
        "strong": AMPLITUDES,
    }
    assert (Gait(preset="paper").step_hz, Gait(preset="paper").variation) == (1.8, 0.0)
    assert all(getattr(Gait(preset="strong"), name) > getattr(Gait(), name) for name in AMPLITUDES)


def test_own_keys_go_over_the_preset():
    """What a scene gives itself holds, the rest is the preset's."""
    own = Gait(preset="paper", vertical_m=0.5)
    assert (own.vertical_m, own.sideways_m) == (0.5, 0.02)
    assert Imu(preset="tactical", rate_hz=100, accel_bias_m_s2=0.0).gyro_bias_rad_s == 4.8e-5
    hilly = Terrain(relief="hilly")
    assert Terrain(relief="hilly", hill_rms_m=7.0) == hilly.model_copy(update={"hill_rms_m": 7.0})
    table = Forest.with_preset({"preset": "old_growth", "terrain": {"relief": "flat"}})
    assert table["terrain"] == {"relief": "flat"}  # and none of the numbers of the forest


def test_reliefs_are_in_order_of_height_and_of_roughness():
    """Hilly ground has the highest hills, rough ground the roughest soil and the most mounds, flat ground
    the least of all."""
    flat, rolling, hilly, rough = (Terrain(relief=relief) for relief in ("flat", "rolling", "hilly", "rough"))
    assert flat.hill_rms_m == 0 < rolling.hill_rms_m < rough.hill_rms_m < hilly.hill_rms_m
    assert flat.rough_rms_m < rolling.rough_rms_m <= hilly.rough_rms_m < rough.rough_rms_m
    assert flat.mounds_per_ha <= rolling.mounds_per_ha < hilly.mounds_per_ha < rough.mounds_per_ha


def test_axis_without_direction_is_refused():
    """A stage cannot spin about nothing, nor about what is too short or too long to have a direction."""
    for x, z in ((0.0, 0.0), (0.0, 1e-300), (1e6, 1e6)):
        with pytest.raises(ValidationError, match="a spin_axis of a length from 1e-6"):
            Mount(spin_hz=0.5, spin_axis=(x, 0.0, z))
