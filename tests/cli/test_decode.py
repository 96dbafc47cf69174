"""Captures into numbers and points."""

import csv
import signal
from collections import Counter

import numpy as np
import pytest
import trimesh
import velodyne_decoder as vd
from kit import data_payloads, real_capture

from vlp16emu import Emulator
from vlp16emu.captures import Capture, CaptureReader
from vlp16emu.errors import PacketError
from vlp16emu.packets import data_fields, decode_data, points_in

NAMES = "xyz_m", "distance_m", "azimuth_deg", "reflectivity", "ring", "laser"


def changed(path, out, at, byte, packets=slice(None)):
    """Write a capture anew with another byte at a place of some data packets."""
    content = bytearray(path.read_bytes())
    for payload in data_payloads(path)[packets]:
        content[content.index(payload.tobytes()) + at] = byte
    out.write_bytes(content)
    return out


def data_frames(path):
    """Numbers of the frames with data packets."""
    return [datagram.number for datagram in Capture(path) if len(datagram.payload) == 1206]


def xyz_in(path):
    """Coordinates in a file of points, read by somebody else where there is somebody."""
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return arrays["xyz_m"]
    if path.suffix == ".ply":
        return np.asarray(trimesh.load(path).vertices)
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=(2, 3, 4))


def test_the_summary_is_what_the_packets_say(cli, bench):
    """Counts, ranges, speed, mode and turns of 28.9 thousand records equal what a plain look at all
    packets at once gives."""
    tree = cli("decode", bench, "--json").tree
    points = decode_data(data_payloads(bench), keep_no_returns=True)
    met_m = points.distance_m[points.distance_m > 0]
    assert tree["packets"] * 384 == len(points.ring) == tree["points"] + tree["no_returns"]
    assert tree["points"] == len(met_m)
    assert tree["range_m"] == {
        "min": pytest.approx(met_m.min(), abs=1e-3),
        "median": pytest.approx(np.median(met_m), abs=2e-3),
        "max": pytest.approx(met_m.max(), abs=1e-3),
    }
    assert (tree["model"], tree["return_mode"], tree["cut"]) == ("vlp-16", "strongest", False)
    assert tree["rpm"] == pytest.approx(600, abs=0.1)
    assert tree["scans"] == 5
    assert tree["records_per_scan"] == pytest.approx(28_934, abs=32)
    assert tree["gps"] == {"pps": "absent", "sentence": ""}


@pytest.mark.parametrize("size", [1, 2, 5, 2_000])
def test_time_goes_on_over_the_full_hour(dual, monkeypatch, size):
    """The time of points rises over the hour, where the sensor's own clock falls back to 0."""
    monkeypatch.setattr("vlp16emu.captures.reading._CHUNK", size)
    reader = CaptureReader(dual)
    clock_ns = np.concatenate([reader.columns(table)["clock_ns"] for table in reader.tables()])
    stamps_us = data_fields(data_payloads(dual))["timestamp_us"]
    assert stamps_us[0] > 3_599_000_000
    assert stamps_us[-1] < 1_000_000
    assert np.diff(clock_ns).min() >= 0
    assert clock_ns[-1] - clock_ns[0] == pytest.approx(0.3e9, abs=2e6)


def test_npz_holds_all_arrays(cli, bench, tmp_path):
    """The arrays of a .npz are those of our own decoder."""
    out = tmp_path / "x.npz"
    assert cli("decode", bench, "--out", out).code == 0
    points = decode_data(data_payloads(bench), keep_no_returns=False)
    with np.load(out) as arrays:
        assert set(arrays) == {*NAMES, "is_last", "clock_ns", "t_ns"}
        for name in (*NAMES, "is_last"):
            np.testing.assert_array_equal(arrays[name], getattr(points, name))
        np.testing.assert_array_equal(arrays["clock_ns"], points.time_ns)


