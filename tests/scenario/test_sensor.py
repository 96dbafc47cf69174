"""The `[sensor]` table, for sensors with packets and for free ones."""

import numpy as np
import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario import load
from vlp16emu.sensor.settings import on_the_wire

FREE = "sensor.model=free"


def sensor(*settings):
    return load("static_bench", settings).sensor


def test_beams_are_spread_evenly_over_the_field_of_view():
    """Beams make equal steps from the lowest up, a single one looks at the middle, a list keeps its order; without a model it is a VLP-16."""
    free = sensor(FREE, "sensor.beams=64", "sensor.vertical_fov_deg=[-25, 15]")
    np.testing.assert_allclose(free.beam_elevations_deg, np.linspace(-25, 15, 64), atol=1e-12)
    assert sensor(FREE, "sensor.beams=1", "sensor.vertical_fov_deg=[-10, 4]").beam_elevations_deg == (-3.0,)
    assert sensor(FREE, "sensor.elevations_deg=[3, -20.5, 0]").beam_elevations_deg == (3.0, -20.5, 0.0)
    assert sensor("sensor.rpm=300").model == "vlp-16"


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ([FREE, "sensor.position_rate=manual"], '--set sensor.position_rate=manual: unknown key; expected sensor.model = "puck-hi-res", "puck-lite" or "vlp-16" '),
        (["sensor.model=vlp-32c"], '--set sensor.model=vlp-32c: found "vlp-32c"; expected "free", "puck-hi-res", "puck-lite" or "vlp-16"'),
        ([FREE, "sensor.rpm=3601"], "--set sensor.rpm=3601: found 3601; expected a whole number from 60 to 3600"),
        ([FREE, "sensor.azimuth_resolution_deg=0.01"], "--set sensor.azimuth_resolution_deg=0.01: found 0.01; expected a number from 0.05 to 2"),
        ([FREE, "sensor.beams=0"], "--set sensor.beams=0: found 0; expected a whole number from 1 to 1024"),
        ([FREE, "sensor.elevations_deg=[1, 2]", "sensor.beams=2"], "--set sensor.beams=2: found 2; expected nothing, as elevations_deg names every beam"),
        ([FREE, "sensor.vertical_fov_deg=[15, -15]"], "--set sensor.vertical_fov_deg=[15, -15]: found a list of 2; expected the lower elevation first"),
        ([FREE, "sensor.elevations_deg=[0, 90]"], "--set sensor.elevations_deg=[0, 90]: sensor.elevations_deg[1]: found 90; expected a number above -90"),
        (["noise.elevation_error_deg=2"], "--set noise.elevation_error_deg=2: found 2; expected a number from 0 to 1"),
    ],
)  # fmt: skip
def test_a_bad_sensor_is_reported_in_one_line(settings, line):
    """What does not belong to the sensor at hand is refused with what would have."""
    with pytest.raises(ScenarioError) as caught:
        sensor(*settings)
    assert str(caught.value).startswith(line)


def test_only_known_sensors_are_on_the_wire():
    """A sensor with packets is handed on, a free one refused."""
    assert on_the_wire(sensor("sensor.model=puck-hi-res")).model == "puck-hi-res"
    with pytest.raises(ScenarioError, match=r'^sensor\.model: found "free", which has no packets; expected'):
        on_the_wire(sensor(FREE))
