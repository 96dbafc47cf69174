"""The fast caster against the slow twin, and against itself."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from raycast import lab
from raycast.reference import ReferenceScene, flatten, ranges_m

from vlp16emu.raycast import build
from vlp16emu.raycast.build import widen
from vlp16emu.raycast.near import EmbreeCaster
from vlp16emu.types import NO_SURFACE, Mesh


@pytest.mark.parametrize("share", [1, 4])
def test_hits_are_those_of_the_slow_twin(workers, share):
    """Ranges, surfaces and incidence of turned, mirrored and scaled instances at UTM coordinates, of which
    some each show one surface, equal brute force in float64."""
    window = lab.placed(30)
    window = replace(window, first_surface=(window.first_surface // share * (share // 2 or 1)).astype("u4"))
    scenes = lab.opened(workers, window), ReferenceScene(window, lab.soup)
    fast, slow = (scene.cast(lab.pulses(64, every=4), lab.NEAR_M[::4], lab.FAR_M) for scene in scenes)
    hit = np.isfinite(fast.range_m)
    assert 0.5 < hit.mean() < 1.0
    assert (fast.surface == slow.surface).all()
    assert np.abs(fast.range_m[hit] - slow.range_m[hit]).max() < 5e-6
    assert np.abs(fast.cos_incidence - slow.cos_incidence).max() < 1e-5


def test_shapes_are_kept_from_window_to_window(workers):
    """A shape that an open window holds is not grown again; one that no window holds is dropped."""
    grown = []

    def grow(key):
        grown.append(key)
        return lab.soup(key)

    caster = EmbreeCaster(lab.world(grow), workers)
    first = caster.open(lab.placed(10))
    second = caster.open(lab.placed(20))
    assert sorted(grown) == [1, 2, 3]
    del first, second
    gc.collect()
    caster.open(lab.placed(10))
    assert sorted(grown) == [1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize(
    ("wall_m", "reach_m", "is_seen"),
    [
        (0.02, 100.0, False),
        (0.5, 100.0, True),
        (100.0, 100.0, True),
        (100.001, 100.0, False),
        (131.07, 131.07, True),
    ],
)
def test_light_begins_at_the_lens_and_ends_at_its_reach(workers, wall_m, reach_m, is_seen):
    """A wall nearer than the lens or farther than the reach is not seen; one between or just there is, at
    its distance."""
    scene = lab.opened(workers, *lab.upright((wall_m, -50.0, 50.0, -50.0, 50.0)))
    hits = scene.cast(lab.level_pulses(np.zeros(8)), np.array([0.0419]), reach_m)
    assert hits.range_m[0] == (np.float32(wall_m) if is_seen else np.inf)


@pytest.mark.parametrize("count", [0, 30])
@pytest.mark.parametrize("model", ["none", "adaptive"])
def test_where_nothing_stands_all_is_sky(workers, count, model):
    """An empty window, and meshes without faces, are met by no ray; an adaptive beam ends after its first
    round."""
    empty = Mesh(np.zeros((0, 3), "f4"), np.zeros((0, 3), "u4"))
    scene = lab.opened(workers, lab.placed(count), lambda _: (empty, empty))
    hits = scene.cast(lab.pulses(8), lab.NEAR_M, lab.FAR_M, lab.beam(model))
    assert (hits.count == (1 if model == "none" else 8)).all()
    assert np.isinf(hits.range_m).all()
    assert (hits.surface == NO_SURFACE).all()


def test_rays_at_edges_and_corners_are_decided_in_float64(workers):
    """Of 240 rays at edges and corners, where Embree's instruction sets differ, each meets the first of
    the nearest in float64, to 2 um."""
    window, rng, n = lab.placed(30), np.random.default_rng(8), 240
    corners_m, surfaces = flatten(window, lab.soup)
    share = rng.dirichlet([1.0, 1.0, 1.0], n)
    share[: 2 * n // 3, 2] = 0.0  # on an edge, and half of those in a corner
    share[: n // 3, 1] = 0.0
    share /= share.sum(axis=1)[:, None]
    at_m = np.einsum("ni,nij->nj", share, corners_m[rng.integers(0, len(corners_m), n)])
    origin_m = rng.uniform(-1, 1, (n, 3))
    direction = (at_m - origin_m) / np.linalg.norm(at_m - origin_m, axis=1)[:, None]
    hits = lab.opened(workers).cast(lab.rays(origin_m + window.origin_m, direction), np.zeros(1), lab.FAR_M)
    from_m = (origin_m + window.origin_m - window.origin_m).astype("f4").astype(float)
    rows = zip(from_m, direction.astype("f4").astype(float), hits.range_m, hits.surface, strict=True)
    for at_m, along, range_m, surface in rows:
        true_m = ranges_m(corners_m, at_m, along)
        true_m[true_m < 0.0] = np.inf
        assert surface == (surfaces[true_m.argmin()] if np.isfinite(true_m).any() else NO_SURFACE)
        assert range_m == pytest.approx(true_m.min(), abs=2e-6)
    assert np.isfinite(hits.range_m).mean() > 0.8


def test_of_two_faces_at_one_place_the_first_is_met(workers):
    """Of walls at the same place, each ray meets the one with the lowest number, at their range."""
    wall = (10.0, -3.0, 3.0, -3.0, 3.0)
    scene = lab.opened(workers, *lab.upright(wall, wall, wall))
    hits = scene.cast(lab.level_pulses(np.linspace(-2.5, 2.5, 64)), np.zeros(1), 60.0)
    assert (hits.surface == 0).all()
    assert (hits.range_m == 10.0).all()


@pytest.mark.parametrize("model", ["none", "adaptive"])
def test_no_number_of_embree_reaches_a_hit(workers, monkeypatch, model):
    """With Embree's triangles off by up to 20 um, each in a way of its own, every hit has the same bits."""
    cast = lab.pulses(256), lab.NEAR_M, lab.FAR_M, lab.beam(model)
    true, rng = lab.opened(workers).cast(*cast), np.random.default_rng(9)

    def disturbed(vertices_m, triangles):
        wider_m = widen(vertices_m, triangles)
        return wider_m + rng.uniform(-2e-5, 2e-5, wider_m.shape).astype("f4")

    monkeypatch.setattr(build, "widen", disturbed)
    lab.assert_same_bits(true, lab.opened(workers).cast(*cast))


