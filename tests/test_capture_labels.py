"""Labels of the points of a capture, from the truth behind each record of its run."""

import dpkt
import numpy as np
import pytest
from woods import THIN

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.packets import DATA_BYTES
from vlp16emu.run.options import TruthTo

pytest.importorskip("pyarrow", reason="pyarrow is in the extra data")

pytestmark = pytest.mark.usefixtures("kept_woods")

SETTINGS = THIN | {
    "sensor.return_mode": "dual",
    "beam.model": "fixed",
    "beam.rays": 8,
    # So that the places on the wire are those of the pulses, and the echoes of one pulse keep their order.
    "sensor.preset": "steady",
    "sensor.eccentricity_deg": 0.0,
    "sensor.azimuth_noise_deg": 0.0,
    "noise.preset": "ideal",
}
LABELS = ("semantic", "part", "leaf_wood", "instance", "species", "label", "tree_id")


def points(*words):
    """Run `vlp16emu points` with these words, the second of them the file, and read that; its name ends in .npz."""
    assert run(["points", *map(str, words)]) == 0
    with np.load(words[1]) as arrays:
        return dict(arrays)


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Folder with the capture of 0.4 s, in more than one row group, and its truth with returns; points of the scene itself."""
    folder = tmp_path_factory.mktemp("walk")
    emulator = Emulator("birch_walk", SETTINGS)
    emulator.record(folder / "walk.pcap", duration_s=0.4, truth=TruthTo(folder / "truth", per_return=True))
    write_points(emulator, folder / "own.npz", duration_s=0.4, truth=True, labels="for-instance")
    with np.load(folder / "own.npz") as own:
        return folder, dict(own)


@pytest.fixture(scope="module")
def labelled(walk):
    """Points of the capture with labels."""
    folder, _ = walk
    return points(folder / "walk.pcap", folder / "a.npz", "--trajectory", folder / "truth", "--labels", "for-instance")


def by_pulse(arrays, count):
    """Arrays of the first points in order of pulse, laser and distance."""
    order = np.lexsort((arrays["distance_m"], arrays["laser"], arrays["t_ns"]))[:count]
    return {name: array[order] for name, array in arrays.items()}


def test_points_have_the_labels_that_the_scene_gives_them(walk, labelled):
    """Every point of the capture, also of the second row group, has the class, part, instance, species and tree of the same echo of the scene."""
    _, own = walk
    count = min(len(own["t_ns"]), len(labelled["t_ns"]))
    assert count > 30_000
    own, ours = by_pulse(own, count), by_pulse(labelled, count)
    same = (ours["laser"] == own["laser"]) & (np.abs(ours["distance_m"] - own["distance_m"]) < 0.0011)
    assert same.all()
    for name in LABELS:
        assert (ours[name] == own[name]).all(), name
    assert len(np.unique(ours["label"])) >= 4
    assert np.abs(ours["height_m"] - own["height_m"]).max() < 0.002


def test_labels_do_not_depend_on_the_trajectory(walk, labelled):
    """With an estimate in TUM format and a drift the places move, and the labels stay, height above the ground with them."""
    folder, _ = walk
    words = [
        "--trajectory",
        folder / "truth" / "trajectory.tum",
        "--truth-folder",
        folder / "truth",
        "--drift",
        "60,0,0,90",
    ]
    moved = points(folder / "walk.pcap", folder / "b.npz", *words, "--labels", "for-instance")
    assert np.abs(moved["world_m"] - labelled["world_m"]).max() > 0.3
    for name in (*LABELS, "height_m"):
        assert (moved[name] == labelled[name]).all(), name


def copy(capture, out, keep):
    """Write the frames of a capture whose numbers `keep` gives, in that order."""
    with capture.open("rb") as file:
        frames = list(dpkt.pcap.Reader(file))
    data = [n for n, (_, frame) in enumerate(frames) if len(frame) == 42 + DATA_BYTES]
    with out.open("wb") as file:
        writer = dpkt.pcap.Writer(file, snaplen=65535)
        for n in keep(data):
            writer.writepkt(frames[n][1], frames[n][0])


def test_lost_late_and_doubled_packets_find_their_rows(walk, labelled, tmp_path):
    """Of a capture that lacks its first packets and some more, has one twice and one late, each point has the labels that it has in the whole."""
    folder, _ = walk

    def keep(data):
        kept = [n for i, n in enumerate(data) if i >= 20 and i % 7]
        kept[30:30] = [kept[29]]
        kept[50], kept[53] = kept[53], kept[50]
        return kept

    copy(folder / "walk.pcap", tmp_path / "cut.pcap", keep)
    some = points(
        tmp_path / "cut.pcap", tmp_path / "c.npz", "--trajectory", folder / "truth", "--labels", "for-instance"
    )
    assert 0.7 * len(labelled["t_ns"]) < len(some["t_ns"]) < 0.9 * len(labelled["t_ns"])
    names = ("t_ns", "laser", "is_last", "semantic", "part", "instance", "label")

    def rows(arrays):
        """Each point as a row."""
        return {tuple(row) for row in np.column_stack([arrays[name].astype(np.int64) for name in names]).tolist()}

    assert rows(some) < rows(labelled)


@pytest.mark.parametrize(
    ("truth", "line"),
    [
        ("other", "error: {other}/returns.parquet: no return in packet "),
        ("later", "error: {later}/returns.parquet: no packet of time stamp "),
        ("plain", "error: {plain}/returns.parquet: no such file"),
        ("damaged", "error: {damaged}/returns.parquet: "),
    ],
)
def test_the_truth_of_another_run_is_refused(walk, tmp_path, capsys, truth, line):
    """Truth of another scene, of another time, without returns or damaged gives one line and exit code 2."""
    folder, _ = walk
    of = {name: tmp_path / name for name in ("other", "later", "plain", "damaged")}
    settings = {**SETTINGS, "sensor.max_range_m": 3.0} if truth == "other" else {"sensor.return_mode": "dual"}
    emulator = Emulator("birch_walk" if truth == "other" else "static_bench", settings)
    emulator.record(tmp_path / "x.pcap", duration_s=0.1, truth=TruthTo(of[truth], per_return=truth != "plain"))
    if truth == "damaged":
        (of[truth] / "returns.parquet").write_bytes(b"PAR1 no table PAR1")
    words = ["--trajectory", folder / "truth", "--truth-folder", of[truth], "--truth"]
    assert run(["points", str(folder / "walk.pcap"), str(tmp_path / "out.npz"), *map(str, words)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(line.format(**of))
    assert error.count("\n") == 1
