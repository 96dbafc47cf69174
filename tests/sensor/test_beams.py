"""The beam tables against the geometry behind them."""

import numpy as np
import pytest
from scipy import stats

from vlp16emu.extras.free_sensor import FreeSensor
from vlp16emu.sensor.beams import BEAM_TABLES, with_angle_errors
from vlp16emu.types import SensorModel


def free(**settings):
    return FreeSensor(model="free", **settings).beam_table()


def test_elevations_and_rings_are_those_of_the_data_sheet():
    """The VLP-16's lasers look from -15 to 15 degrees in steps of 2, rings counted from below; lasers of
    one elevation keep their order."""
    assert np.sort(BEAM_TABLES[SensorModel.VLP_16].elevation_deg).tolist() == list(range(-15, 16, 2))
    assert BEAM_TABLES[SensorModel.VLP_16].ring.tolist() == [
        0,
        8,
        1,
        9,
        2,
        10,
        3,
        11,
        4,
        12,
        5,
        13,
        6,
        14,
        7,
        15,
    ]
    level = free(elevations_deg=[5.0, 0.0, 0.0, -5.0])
    assert level.ring.tolist() == [3, 1, 2, 0]


def test_angle_errors_are_normal_and_as_wide_as_set():
    """Over many lasers the errors of both angles are normal with the sigma that was set, and independent."""
    many = free(elevations_deg=[0.0] * 5_000)
    unit = with_angle_errors(many, elevation_error_deg=0.03, azimuth_error_deg=0.05, seed=7)
    assert stats.kstest(unit.elevation_error_deg / 0.03, "norm").pvalue > 0.01
    assert stats.kstest(unit.azimuth_error_deg / 0.05, "norm").pvalue > 0.01
    assert abs(np.corrcoef(unit.elevation_error_deg, unit.azimuth_error_deg)[0, 1]) < 0.05


@pytest.mark.parametrize(
    ("beams", "resolution_deg", "rpm"), [(1, 2.0, 60), (64, 0.2, 600), (256, 0.05, 3600)]
)
def test_a_free_sensor_fires_evenly_once_per_step(beams, resolution_deg, rpm):
    """A sequence lasts as long as the rotor takes for the step, and its lasers share that time evenly."""
    table = free(beams=beams, azimuth_resolution_deg=resolution_deg, rpm=rpm)
    assert table.sequence_ns == pytest.approx(resolution_deg / (rpm * 6) * 1e9, abs=0.5)
    assert (np.diff(table.firing_ns) == table.sequence_ns // beams).all()
    assert 0 <= table.sequence_ns - beams * (table.sequence_ns // beams) < beams


def test_free_beams_pass_through_the_lens():
    """With a lens off the axis each line meets the horizontal plane there; without one it begins at the
    centre."""
    elevation_deg = [-25.0, -3.0, 0.0, 15.0]
    table = free(elevations_deg=elevation_deg, lens_radius_m=0.05)
    height_m = table.vertical_offset_m + 0.05 * np.tan(np.radians(elevation_deg))
    np.testing.assert_allclose(height_m, 0.0, atol=1e-17)
    np.testing.assert_allclose(table.near_m * np.cos(np.radians(elevation_deg)), 0.05)
    centred = free(elevations_deg=elevation_deg)
    assert not centred.vertical_offset_m.any()
    assert not centred.near_m.any()
