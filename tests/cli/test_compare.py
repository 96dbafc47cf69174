"""`vlp16emu compare` and `vlp16emu fit`: units held against each other, and one put into a scene."""

import tomllib

import pytest

from vlp16emu import Emulator
from vlp16emu.scenario import load

UNIT = [
    "noise.preset=unit",
    "sensor.preset=unit",
    "sensor.azimuth_noise_deg=0.0014",
    "capture.preset=quiet_pc",
]


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """Captures of two units and of one without errors."""
    folder = tmp_path_factory.mktemp("units")
    for name, settings in (("a", [*UNIT, "seed=1"]), ("b", [*UNIT, "seed=2"]), ("ideal", [])):
        Emulator("static_bench", settings).record(folder / f"{name}.pcap", duration_s=0.7)
    return folder


def test_units_are_compared_in_a_table_and_as_json(cli, captures):
    """JSON has each statistic of both with its distance, and what differs is said by name."""
    pair = captures / "a.pcap", captures / "ideal.pcap"
    tree = cli("compare", *pair, "--json").tree
    by_name = {one["name"]: one for one in tree["statistics"]}
    assert {"range.beat_mm", "rotation.once_cdeg", "residue.odd_spread", "clock.arrival_us"} <= by_name.keys()
    assert "range.beat_mm" in tree["apart"]
    assert by_name["range.beat_mm"]["first"] > 3 > by_name["range.beat_mm"]["second"]
    text = cli("compare", *pair).out
    assert "second like no real unit" in text
    assert f"{len(tree['apart'])} of {len(tree['statistics'])} statistics differ" in text


def test_a_fitted_unit_goes_into_a_scene(cli, captures, tmp_path):
    """What `fit` prints is what it writes, and its tables are settings of a scene."""
    printed = cli("fit", captures / "a.pcap").out
    assert cli("fit", captures / "a.pcap", "--out", tmp_path / "unit.toml").code == 0
    assert (
        (tmp_path / "unit.toml").read_text() == printed == cli("fit", captures / "a.pcap", "--out", "-").out
    )
    tables = tomllib.loads(printed)
    settings = {f"{table}.{key}": value for table, keys in tables.items() for key, value in keys.items()}
    assert load("birch_walk", settings).noise.range_beat_m == tables["noise"]["range_beat_m"]


def test_what_both_captures_lack_of_real_units_is_said_once(cli, captures):
    """Statistics that are like no real unit in both have a star and one line below; JSON has both verdicts
    of each."""
    pair = captures / "ideal.pcap", captures / "ideal.pcap"
    text, tree = cli("compare", *pair).out, cli("compare", *pair, "--json").tree
    unlike = sum(all(one["unlike"]) for one in tree["statistics"])
    assert unlike > 3
    assert text.count("like no real unit") == 1
    assert f"\n{unlike} are like no real unit in both captures (*)" in text
    assert sum(line.endswith("*") for line in text.splitlines()) == unlike


def test_histograms_are_shares_of_both_captures(cli, captures):
    """Shares of azimuth steps add up to one, those of an ideal sensor are in one or two bins, and the bins
    of both are the same."""
    tree = cli("compare", captures / "a.pcap", captures / "ideal.pcap", "--json").tree
    by_name = {one["name"]: one for one in tree["histograms"]}
    steps = by_name["azimuth step"]
    assert [sum(steps[which]) for which in ("first", "second")] == pytest.approx([1.0, 1.0], abs=1e-4)
    assert sum(share > 0 for share in steps["second"]) <= 2 < sum(share > 0 for share in steps["first"])
    assert len(steps["edges"]) == len(steps["first"]) + 1
    assert by_name["reflectivity"]["first_values"] > 0