def test_csv_names_its_units(cli, bench, tmp_path):
    """A .csv has a header with units and one line per point, true to 0.1 mm and a nanosecond."""
    out = tmp_path / "x.csv"
    tree = cli("decode", bench, "--out", out, "--clock", "sensor", "--json").tree
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert (
        ",".join(rows[0])
        == "t_utc_s,clock_s,x_m,y_m,z_m,distance_m,azimuth_deg,reflectivity,ring,laser,is_last"
    )
    assert len(rows) == tree["points"]
    points = decode_data(data_payloads(bench), keep_no_returns=False)
    for column, values, step in (("x_m", points.xyz_m[:, 0], 1e-4), ("clock_s", points.time_ns / 1e9, 1e-9)):
        np.testing.assert_allclose([float(row[column]) for row in rows], values, atol=step)
    clock_ns = [int(row["t_utc_s"].replace(".", "")) % (3600 * 10**9) for row in rows]
    np.testing.assert_array_equal(clock_ns, points.time_ns)  # UTC to the nanosecond, in whole hours


def test_ply_opens_elsewhere(cli, bench, tmp_path):
    """Trimesh reads the .ply: the same points, with intensity, ring and time beside them."""
    out = tmp_path / "x.ply"
    cli("decode", bench, "--out", out, "--clock", "sensor")
    points = decode_data(data_payloads(bench), keep_no_returns=False)
    cloud = trimesh.load(out)
    np.testing.assert_array_equal(cloud.vertices, points.xyz_m)
    data = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(data["ring"], points.ring)
    np.testing.assert_array_equal(data["intensity"], points.reflectivity)
    np.testing.assert_allclose(data["time"] % 3600, points.time_ns / 1e9, rtol=0, atol=3e-7)


@pytest.mark.parametrize("suffix", [".npz", ".ply", ".csv"])
def test_files_of_dual_return_have_each_echo_once(cli, dual, tmp_path, suffix):
    """A single echo, which the packet has twice, is one point of every format and one point of the summary;
    velodyne_decoder counts as many."""
    out = tmp_path / f"x{suffix}"
    tree = cli("decode", dual, "--out", out, "--json").tree
    payloads = data_payloads(dual)
    records = decode_data(payloads, keep_no_returns=False)
    assert len(xyz_in(out)) == tree["points"] == len(records.ring) - tree["repeated_records"]
    config = vd.Config()
    config.min_range, config.max_range = 0, 200
    packets = [vd.VelodynePacket(i * 1e-3, payload.tobytes()) for i, payload in enumerate(payloads)]
    assert tree["points"] == len(vd.ScanDecoder(config).decode(packets, as_pcl_structs=True)[1])


def test_return_numbers_of_a_capture_are_those_of_its_pulses(cli, dual, tmp_path):
    """In LAS a pulse with one echo is 1 of 1; one with two has a nearer 1 of 2 and a farther 2 of 2."""
    laspy = pytest.importorskip("laspy")
    out = tmp_path / "x.las"
    record = 100 + 4 + 3 * 5  # laser 5 of block 1, whose other echo is now at 0.5 to 1 m
    capture = changed(dual, tmp_path / "two.pcap", record + 1, 0x01)
    cli("decode", capture, "--out", out)
    read = laspy.read(out)
    pairs = decode_data(data_payloads(capture), keep_no_returns=True).distance_m.reshape(-1, 2)
    two = int(((pairs > 0).all(axis=1) & (pairs[:, 0] != pairs[:, 1])).sum())
    single = int((pairs > 0).any(axis=1).sum()) - two
    numbers = zip(np.asarray(read.return_number), np.asarray(read.number_of_returns), strict=True)
    assert two > 20
    assert Counter((int(n), int(count)) for n, count in numbers) == {(1, 1): single, (1, 2): two, (2, 2): two}


def test_a_capture_that_changes_its_return_mode_has_each_echo_once(bench, dual):
    """Repeats are left out of the packets in dual return alone, in one table with others."""
    both = np.concatenate([data_payloads(bench)[:20], data_payloads(dual)[:20]])
    parts = [points_in(data_fields(both[part])).xyz_m for part in (slice(20), slice(20, 40))]
    assert np.array_equal(points_in(data_fields(both)).xyz_m, np.concatenate(parts))
    assert len(parts[0]) == len(decode_data(both[:20], keep_no_returns=False).xyz_m)


