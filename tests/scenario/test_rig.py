"""The `[[rig]]` tables."""

import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario import load


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
    """Beside a unit with the errors of a real rotor another one turns evenly, and a third has what it gives itself."""
    like, even, own = rig(
        "{}", '{preset="steady"}', '{preset="unit", hum_deg=0.01}', sensor=["preset='unit'", "rpm=300"]
    )
    assert like.hum_deg > 0
    assert like.speed_error_rpm > 0
    assert (even.hum_deg, even.speed_error_rpm, even.rpm) == (0.0, 0.0, 300)
    assert (own.hum_deg, own.speed_error_rpm) == (0.01, like.speed_error_rpm)


def test_what_no_two_have_in_common_is_not_taken_over():
    """Name, address, ports and serial number count on from those of `[sensor]`; a unit with a start azimuth does not lock its phase."""
    _, third = rig("{}", "{}", sensor=["address='10.1.0.5'", "data_port=3000", "serial_number='0041'"])
    assert (third.name, third.address, third.serial_number) == ("unit_3", "10.1.0.7", "0043")
    assert (third.data_port, third.position_port) == (3002, 8310)
    (unit,) = rig("{start_azimuth_deg=10.0}", sensor=["phase_lock_deg=0.0"], more=["gps.connected=true"])
    assert (unit.phase_lock_deg, unit.start_azimuth_deg) == (None, 10.0)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("{rmp=600}", "rig[0].rmp: unknown key"),
        ("{model='free'}", "rig[0].model: found"),
        ("{name='unit_1'}", "name of its own for each unit"),
        ("{address='192.168.1.201'}", "address of its own for each unit"),
        ("{mount={pitch_deg=500}}", "rig[0].mount.pitch_deg: found 500"),
        ("{phase_lock_deg=0.0}", "without the pulse of gps.connected = true"),
        ("3", "rig[0]: found 3"),
    ],
)
def test_what_cannot_be_is_reported_in_one_line(table, message):
    """A wrong unit is named by its key path, with what was expected."""
    with pytest.raises(ScenarioError) as caught:
        rig(table)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_rigs_that_cannot_be_are_refused():
    """Ports that count on into each other are refused, as one port for both is; a free sensor cannot be the first of several."""
    with pytest.raises(ScenarioError, match="expected a data_port that is no unit's position_port"):
        rig("{}", sensor=["data_port=3000", "position_port=3001"])
    rig("{}", sensor=["data_port=3000", "position_port=3002"])
    with pytest.raises(ScenarioError, match="none beside"):
        load("static_bench", ["sensor.model=free", "sensor.beams=8", "rig=[{}]"])
