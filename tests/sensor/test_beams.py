"""The beam tables against the geometry behind them."""

import numpy as np
import pytest

from vlp16emu.sensor import BEAM_TABLES, LENS_RADIUS_M
from vlp16emu.types import SensorModel


@pytest.mark.parametrize(("model", "off_m"), [(SensorModel.VLP_16, 1e-4), (SensorModel.PUCK_HI_RES, 5e-4)])
def test_all_beams_pass_through_one_point(model, off_m):
    """Each vertical offset is that of a line through the lens point, to the tenths of the manual's table."""
    table = BEAM_TABLES[model]
    expected_m = -LENS_RADIUS_M * np.tan(np.radians(table.elevation_deg))
    # The manual's Hi-Res offsets are equal steps rather than tangents, up to 0.41 mm off at the horizon.
    np.testing.assert_allclose(table.vertical_offset_m, expected_m, atol=off_m)


def test_elevations_are_the_sixteen_of_the_data_sheet():
    """Sorted, the VLP-16's lasers look from -15 to 15 degrees in steps of 2."""
    assert np.sort(BEAM_TABLES[SensorModel.VLP_16].elevation_deg).tolist() == list(range(-15, 16, 2))


def test_light_leaves_at_the_lens():
    """The range at which a beam begins, put along the beam, lies on the circle of the lens."""
    table = BEAM_TABLES[SensorModel.VLP_16]
    np.testing.assert_allclose(table.near_m * np.cos(np.radians(table.elevation_deg)), LENS_RADIUS_M)
