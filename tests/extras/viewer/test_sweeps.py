"""Sweeps of scenes and captures, their colours, and what a browser draws of a mesh."""

from contextlib import closing

import dpkt
import numpy as np
import pytest
import trimesh
from woods import LINES, THIN

from vlp16emu import Emulator
from vlp16emu.extras.survey import survey
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.run.options import TruthTo
from vlp16emu.scenario import load
from vlp16emu.types import Mesh

pytest.importorskip("viser", reason="the extra viewer is not installed")

from vlp16emu.extras.viewer.layers import LAYERS, colours_of, layers_of_scan
from vlp16emu.extras.viewer.simplify import clumps, fewer_faces, slim_stem
from vlp16emu.extras.viewer.stand import pieces_of
from vlp16emu.extras.viewer.sweeps import CaptureSweeps, SceneSweeps

pytestmark = pytest.mark.usefixtures("kept_woods")

FLAG = 42 + 100  # of the second block, in a frame


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder with a capture of half a second of a walk, and its truth; and the emulator."""
    folder = tmp_path_factory.mktemp("capture")
    settings = THIN | {"sensor.max_range_m": 12.0, "beam.model": "none"}
    emulator = Emulator("birch_walk", settings)
    truth = TruthTo(folder / "truth", per_return=True)
    emulator.record(folder / "walk.pcap", start_s=4.0, duration_s=0.5, truth=truth)
    return folder, emulator


def test_points_of_a_capture_are_where_the_scene_has_them(run):
    """A sweep with ground truth is placed in the world to the steps of the wire, with the labels of the
    scene; ranges too near are blue, too far red."""
    folder, emulator = run
    with closing(CaptureSweeps(folder / "walk.pcap", folder / "truth")) as sweeps:
        sweep = sweeps.at(0.1)
    scans = emulator.scans(start_s=4.0, duration_s=0.5, truth=True)
    (scan,) = (one for one in scans if abs(one.start_ns - sweep.scan.start_ns) < 10**6)
    poses = emulator.world_T_sensor(scan.t_ns)
    world_m = np.einsum("nij,nj->ni", poses[:, :3, :3], scan.xyz_m) + poses[:, :3, 3]
    assert len(world_m) == len(sweep.world_m) > 3_000
    gap_m = np.linalg.norm(world_m - sweep.world_m, axis=1)
    assert np.quantile(gap_m, 0.99) < 0.01
    assert (sweep.scan.labels.semantic == scan.labels.semantic).all()
    assert layers_of_scan(sweep.scan) == LAYERS
    error_m = sweep.scan.distance_m - sweep.scan.labels.range_m
    assert 0.003 < np.median(np.abs(error_m)) < 0.02
    assert not sweep.faults
    red, _, blue = colours_of(sweep.scan, "range error", {})[0].T.astype(int)
    assert (blue > red)[error_m < -0.01].all()
    assert (red > blue)[error_m > 0.01].all()


def test_broken_packets_are_named_and_the_rest_is_shown(run, tmp_path):
    """A packet with a broken flag and one that is lost are named with their sweep; no point of the others
    is missing."""
    folder, _ = run
    with (folder / "walk.pcap").open("rb") as file:
        frames = list(dpkt.pcap.Reader(file))
    data = [i for i, (_, frame) in enumerate(frames) if len(frame) == 1248]
    broken, lost = data[100], data[130]
    stamp, frame = frames[broken]
    frames[broken] = stamp, frame[:FLAG] + b"\xee\xff" + frame[FLAG + 2 :]
    with (tmp_path / "bad.pcap").open("wb") as file:
        writer = dpkt.pcap.Writer(file, nano=True)
        for stamp, frame in frames[:lost] + frames[lost + 1 :]:
            writer.writepkt(frame, stamp)
    with (
        closing(CaptureSweeps(tmp_path / "bad.pcap")) as sweeps,
        closing(CaptureSweeps(folder / "walk.pcap")) as whole,
    ):
        shown, all_shown = (
            {sweep.scan.start_ns: sweep for sweep in map(of.at, np.arange(0.0, 0.5, 0.04))}
            for of in (sweeps, whole)
        )
    faults = [(start_ns, fault) for start_ns, sweep in shown.items() for fault in sweep.faults]
    points, all_points = (sum(len(sweep.world_m) for sweep in of.values()) for of in (shown, all_shown))
    assert sorted(fault.split(": ")[1] for _, fault in faults) == ["flag", "lost-packets"]
    for start_ns, fault in faults:
        at = {"flag": broken, "lost-packets": lost}[fault.split(": ")[1]]
        assert 0 <= round(frames[at][0] * 1e9) - start_ns < 110_000_000
    assert 0 < all_points - points <= 2 * 384


@pytest.fixture(scope="module")
def emulator():
    return Emulator("static_bench", {"duration_s": 0.5, "noise.preset": "typical"})


def test_every_layer_shows_a_difference(emulator):
    """Each layer colours each point in the hall; things, classes and ranges differ in colour."""
    scan, world_m, _ = SceneSweeps(emulator).at(0.1)
    assert (np.abs(world_m) <= [15.1, 9.1, 6.1]).all()
    assert layers_of_scan(scan) == LAYERS
    for layer in LAYERS:
        colours = colours_of(scan, layer, {})[0]
        assert colours.shape == world_m.shape
        if layer not in ("natural", "part", "species", "class"):  # nothing grows in a hall
            assert len(np.unique(colours, axis=0)) > 3, layer


def test_sweeps_of_a_capture_are_found_back_and_forth(emulator, tmp_path):
    """Going back gives the sweep that was there; it has no labels."""
    emulator.record(tmp_path / "bench.pcap")
    with closing(CaptureSweeps(tmp_path / "bench.pcap")) as sweeps:
        late = sweeps.at(sweeps.last_s).scan
        early = sweeps.at(0.0).scan
        assert early.start_ns < late.start_ns
        assert sweeps.at(sweeps.last_s).scan.start_ns == late.start_ns
    assert "class" not in layers_of_scan(early)


def test_a_unit_of_a_rig_turns_at_its_own_speed():
    """A unit of 300 rpm beside one of 1200 has sweeps of a fifth of a second."""
    sweeps = SceneSweeps(
        Emulator("static_bench", {"sensor.rpm": 1200, "rig": [{"rpm": 300}], "duration_s": 1.0}), 2
    )
    assert np.ptp(sweeps.at(0.0).scan.t_ns) == pytest.approx(sweeps.step_s * 1e9, rel=1e-3)


def test_fewer_leaves_have_the_area_of_all():
    """A thousand equal leaves become two hundred of the same total area; unequal ones keep the largest as
    they are."""
    corner_m = np.random.default_rng(1).random((1000, 1, 3))
    leaf_m = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    faces = np.arange(3000, dtype=np.uint32).reshape(-1, 3)
    mesh = Mesh((corner_m + leaf_m).reshape(-1, 3).astype(np.float32), faces)

    def area_m2(mesh):
        a, b, c = mesh.vertices_m[mesh.faces].transpose(1, 0, 2)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2

    few = fewer_faces(mesh, 200, keeps_area=True)
    assert len(few.faces) == 200
    assert area_m2(few) == pytest.approx(area_m2(mesh), rel=1e-3)
    assert area_m2(fewer_faces(mesh, 100, keeps_area=False)) == pytest.approx(area_m2(mesh) / 10, rel=1e-3)


def test_clumps_of_foliage_fill_the_crown():
    """The clumps of ten thousand leaves in a ball are bodies with outward faces, spread as the leaves are,
    of a tenth to a half of the ball's volume: gaps let light through."""
    rng = np.random.default_rng(1)
    middle_m = rng.normal(size=(10_000, 1, 3))
    middle_m *= 2.0 * rng.random((10_000, 1, 1)) ** (1 / 3) / np.linalg.norm(middle_m, axis=-1, keepdims=True)
    leaf_m = np.array([[0, 0, 0], [0.05, 0, 0], [0.05, 0.05, 0], [0, 0.05, 0]])
    faces = np.arange(40_000, dtype=np.uint32).reshape(-1, 4)
    crown = clumps(Mesh((middle_m + leaf_m).reshape(-1, 3).astype(np.float32), faces), 64)
    bodies = trimesh.Trimesh(crown.vertices_m, crown.faces, process=False).split()
    assert len(bodies) == 64
    assert min(body.volume for body in bodies) > 0.0
    assert 0.1 < sum(body.volume for body in bodies) / (4 / 3 * np.pi * 2.0**3) < 0.5
    np.testing.assert_allclose(np.std(crown.vertices_m, axis=0), np.std(middle_m[:, 0], axis=0), rtol=0.25)


