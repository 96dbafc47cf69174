"""Truth behind each record of a data packet, held against the packets, another decoder, the trajectory and
the meshes."""

import json
import struct

import numpy as np
import pytest
import trimesh
import velodyne_decoder
from kit import data_payloads, set_words
from scipy.spatial.transform import Rotation
from woods import THIN

from vlp16emu import Emulator
from vlp16emu.cli.app import run as command
from vlp16emu.extras.truth.slots import SLOT_COLUMNS
from vlp16emu.extras.truth.truth import write_truth
from vlp16emu.packets import DATA_PAYLOAD
from vlp16emu.run.options import TruthTo

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is in the extra data")
compute = pytest.importorskip("pyarrow.compute", reason="pyarrow is in the extra data")

pytestmark = pytest.mark.usefixtures("kept_woods")

SPAN_S = 0.25
EDGE_M = 0.002
Z_UP = np.array(
    [[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]
)  # from rows of glTF, whose y is up, to those of the world


@pytest.fixture(scope="module")
def walk():
    """A walk among birches without noise."""
    return Emulator("birch_walk", THIN | {"noise.preset": "ideal"})


@pytest.fixture(scope="module", params=["strongest", "last", "dual"])
def run(request, walk, tmp_path_factory):
    """A quarter of a second of the walk: emulator, capture and truth."""
    folder = tmp_path_factory.mktemp("slots")
    emulator = walk.changed({"sensor.return_mode": request.param})
    to = TruthTo(folder / "truth", rate_hz=2000, per_return=True)
    emulator.record(folder / "walk.pcap", duration_s=SPAN_S, truth=to)
    return emulator, folder / "walk.pcap", to.folder


@pytest.fixture(scope="module")
def table(run):
    return parquet.read_table(run[2] / "returns.parquet")


def test_every_record_has_its_row(run, table):
    """Rows go by packet, block and channel, and their ranges in steps of 2 mm are the distances in the
    packets, all of them."""
    distance = data_payloads(run[1]).view(DATA_PAYLOAD)[:, 0]["blocks"]["records"]["distance_lsb"].reshape(-1)
    assert table.column_names == list(SLOT_COLUMNS)
    number = np.arange(len(distance))
    for name, expected in (("packet", number // 384), ("block", number // 32 % 12), ("channel", number % 32)):
        assert (table[name].to_numpy() == expected).all()
    range_m = table["range_m"].fill_null(0.0).to_numpy().astype(np.float64)
    assert (np.rint(range_m / 0.002) == distance).all()
    assert (table["miss"].to_numpy() == (distance == 0)).all()
    assert table["range_m"].null_count == (distance == 0).sum() > 1000


def test_all_points_of_another_decoder_find_their_rows(run, table):
    """The n-th of all its points is the n-th row, by time and block, that is neither a miss nor a repeat:
    15 mm, beside the encoder's error."""
    config = velodyne_decoder.Config(min_range=0, max_range=200)
    scans = velodyne_decoder.read_pcap(str(run[1]), config, as_pcl_structs=True)
    points = np.concatenate([points for _, points in scans])
    rows = table.filter(~(table["miss"].to_numpy() | table["repeat"].to_numpy()))
    rows = rows.sort_by([("t_ns", "ascending"), ("block", "ascending")])
    assert len(points) == len(rows) > 20_000
    their_m = np.column_stack([points[axis] for axis in "xyz"])
    our_m = np.column_stack([rows[f"{axis}_m"].to_numpy() for axis in "xyz"])
    away_m = np.linalg.norm(their_m - our_m, axis=1)
    # The azimuth on the wire is that of the encoder, whose errors are part of the sensor.
    allowed_m = 0.015 + np.radians(0.1) * rows["range_m"].to_numpy()
    assert (away_m < allowed_m).all()


def test_relative_and_absolute_places_are_one(run, table):
    """With the pose of the trajectory at the time of its pulse a place in the sensor is the place in the
    world, to 0.1 mm."""
    lines = (run[2] / "trajectory.tum").read_text().splitlines()[1:]
    poses = np.array([line.split() for line in lines])
    start_ns = run[0].scenario.start_ns
    pose_ns = np.array([int(t.replace(".", "")) - start_ns for t in poses[:, 0]])
    p, q = poses[:, 1:4].astype(float), poses[:, 4:].astype(float)
    rows = table.filter(compute.invert(table["miss"]))
    at = np.searchsorted(pose_ns, rows["t_ns"].to_numpy() - start_ns, side="right") - 1
    exact = pose_ns[at] == rows["t_ns"].to_numpy() - start_ns
    # Two clocks that share few ticks: about one pulse in 8000 is sent when a pose is written.
    assert exact.sum() > 2
    local_m = np.column_stack([rows[f"{axis}_m"].to_numpy() for axis in "xyz"])[exact].astype(float)
    world_m = np.column_stack([rows[f"world_{axis}_m"].to_numpy() for axis in "xyz"])[exact]
    found_m = Rotation.from_quat(q[at[exact]]).apply(local_m) + p[at[exact]]
    assert np.abs(found_m - world_m).max() < 1e-4


def test_truth_alone_is_the_same(run, tmp_path):
    """Without packets, and with other threads, the file has the same bytes."""
    emulator, _, folder = run
    other = Emulator(emulator.scenario, threads=1, like=emulator)
    write_truth(other, TruthTo(tmp_path / "t", 2000, per_return=True), duration_s=SPAN_S)
    assert (tmp_path / "t" / "returns.parquet").read_bytes() == (folder / "returns.parquet").read_bytes()


@pytest.mark.parametrize(
    "events",
    [
        [{"kind": "drop", "at_s": 0.1, "share": 0.3}, {"kind": "duplicate", "at_s": 0.1, "share": 0.2}],
        [{"kind": "setting", "at_s": 0.1, "fov_deg": [40, 44], "return_mode": "dual"}],
    ],
    ids=["wire", "field of view"],
)
def test_packets_that_are_not_sent_have_no_rows(tmp_path, events):
    """Rows are those of the packets that leave, by their number: some are lost or twice, or the field of
    view is narrow."""
    emulator = Emulator("static_bench", {"events": events, "noise.preset": "ideal", "beam.model": "none"})
    emulator.record(tmp_path / "x.pcap", duration_s=0.3, truth=TruthTo(tmp_path / "t", per_return=True))
    payloads = data_payloads(emulator.packets(0.0, 0.3)).view(DATA_PAYLOAD)[:, 0]
    rows = parquet.read_table(tmp_path / "t" / "returns.parquet")
    distance = payloads["blocks"]["records"]["distance_lsb"].reshape(-1)
    assert (np.rint(rows["range_m"].fill_null(0.0).to_numpy().astype(float) / 0.002) == distance).all()
    assert (rows["stamp_us"].to_numpy()[::384] == payloads["timestamp_us"]).all()


def test_memory_holds_no_more_than_a_row_group(tmp_path, monkeypatch):
    """Packets are written in groups of a fixed number, whatever the run, so that the file is the same and
    memory flat."""
    monkeypatch.setattr("vlp16emu.extras.truth.slots._GROUP", 50)
    emulator = Emulator("static_bench", ["beam.model=none"])
    write_truth(emulator, TruthTo(tmp_path / "t", per_return=True), duration_s=0.2)
    groups = parquet.ParquetFile(tmp_path / "t" / "returns.parquet").metadata
    assert [groups.row_group(i).num_rows for i in range(groups.num_row_groups)] == [19_200, 19_200, 19_200]


def nodes_of(path):
    """Labels and triangles (t, 3, 3) in the world of each node of a digital twin."""
    data = path.read_bytes()
    header = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    labels = {node["name"]: node["extras"] for node in header["nodes"] if "part" in node.get("extras", {})}
    scene = trimesh.load_scene(path)
    for name in scene.graph.nodes_geometry:
        transform, geometry = scene.graph[name]
        if name in labels:
            found = tuple(labels[name].get(key, 0) for key in ("semantic", "part", "instance", "species"))
            vertices = trimesh.transform_points(scene.geometry[geometry].vertices, transform)
            yield found, (vertices @ Z_UP)[scene.geometry[geometry].faces]


def test_labels_are_those_of_the_nearest_surface(tmp_path):
    """Of a stand cast leaf by leaf, each place lies on a mesh of the digital twin with its labels, and on
    no other one."""
    settings = ["beam.model=none", "noise.preset=ideal", "sensor.max_range_m=7", "duration_s=0.5"]
    settings += ["world.near_m=inf", "world.stems_per_ha=80", "world.terrain.rough_rms_m=0"]
    write_truth(Emulator("spruce_walk", settings), TruthTo(tmp_path / "t", per_return=True), duration_s=0.1)
    words = ["forest", "spruce_walk", *set_words(settings), "--radius", "7"]
    assert command([*words, "--glb", str(tmp_path / "twin.glb")]) == 0
    table = parquet.read_table(tmp_path / "t" / "returns.parquet")
    rows = table.filter(compute.less(table["range_m"], 6.5))
    rows = rows.take(np.random.default_rng(1).choice(len(rows), 150, replace=False))
    points = np.column_stack([rows[f"world_{axis}_m"].to_numpy() for axis in "xyz"])
    own = list(
        zip(*(rows[name].to_pylist() for name in ("semantic", "part", "instance", "species")), strict=True)
    )
    nearest = [{} for _ in own]
    for labels, triangles in nodes_of(tmp_path / "twin.glb"):
        low, high = triangles.min(axis=(0, 1)) - 2 * EDGE_M, triangles.max(axis=(0, 1)) + 2 * EDGE_M
        if not ((points >= low) & (points <= high)).all(axis=1).any():
            continue
        low, high = triangles.min(axis=1) - 2 * EDGE_M, triangles.max(axis=1) + 2 * EDGE_M
        for i in np.flatnonzero(((points >= low.min(axis=0)) & (points <= high.max(axis=0))).all(axis=1)):
            close = ((points[i] >= low) & (points[i] <= high)).all(axis=1)
            if close.any():
                feet_m = trimesh.triangles.closest_point(
                    triangles[close], np.tile(points[i], (close.sum(), 1))
                )
                gap_m = np.linalg.norm(feet_m - points[i], axis=1).min()
                nearest[i][labels] = min(gap_m, nearest[i].get(labels, np.inf))
    edges = sum(sum(gap < EDGE_M for gap in found.values()) > 1 for found in nearest)
    clear = [
        (mine, min(found, key=found.get))
        for mine, found in zip(own, nearest, strict=True)
        if sum(gap < EDGE_M for gap in found.values()) == 1
    ]
    assert len(clear) > 90, edges
    assert [found for mine, found in clear] == [mine for mine, found in clear]
    assert len({mine[1] for mine, _ in clear}) >= 3
