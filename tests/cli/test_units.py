"""Captures of several sensors at the command line."""

import struct

import numpy as np
import pytest

from vlp16emu.captures import capture, survey

RIG = (
    "rig=[{mount={pitch_deg=-35.0}},"
    " {return_mode='dual', address='10.0.0.7', data_port=2368, position_port=8308}]"
)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Half a second of three sensors, the third at the first one's ports."""
    from vlp16emu.cli.app import run

    path = tmp_path_factory.mktemp("rig") / "rig.pcap"
    assert run(["record", "static_bench", str(path), "--duration", "0.5", "--set", RIG]) == 0
    return path


def test_the_recording_counts_each_unit(cli, tmp_path):
    """Totals are the sums of the units', which are told with addresses and ports."""
    tree = cli(
        "record", "static_bench", tmp_path / "x.pcap", "--duration", "0.2", "--set", RIG, "--json"
    ).tree
    units = tree["units"]
    assert [(unit["unit"], unit["address"], unit["data_port"]) for unit in units] == [
        (1, "192.168.1.201", 2368),
        (2, "192.168.1.202", 2369),
        (3, "10.0.0.7", 2368),
    ]
    for key in ("packets", "position_packets", "returns"):
        assert tree[key] == sum(unit[key] for unit in units)
    assert units[2]["packets"] == pytest.approx(2 * units[0]["packets"], abs=2)


def test_verify_reads_a_capture_of_many_units_twice(cli, rig, tmp_path, monkeypatch):
    """Each frame is looked at once to find the units and once to check it, however many units there are."""
    content = rig.read_bytes()
    at = content.index(struct.pack("<II", 1248, 1248)) - 8
    record = content[at : at + 16 + 1248]
    address = 16 + 14 + 12
    frames = [record[:address] + struct.pack(">I", 0x0A000000 + i) + record[address + 4 :] for i in range(40)]
    path = tmp_path / "crowd.pcap"
    path.write_bytes(content[:24] + b"".join(frames))
    seen = []
    batches = capture.Capture.batches

    def counted(self):
        for batch in batches(self):
            seen.extend(batch.number.tolist())
            yield batch

    monkeypatch.setattr(capture.Capture, "batches", counted)
    tree = cli("verify", path, "--json").tree
    assert (len(tree["units"]), len(seen)) == (40, 80)
    assert {unit["packets"] for unit in tree["units"]} == {1}
    line = cli("decode", path).err
    assert line.endswith(f"{survey._NAMED} (10.0.0.{survey._NAMED - 1}:2368), ... 40\n")


@pytest.mark.parametrize(
    ("unit", "mode"),
    [("2", "strongest"), ("192.168.1.202:2369", "strongest"), ("10.0.0.7:2368", "dual"), ("1", "dual")],
)
def test_decode_takes_the_packets_of_one(cli, rig, unit, mode):
    """By number or by address and port, the summary is that of one sensor: half a second, five turns."""
    tree = cli("decode", rig, "--unit", unit, "--json").tree
    assert (tree["return_mode"], tree["scans"], tree["rpm"]) == (mode, 5, pytest.approx(600, abs=0.1))
    assert tree["records_per_scan"] == pytest.approx((1 + (mode == "dual")) * 28_934, abs=64)


def test_points_of_a_tilted_unit_are_in_its_own_frame(cli, rig, tmp_path):
    """Turned by its pitch, nose up, what the tilted sensor saw of the hall's floor lies 1.5 m below it to
    5 mm."""
    assert cli("decode", rig, "--unit", "192.168.1.202:2369", "--out", tmp_path / "x.npz").code == 0
    x_m, _, z_m = np.load(tmp_path / "x.npz")["xyz_m"].T.astype(float)
    pitch = np.radians(35.0)
    level_m = x_m * np.sin(pitch) + z_m * np.cos(pitch)
    assert level_m.min() > -1.505
    assert (level_m < -1.495).mean() > 0.1


def test_verify_checks_each_by_itself(cli, rig):
    """Every unit has a report of its own, all clean."""
    outcome = cli("verify", rig)
    assert outcome.code == 0
    assert [line for line in outcome.out.splitlines() if not line.startswith(" ")] == [
        "10.0.0.7:2368: clean",
        "192.168.1.201:2368: clean",
        "192.168.1.202:2369: clean",
    ]
