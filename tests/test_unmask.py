"""`tools/unmask`: the units that made captures, and the statistics that it measures on them."""

import dataclasses

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.extras.compare import read_sequences

UNIT = {"noise.preset": "unit", "sensor.preset": "unit", "sensor.max_range_m": 8.0}


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """Two captures of one unit, in two places, and one of another unit."""
    folder = tmp_path_factory.mktemp("unmask")
    wanted = {"one": (7, 0.0), "again": (7, 4.0), "other": (8, 0.0)}
    for name, (seed, x_m) in wanted.items():
        settings = UNIT | {"sensor.seed": seed, "motion.x_m": x_m}
        Emulator("static_bench", settings).record(folder / f"{name}.pcap", duration_s=0.4)
    return {name: read_sequences(folder / f"{name}.pcap") for name in wanted}


def test_captures_of_one_unit_are_found(captures, tool_named):
    """Codes of no-returns identify two captures of one unit, wherever it stood, and set a third apart; in a
    table the two are one unit."""
    unmask = tool_named("unmask")
    assert unmask.is_same_unit(captures["one"], captures["again"])
    assert not unmask.is_same_unit(captures["one"], captures["other"])
    units = [unmask.Unit(name, "real", made, {}, name) for name, made in captures.items()]
    assert [unit.unit for unit in unmask.by_unit(units)] == ["one+again", "one+again", "other"]


def test_rows_find_what_is_put_in(captures, tool_named):
    """Ranges that are all even, codes without noise, and one record lost on a calm wall at the same place
    each turn, come out as such."""
    unmask = tool_named("unmask")
    n = 4000
    turn = 1800
    codes = np.full((n, 16), 40)
    ranges_lsb = np.full((n, 16), 2000)
    ranges_lsb[100::turn, 3] = 0
    number = np.arange(n)
    made = dataclasses.replace(
        captures["one"],
        number=number,
        distance_lsb=ranges_lsb,
        reflectivity=codes,
        block=number[::2] // 2,
        azimuth_cdeg=number[::2] * 20,
    )
    row = {name.partition(" ")[0]: of(unmask.Capture(made, {})) for name, of in reversed(unmask.ROWS.items())}
    assert row["1."] == pytest.approx(1e3 * 3 / (16 * (n - 6)), rel=0.01)
    assert row["12."] == 1.0
    assert row["3."] != row["3."]  # three losses are too few for a share
    near = np.array(ranges_lsb)
    near[100::turn, :10] = 0
    row_of = dataclasses.replace(made, distance_lsb=near)
    again = unmask.ROWS["2. the place lost again a turn later (at rest)"](unmask.Capture(row_of, {}))
    assert again == 1.0


def test_a_window_has_features_of_every_field(captures, tool_named):
    """Each field has features along the laser, the column and the turn; parity and runs are among them, and
    no feature is of a place or a time."""
    unmask = tool_named("unmask")
    window = next(iter(unmask.windows(captures["one"])))
    features = unmask.machine_features(window)
    for field in ("range", "code", "loss", "no_return"):
        for axis in ("next_1", "up", "turn"):
            assert any(name.startswith(f"{field}.{axis}") for name in features), (field, axis)
    assert {"range.next_1.odd", "loss.run.1", "azimuth.mod_5.0", "stamp.odd"} <= features.keys()
    known = [value for value in features.values() if np.isfinite(value)]
    assert len(known) > 500
    assert np.min(known) >= 0.0
    assert np.max(known) <= 1.0


def test_rooms_have_what_real_rooms_have(tool_named):
    """A room of each of ten seeds is a valid scene with panes, a plate that reflects back, an opening, a
    table under the sensor, turned crates and polished things, and nothing that is cut at the reach of the
    sensor."""
    rooms = tool_named("unmask").Room
    for seed in range(1, 11):
        room = rooms(seed)
        names = {str(box["name"]).split()[0] for box in room.boxes}
        assert {"pane", "frame", "board", "thing", "partition", "table", "crate", "polished"} <= names
        assert any("retroreflection_cd_lx_m2" in box for box in room.boxes)
        assert not any("max_range" in setting for setting in room.settings)
        Emulator("static_bench", [*room.settings, "beam.model=none"])
