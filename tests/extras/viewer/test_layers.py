"""Colours of points, and what a browser draws of a mesh."""

from contextlib import closing

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.extras.viewer.layers import LAYERS, coloured, layers_of_scan
from vlp16emu.types import Mesh

pytest.importorskip("viser", reason="the extra viewer is not installed")

from vlp16emu.extras.viewer.stand import fewer_faces, slim_stem
from vlp16emu.extras.viewer.sweeps import CaptureSweeps, SceneSweeps


@pytest.fixture(scope="module")
def emulator():
    return Emulator("static_bench", {"duration_s": 0.5, "noise.preset": "typical"})


def test_every_layer_shows_a_difference(emulator):
    """Each layer colours each point in the hall; things, classes and ranges differ in colour."""
    scan, world_m, _ = SceneSweeps(emulator).at(0.1)
    assert (np.abs(world_m) <= [15.1, 9.1, 6.1]).all()
    assert layers_of_scan(scan) == LAYERS
    for layer in LAYERS:
        colours = coloured(scan, layer, {})[0]
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


def test_fewer_leaves_have_the_area_of_all():
    """Of a thousand equal leaves a hundred are left, whose area is that of all; of others the largest are left as they are."""
    corner_m = np.random.default_rng(1).random((1000, 1, 3))
    leaf_m = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    faces = np.arange(3000, dtype=np.uint32).reshape(-1, 3)
    mesh = Mesh((corner_m + leaf_m).reshape(-1, 3).astype(np.float32), faces)

    def area_m2(mesh):
        a, b, c = mesh.vertices_m[mesh.faces].transpose(1, 0, 2)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2

    few = fewer_faces(mesh, 100, grown=True)
    assert len(few.faces) == 100
    assert area_m2(few) == pytest.approx(area_m2(mesh), rel=1e-3)
    assert area_m2(fewer_faces(mesh, 100, grown=False)) == pytest.approx(area_m2(mesh) / 10, rel=1e-3)


def tube(sides, rings):
    """Stem of 0.3 m that leans and tapers to a point at 10 m, and its faces."""
    turn, up = np.meshgrid(np.arange(sides) * 2 * np.pi / sides, np.linspace(0.0, 1.0, rings))
    radius_m = 0.15 * (1 - up) + 1e-3
    place_m = np.stack([radius_m * np.cos(turn) + 0.4 * up, radius_m * np.sin(turn), 10 * up], axis=-1)
    corner = np.arange(sides * rings).reshape(rings, sides)
    quads = [corner[:-1], np.roll(corner, -1, axis=1)[:-1], np.roll(corner, -1, axis=1)[1:], corner[1:]]
    return Mesh(place_m.reshape(-1, 3).astype(np.float32), np.stack(quads, -1).reshape(-1, 4).astype(np.uint32))


def test_a_slim_stem_stands_where_the_stem_stands():
    """With a tenth of the triangles foot, tip and thickness stay: no corner is a new one, and the foot is whole."""
    stem = tube(24, 40)
    slim = slim_stem(stem)
    assert len(slim.faces) < len(stem.faces) * 2 / 10
    np.testing.assert_allclose(np.ptp(slim.vertices_m, axis=0)[2], 10.0)
    foot_m = slim.vertices_m[slim.vertices_m[:, 2] < 0.1]
    np.testing.assert_allclose(np.hypot(*foot_m[:, :2].T), 0.151, atol=1e-3)
    corners = set(map(tuple, stem.vertices_m.tolist()))
    assert set(map(tuple, slim.vertices_m.tolist())) <= corners