def test_a_cut_file_is_read_to_its_last_whole_packet(cli, bench, tmp_path):
    """A file that ends in the middle of a packet is read so far, and this is said."""
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(bench.read_bytes()[:-700])
    tree = cli("decode", cut, "--json").tree
    assert tree["cut"] is True
    assert tree["packets"] == cli("decode", bench, "--json").tree["packets"] - 1
    assert "in the middle of a packet" in cli("decode", cut).out


def test_another_sensor_is_refused_with_its_place(cli, bench, tmp_path):
    """A product byte of an HDL-32E is named with the file and the frame it stands in."""
    other = changed(bench, tmp_path / "other.pcap", 1205, 0x21, slice(1))
    outcome = cli("decode", other)
    number = data_frames(bench)[0]
    assert outcome.code == 2
    assert outcome.err == f"error: {other}: frame {number}: product: 0x21; expected 0x22 as of the others\n"


@pytest.mark.parametrize("suffix", [".npz", ".ply", ".csv"])
def test_a_broken_packet_leaves_the_points_before_it(cli, bench, tmp_path, suffix):
    """A last packet with a broken flag is named by its frame, and the points of all others can be read."""
    broken, out = (
        changed(bench, tmp_path / "broken.pcap", 300, 0xFE, slice(-1, None)),
        tmp_path / f"x{suffix}",
    )
    outcome = cli("decode", broken, "--out", out)
    number = data_frames(bench)[-1]
    assert outcome.code == 2
    assert outcome.err == f"error: {broken}: frame {number}: block flag: 0xeefe; expected 0xeeff\n"
    before = decode_data(data_payloads(bench)[:-1], keep_no_returns=False)
    np.testing.assert_allclose(xyz_in(out), before.xyz_m, atol=5.1e-5)


def test_packets_around_a_damaged_record_are_read(cli, bench, tmp_path):
    """Of a file that has lost 37 bytes all packets but one are read, and the report names the place."""
    content = bench.read_bytes()
    at = content.index(data_payloads(bench)[100].tobytes())
    damaged = tmp_path / "damaged.pcap"
    damaged.write_bytes(content[: at + 600] + content[at + 637 :])
    tree = cli("decode", damaged, "--json").tree
    assert tree["packets"] == len(data_payloads(bench)) - 1
    (line,) = tree["damage"]
    assert line.startswith(f"1227 bytes at byte {at - 58}")
    assert "left out in 1 place" in cli("decode", damaged).out


def test_a_clock_that_is_set_on_the_way_adds_no_time(cli, bench, tmp_path):
    """A sensor that gets lock in mid-run steps by half an hour while the host's clock goes on: the capture
    lasts as long as without."""
    content = bytearray(bench.read_bytes())
    for payload in data_payloads(bench)[200:]:
        at = content.index(payload.tobytes()) + 1200
        stamp_us = int.from_bytes(content[at : at + 4], "little") + 1_800_000_000
        content[at : at + 4] = (stamp_us % 3_600_000_000).to_bytes(4, "little")
    path = tmp_path / "set.pcap"
    path.write_bytes(content)
    durations_s = [cli("decode", file, "--json").tree["duration_s"] for file in (bench, path)]
    assert durations_s[0] == pytest.approx(durations_s[1], abs=1e-5)


def test_a_power_cycle_takes_its_time(cli, tmp_path):
    """A sensor that was off for longer than before has a clock that steps back by less than the host's
    goes on: both count."""
    cycle = {"kind": "power_cycle", "at_s": 0.2, "off_s": 0.4}
    Emulator("static_bench", {"events": [cycle]}).record(tmp_path / "cycle.pcap", duration_s=0.8)
    assert cli("decode", tmp_path / "cycle.pcap", "--json").tree["duration_s"] == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize("suffix", [".npz", ".ply", ".csv"])
