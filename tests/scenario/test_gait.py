"""Presets of gait and inertial unit, and the mount's one check."""

import pytest
from pydantic import ValidationError

from vlp16emu.motion import Gait, Imu, Mount

AMPLITUDES = set(Gait.model_fields) - {"preset", "step_hz", "variation"}


def test_natural_is_the_default():
    """A gait without settings is the natural one, in which everything moves."""
    assert Gait(preset="natural") == Gait()
    assert all(getattr(Gait(), name) > 0 for name in AMPLITUDES)


def test_none_is_still_and_paper_is_two_sines():
    """Without gait no amplitude is left; in the paper's, the vertical and the sideways one."""
    assert {name for name in AMPLITUDES if getattr(Gait(preset="none"), name)} == set()
    paper = Gait(preset="paper")
    assert {name for name in AMPLITUDES if getattr(paper, name)} == {"vertical_m", "sideways_m"}
    assert (paper.step_hz, paper.variation) == (1.8, 0.0)


def test_strong_is_more_than_natural():
    """Each amplitude of the strong gait exceeds the natural one."""
    assert all(getattr(Gait(preset="strong"), name) > getattr(Gait(), name) for name in AMPLITUDES)


def test_own_keys_go_over_the_preset():
    """What a scene gives itself holds, the rest is the preset's."""
    own = Gait(preset="paper", vertical_m=0.5)
    assert (own.vertical_m, own.sideways_m) == (0.5, 0.02)
    assert Imu(preset="tactical", rate_hz=100, accel_bias_m_s2=0.0).gyro_bias_rad_s == 4.8e-5


@pytest.mark.parametrize("section", [Gait, Imu])
def test_unknown_preset_is_refused(section):
    """A preset that does not exist, or is no name, is an error at its own key."""
    for preset in ("brisk", 3):
        with pytest.raises(ValidationError, match="preset"):
            section(preset=preset)


def test_axis_without_direction_is_refused():
    """A stage cannot spin about nothing, nor about what is too short or too long to have a direction."""
    for z in (0.0, 1e-300, 1e200):
        with pytest.raises(ValidationError, match="a spin_axis of a length from 1e-6"):
            Mount(spin_hz=0.5, spin_axis=(0.0, 0.0, z))
