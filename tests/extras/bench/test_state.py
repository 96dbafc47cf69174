"""What is set on a sensor, and what of it survives."""

import json
from dataclasses import replace

import pytest

from vlp16emu.errors import InputError, OutputError, RunError
from vlp16emu.extras.bench.device import DeviceSettings
from vlp16emu.types import ReturnMode

OTHERS = DeviceSettings(
    1200, ReturnMode.DUAL, False, (90, 270), True, 12_345, "10.0.0.7", 3000, 3001,
    "10.0.0.2", "255.255.0.0", "0.0.0.0", True,
)  # fmt: skip


def test_a_change_is_passed_on_once(make):
    """The stream hears of settings that change, and not of those that are set to what they are."""
    engine, device = make()
    device.change(lambda settings: replace(settings, rpm=1200))
    device.change(lambda settings: replace(settings, rpm=1200))
    assert [settings.rpm for settings in engine.changes] == [1200]


@pytest.mark.parametrize("act", ["change", "restart"])
def test_what_the_stream_cannot_follow_is_not_set(make, act):
    """A receiver that is out of reach leaves the settings as they were, and the one who asks hears of it."""
    _, device = make()
    device.adopt(lambda _: OTHERS)

    def refused(_before, settings, **_how):
        raise OutputError("destination", "out of reach", "an address in reach")

    device._changed = refused
    with pytest.raises(OutputError):
        device.restart() if act == "restart" else device.change(lambda settings: replace(settings, rpm=300))
    assert device.settings == OTHERS


@pytest.mark.parametrize("in_a_file", [True, False])
def test_saved_settings_survive_a_reset_and_others_are_lost(make, tmp_path, in_a_file):
    """A reset brings back what was saved last, and before that what the factory has set."""
    engine, device = make(saved=tmp_path / "saved.json" if in_a_file else None)
    device.adopt(lambda _: OTHERS)
    device.restart()
    assert (device.settings, engine.resets) == (DeviceSettings(), [DeviceSettings()])
    device.adopt(lambda _: OTHERS)
    device.save()
    device.change(lambda settings: replace(settings, rpm=300))
    device.restart()
    assert (device.settings, device.power_up, engine.resets[-1]) == (OTHERS,) * 3


def test_saved_settings_survive_the_run(make, tmp_path):
    """The next run starts with every field of a JSON table of those saved; one that has saved nothing with the factory's."""
    file = tmp_path / "saved.json"
    _, device = make(saved=file)
    device.adopt(lambda _: OTHERS)
    _, unsaved = make(saved=file)
    device.save()
    _, again = make(saved=file)
    assert (unsaved.settings, again.settings) == (DeviceSettings(), OTHERS)
    tree = json.loads(file.read_text())
    assert (tree["rpm"], tree["return_mode"], tree["fov_deg"]) == (1200, "dual", [90, 270])
    assert all(getattr(OTHERS, name) != getattr(DeviceSettings(), name) for name in DeviceSettings.__slots__)


def test_a_key_that_was_not_saved_is_the_factorys(make, tmp_path):
    """A file with some of the keys leaves the others as the factory has set them."""
    file = tmp_path / "saved.json"
    file.write_text('{"rpm": 300}')
    _, device = make(saved=file, factory=OTHERS)
    assert device.settings == replace(OTHERS, rpm=300)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ("", "no JSON; expected settings that a sensor has saved"),
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


def test_settings_that_cannot_be_saved_are_not_taken_for_saved(make, tmp_path):
    """Where the file cannot be written, the next power-up is as before."""
    _, device = make(saved=tmp_path / "absent" / "saved.json")
    device.adopt(lambda _: OTHERS)
    with pytest.raises((InputError, RunError)):
        device.save()
    assert device.power_up == DeviceSettings()