def test_embree_reads_corners_only_until_a_scene_is_committed(workers, monkeypatch):
    """With numbers that are none in the arrays of corners that Embree was given, every hit has the same
    bits."""
    cast, given = (lab.pulses(256), lab.NEAR_M, lab.FAR_M), []
    monkeypatch.setattr(build, "widen", lambda *faces: given.append(widen(*faces)) or given[-1])
    true = (scene := lab.opened(workers)).cast(*cast)
    for wider_m in given:
        wider_m[:] = np.nan
    lab.assert_same_bits(true, scene.cast(*cast))


def test_the_layout_of_arrays_does_not_matter(workers):
    """Meshes whose vertices and faces are views with gaps, or stored by columns, are met in the bits of
    plain ones."""

    def spread(array):
        room = np.zeros((2 * len(array), array.shape[1] + 1), array.dtype)
        room[::2, 1:] = array
        return room[::2, 1:]

    def views(key):
        triangles, quads = lab.soup(key)
        columns = Mesh(np.asfortranarray(quads.vertices_m), np.asfortranarray(quads.faces))
        return Mesh(spread(triangles.vertices_m), spread(triangles.faces)), columns

    cast = lab.pulses(256), lab.NEAR_M, lab.FAR_M
    lab.assert_same_bits(*(lab.opened(workers, shape=shape).cast(*cast) for shape in (lab.soup, views)))