def tube(sides, rings):
    """Stem of 0.3 m that leans and tapers to a point at 10 m, and its faces."""
    turn, up = np.meshgrid(np.arange(sides) * 2 * np.pi / sides, np.linspace(0.0, 1.0, rings))
    radius_m = 0.15 * (1 - up) + 1e-3
    place_m = np.stack([radius_m * np.cos(turn) + 0.4 * up, radius_m * np.sin(turn), 10 * up], axis=-1)
    corner = np.arange(sides * rings).reshape(rings, sides)
    quads = [corner[:-1], np.roll(corner, -1, axis=1)[:-1], np.roll(corner, -1, axis=1)[1:], corner[1:]]
    return Mesh(
        place_m.reshape(-1, 3).astype(np.float32), np.stack(quads, -1).reshape(-1, 4).astype(np.uint32)
    )


def test_a_slim_stem_stands_where_the_stem_stands():
    """With a tenth of the triangles foot, tip and thickness stay: no corner is a new one, and the foot is
    whole."""
    stem = tube(24, 40)
    slim = slim_stem(stem)
    assert len(slim.faces) < len(stem.faces) * 2 / 10
    np.testing.assert_allclose(np.ptp(slim.vertices_m, axis=0)[2], 10.0)
    foot_m = slim.vertices_m[slim.vertices_m[:, 2] < 0.1]
    np.testing.assert_allclose(np.hypot(*foot_m[:, :2].T), 0.151, atol=1e-3)
    corners = set(map(tuple, stem.vertices_m.tolist()))
    assert set(map(tuple, slim.vertices_m.tolist())) <= corners


