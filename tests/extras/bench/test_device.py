"""Settings of a running sensor, those that survive a restart, and its converters against the formulas of
the manual, applied the other way."""

import json
import math
from dataclasses import replace

import pytest

from vlp16emu.errors import InputError
from vlp16emu.extras.bench.device import DeviceSettings, DeviceStatus, diagnostics
from vlp16emu.types import PpsState
from vlp16emu.units import S_NS

OTHERS = DeviceSettings(
    1200, "dual", False, (90, 270), 123.45, 12_345, "10.0.0.7", 3000, 3001,
    "10.0.0.2", "255.255.0.0", "0.0.0.0", True,
)  # fmt: skip


def test_saved_settings_survive_the_run(make, tmp_path):
    """The next run starts with every field of a JSON table of those saved; what was not saved is the
    factory's."""
    file = tmp_path / "saved.json"
    _, device = make(saved=file)
    device.adopt(lambda _: OTHERS)
    _, unsaved = make(saved=file)
    device.save()
    _, again = make(saved=file)
    assert (unsaved.settings, again.settings) == (DeviceSettings(), OTHERS)
    tree = json.loads(file.read_text())
    assert (tree["rpm"], tree["return_mode"], tree["fov_deg"]) == (1200, "dual", [90, 270])
    assert all(getattr(OTHERS, name) != getattr(DeviceSettings(), name) for name in vars(OTHERS))
    file.write_text('{"rpm": 300}')
    assert make(saved=file, factory=OTHERS)[1].settings == replace(OTHERS, rpm=300)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ("", "an empty file: copy or download it again; expected settings that a sensor has saved"),
        ("[1]", "expected a table"),
        ('{"rpm": 310}', "rpm: found 310; expected a whole number from 300 to 1200 in steps of 60"),
        ('{"rpn": 300}', "rpn: unknown key"),
        ('{"host": "x"}', 'host: found "x"; expected the IPv4 address of a host, or 255.255.255.255'),
        ('{"return_mode": "Dual"}', 'return_mode: found "Dual"; expected "strongest", "last" or "dual"'),
        ("9" * 20_000, "found 20000 bytes"),
        ("[" * 9000, "no JSON"),
    ],
)
def test_a_file_that_no_sensor_has_saved_is_refused(make, tmp_path, content, line):
    """A file that was edited badly is named with the key, what was found and what was expected."""
    file = tmp_path / "saved.json"
    file.write_text(content)
    with pytest.raises(InputError) as caught:
        make(saved=file)
    assert str(caught.value).startswith(str(file))
    assert line in str(caught.value)


WARM = DeviceStatus(
    t_ns=1_779_267_600 * S_NS, pps=PpsState.ABSENT, position="", motor_rpm=600.0, motor_on=True,
    phase_locked=False, phase_cdeg=0, laser_on=True, powered_for_s=7200.0,
)  # fmt: skip


def volts(raw):
    return raw * 5 / 4096


def celsius(raw):
    """63-9243 Rev D, section 10.2.3.2."""
    return -1481.96 + math.sqrt(2.1962e6 + (1.8639 - volts(raw)) / 3.88e-6)


def boards(**changes):
    tree = diagnostics(replace(WARM, **changes))["volt_temp"]
    return tree["bot"], tree["top"]


def test_a_healthy_sensor_reads_as_real_units_do():
    """Rails, input, high voltage and temperatures of a warm unit stay within 1 % of those on record, and
    move slightly."""
    real_bottom = {
        "i_out": 2087,
        "pwr_1_2v": 986,
        "lm20_temp": 1037,
        "pwr_5v": 2056,
        "pwr_2_5v": 2047,
        "pwr_3_3v": 2706,
        "pwr_v_in": 891,
        "pwr_1_25v": 0,
    }
    real_top = {
        "hv": 2628,
        "ad_temp": 602,
        "lm20_temp": 1018,
        "pwr_5v": 2078,
        "pwr_2_5v": 2047,
        "pwr_3_3v": 2687,
        "pwr_5v_raw": 2190,
        "pwr_vccint": 976,
    }
    seen = [boards(t_ns=WARM.t_ns + s * S_NS) for s in range(62)]
    for side, real in enumerate((real_bottom, real_top)):
        assert all(
            at[side] == {name: pytest.approx(raw, rel=0.01) for name, raw in real.items()} for at in seen
        )
        for name in real:
            counts = [at[side][name] for at in seen]
            assert max(counts) - min(counts) in range(1, 8) or name == "pwr_1_25v", name


def test_boards_warm_up_over_the_first_minutes():
    """From 25 degrees at power-up, over more than half of the way after two minutes, to 51 and 53 after
    ten."""
    readings = [
        [celsius(board["lm20_temp"]) for board in boards(powered_for_s=s)] for s in (0.0, 120.0, 600.0)
    ]
    for cold, between, warm in zip(*readings, strict=True):
        assert cold == pytest.approx(25, abs=0.5)
        assert between > (cold + warm) / 2
        assert warm == pytest.approx(52, abs=1.7)


def test_the_current_follows_motor_and_laser():
    """0.48 A at 600 rpm, more at 1200, less without lasers, least at rest."""
    states = ((1200.0, True), (600.0, True), (600.0, False), (0.0, False))
    currents = [10 * (volts(boards(motor_rpm=rpm, laser_on=on)[0]["i_out"]) - 2.5) for rpm, on in states]
    assert currents == sorted(currents, reverse=True)
    assert len(set(currents)) == 4
    assert currents[1] == pytest.approx(0.48, abs=0.03)