def test_ctrl_c_leaves_the_points_so_far(cli, bench, tmp_path, monkeypatch, suffix):
    """Ctrl-C in the fourth chunk of 7 packets ends decoding after it: 28 packets are told and can be read."""
    monkeypatch.setattr("vlp16emu.captures.reading._CHUNK", 7)
    tables = CaptureReader.tables

    def interrupted(reader):
        for number, table in enumerate(tables(reader), start=1):
            if number == 4:
                signal.raise_signal(signal.SIGINT)
            yield table

    monkeypatch.setattr(CaptureReader, "tables", interrupted)
    out = tmp_path / f"x{suffix}"
    outcome = cli("decode", bench, "--out", out, "--json")
    assert outcome.code == 130
    assert (outcome.tree["packets"], outcome.tree["interrupted"]) == (28, True)
    np.testing.assert_allclose(
        xyz_in(out), decode_data(data_payloads(bench)[:28], keep_no_returns=False).xyz_m, atol=5.1e-5
    )


@pytest.mark.parametrize("size", [7, 2_000])
def test_another_model_is_refused_at_any_packet(bench, tmp_path, monkeypatch, size):
    """A Puck Hi-Res from the eighth packet on is refused, whether or not a chunk ends before it."""
    monkeypatch.setattr("vlp16emu.captures.reading._CHUNK", size)
    mixed = changed(bench, tmp_path / "mixed.pcap", 1205, 0x24, slice(7, None))
    with pytest.raises(PacketError, match="0x24; expected 0x22 as of the others"):
        list(CaptureReader(mixed).tables())


def test_a_real_capture_is_read(cli):
    """A capture of a real unit gives its known counts, speed, smallest range and GPS state; a turn has
    100.16 ms of 289 344 records per second."""
    tree = cli("decode", real_capture("mrpt_vlp16_gps.pcap"), "--json").tree
    assert (tree["packets"], tree["position_packets"]) == (293, 57)
    assert tree["rpm"] == pytest.approx(600, abs=3)
    assert tree["records_per_scan"] == pytest.approx(28_980, abs=16)
    assert tree["range_m"]["min"] == 0.5
    assert (tree["gps"]["pps"], tree["gps"]["sentence"][:7]) == ("locked", "$GPRMC,")


@pytest.mark.parametrize(("frame", "axes"), [("sensor", "x forward"), ("manual", "x right")])
def test_files_name_the_frame_of_their_points(bench, cli, tmp_path, frame, axes):
    """The header of a PLY file has the axes that were chosen."""
    assert cli("decode", bench, "--frame", frame, "--out", tmp_path / "x.ply").code == 0
    header = (tmp_path / "x.ply").read_bytes().split(b"end_header")[0].decode()
    assert f"in metres: {axes}" in header


def test_a_unit_before_release_is_read_with_its_model(bench, cli, tmp_path):
    """Product 0x21 names another sensor too: the line asks for --model, with which all points are as
    before."""
    old = changed(bench, tmp_path / "old.pcap", 1205, 0x21)
    refused = cli("decode", old)
    assert refused.code == 2
    hint = "`vlp16emu decode --model` for a VLP-16 from before release"
    assert refused.err.endswith(f"product: 0x21; expected {hint}\n")
    tree, before = cli("decode", old, "--model", "vlp-16", "--json").tree, cli("decode", bench, "--json").tree
    assert tree | {"file": ""} == before | {"file": ""}
    assert "vlp-16 or puck-hi-res" in cli("decode", old, "--model", "hdl-32e").err


ODD = b"\x1b]0;x\x07", "\u202e".encode(), "\x9b2J".encode(), b"\rb\nc"
"""Bytes that steer a terminal: a title (xterm's OSC 0), text from right to left (Unicode 6.3), a cleared
screen (ECMA-48, CSI in eight bits), and lines over others."""


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("verb", ["decode", "verify"])
def test_text_from_outside_does_not_steer_the_terminal(cli, bench, tmp_path, verb, odd):
    """A receiver's sentence and the name of a file are shown escaped: output has no control character but the
    ends of its own lines."""
    file = tmp_path / f"{odd.decode()}.pcap"
    content = bytearray(bench.read_bytes())
    for payload in (datagram.payload for datagram in Capture(bench) if len(datagram.payload) == 512):
        begin = content.index(payload) + 206
        sentence = b"$GPRMC," + odd + b",A"
        content[begin : begin + len(sentence)] = sentence
    file.write_bytes(content)
    outcome = cli(verb, file)
    assert ascii(odd.decode()[0])[1:-1] in outcome.out
    assert all(c.isprintable() for c in (outcome.out + outcome.err).replace("\n", ""))
