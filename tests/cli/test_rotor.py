"""How far sensors turn, in the reports of runs."""

import pytest

TURNED = "revolutions", "azimuth_steps"


def test_a_recording_tells_revolutions_and_azimuth_steps(cli, tmp_path):
    """A fifth of a second at 600 rpm is 2 turns of 1808.4 firing sequences, and 3616 sequences fit whole."""
    arguments = "record", "static_bench", tmp_path / "x.pcap", "--duration", "0.2"
    unit = cli(*arguments, "--json").tree["units"][0]["turn"]
    assert [unit[key] for key in TURNED] == [2.0, 3616]
    assert unit["sequences_per_revolution"] == pytest.approx(1e8 / 55_296)
    assert unit["azimuth_step_deg"] == pytest.approx(0.1990656)
    assert "; 2 revolutions of 1 808 firing sequences, 0.1991 deg apart\n" in cli(*arguments).out


def test_units_that_turn_differently_are_distinguished(cli, tmp_path):
    """On a rig each unit counts its own revolutions; those that turn alike too."""
    rig = "rig=[{rpm=600,address='192.168.1.202'},{rpm=1200,address='192.168.1.203'}]"
    arguments = "record", "static_bench", tmp_path / "x.pcap", "--duration", "0.1", "--set", rig
    units = cli(*arguments, "--json").tree["units"]
    assert [[unit["turn"][key] for key in TURNED] for unit in units] == [[1.0, 1808], [1.0, 1808], [2.0, 1808]]


def test_a_stream_and_points_tell_them_too(cli, tmp_path):
    """The same keys stand in the reports of `stream`, which count to the last packet, and of `points`."""
    streamed = cli("stream", "static_bench", "--duration", "0.1", "--speed", "10", "--json").tree
    assert streamed["units"][0]["turn"]["revolutions"] == pytest.approx(10 * streamed["sent"]["simulated_s"])
    free = "--set", "sensor.model=free"
    seen = cli("points", "static_bench", tmp_path / "x.npz", "--duration", "0.1", *free, "--json").tree
    assert seen["turn"]["revolutions"] == pytest.approx(10 * seen["simulated_s"])
    assert seen["turn"]["azimuth_steps"] == pytest.approx(18_000 * seen["simulated_s"], abs=1.0)
