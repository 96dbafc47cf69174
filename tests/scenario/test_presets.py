"""Tables a key of which gives others: gait, inertial unit, relief."""

import pytest
from pydantic import ValidationError

from vlp16emu.extras.imu.settings import Imu
from vlp16emu.extras.walk import Gait
from vlp16emu.forest.settings import Forest, Terrain
from vlp16emu.motion import Mount

AMPLITUDES = set(Gait.model_fields) - {"preset", "step_hz", "variation"}


@pytest.mark.parametrize(
    ("section", "word"), [(Gait, {"preset": "natural"}), (Imu, {"preset": "ideal"}), (Terrain, {"relief": "rolling"})]
)
def test_a_table_without_keys_is_its_default_preset(section, word):
    """What the default preset gives are the defaults; a preset that does not exist, or is no word, is an error of its key."""
    assert section.model_validate(word) == section()
    (key,) = word
    for unknown in ("brisk", 3, ["flat"]):
        with pytest.raises(ValidationError) as caught:
            section.model_validate({key: unknown})
        assert [error["loc"] for error in caught.value.errors()] == [(key,)]


def test_gaits_are_what_their_names_say():
    """Without gait no amplitude is left; the paper's has two sines; each amplitude of the strong gait exceeds the natural one."""
    moving = {preset: {name for name in AMPLITUDES if getattr(Gait(preset=preset), name)} for preset in Gait.presets}
    assert moving == {"none": set(), "paper": {"vertical_m", "sideways_m"}, "natural": AMPLITUDES, "strong": AMPLITUDES}
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
    """Hilly ground has the highest hills, rough ground the roughest soil and the most mounds, flat ground the least of all."""
    flat, rolling, hilly, rough = (Terrain(relief=relief) for relief in ("flat", "rolling", "hilly", "rough"))
    assert flat.hill_rms_m == 0 < rolling.hill_rms_m < rough.hill_rms_m < hilly.hill_rms_m
    assert flat.rough_rms_m < rolling.rough_rms_m <= hilly.rough_rms_m < rough.rough_rms_m
    assert flat.mounds_per_ha <= rolling.mounds_per_ha < hilly.mounds_per_ha < rough.mounds_per_ha


def test_axis_without_direction_is_refused():
    """A stage cannot spin about nothing, nor about what is too short or too long to have a direction."""
    for z in (0.0, 1e-300, 1e200):
        with pytest.raises(ValidationError, match="a spin_axis of a length from 1e-6"):
            Mount(spin_hz=0.5, spin_axis=(0.0, 0.0, z))