def test_the_stand_fades_towards_its_edge():
    """Ground far from the path is lighter than at the path, and no edge is darker than its neighbour."""
    seen = survey(load("birch_walk", [*LINES, "duration_s=2.0"]), 10.0)
    shades = [
        int(piece["batched_colors"].sum()) for name, piece in pieces_of(seen) if name.startswith("ground")
    ]
    assert shades == sorted(shades)
    assert shades[0] < 600
    assert shades[-1] > 650


def test_stems_are_drawn_with_their_crowns_only():
    """Nothing is drawn farther from a path than the radius and the width of a crown: no bare stems beyond."""
    dense = [*LINES, "world.stems_per_ha=900", "duration_s=5.0"]
    seen = survey(load("birch_walk", dense), 10.0)
    path = Polyline(seen.path_m[:, :2])
    farthest_m = [
        path.distance_m(
            (piece["vertices"][:, None, :2] + piece["batched_positions"][None, :, :2]).reshape(-1, 2)
        ).max()
        for name, piece in pieces_of(seen)
        if name.startswith("single")
    ]
    assert farthest_m
    assert max(farthest_m) < 10.0 + 5.0


def test_stems_stand_on_the_ground():
    """Each drawn tree has corners in the ground at its foot: no stem ends in the air over a root flare."""
    seen = survey(load("birch_walk", [*LINES, "world.stems_per_ha=400", "duration_s=2.0"]), 10.0)
    corners_m = np.concatenate(
        [piece["vertices"] for name, piece in pieces_of(seen) if name.startswith("single")]
    )
    path = Polyline(seen.path_m[:, :2])
    trees = seen.world.trees(seen.path_m)
    trees = trees[trees["storey"] != REGENERATION]
    feet_m = np.column_stack([trees[name] for name in ("x_m", "y_m", "z_m")])
    feet_m = feet_m[path.distance_m(feet_m[:, :2]) < 8.0]
    assert len(feet_m) > 5
    for foot_m in feet_m:
        over_m = corners_m - foot_m
        assert over_m[np.hypot(*over_m[:, :2].T) < 0.5, 2].min() < 0.02
