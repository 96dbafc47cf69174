"""The fast caster against the slow twin, and against itself."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from raycast import lab
from raycast.reference import ReferenceCaster, flatten, ranges_m

from vlp16emu.raycast import build
from vlp16emu.raycast.build import widened
from vlp16emu.raycast.near import EmbreeCaster
from vlp16emu.types import NO_SURFACE, Mesh


def assert_same_hits(ours, other, *, range_m, cosine):
    """Both casters hit the same, to the given errors."""
    assert (np.isfinite(ours.range_m) == np.isfinite(other.range_m)).all()
    hit = np.isfinite(ours.range_m)
    assert 0.5 < hit.mean() < 1.0
    assert (ours.surface == other.surface).all()
    assert np.abs(ours.range_m[hit] - other.range_m[hit]).max() < range_m
    assert np.abs(ours.cos_incidence - other.cos_incidence).max() < cosine


@pytest.mark.parametrize("share", [1, 4])
def test_hits_are_those_of_the_slow_twin(workers, share):
    """Ranges, surfaces and incidence of turned, mirrored and scaled instances at UTM coordinates, of which some each show one surface, equal brute force in float64."""
    window, firings = lab.placed(30), lab.pulses(64)
    window = replace(window, first_surface=(window.first_surface // share * (share // 2 or 1)).astype("u4"))
    fast = EmbreeCaster(lab.world(lab.soup), workers).open(window).cast(firings, lab.NEAR_M, lab.FAR_M)
    slow = ReferenceCaster(lab.soup).open(window).cast(firings, lab.NEAR_M, lab.FAR_M)
    assert_same_hits(fast, slow, range_m=5e-6, cosine=1e-5)


def test_distance_from_the_origin_of_the_world_does_not_matter(workers):
    """The same scene at UTM coordinates, at 1e7 m and at zero gives the same distances."""
    caster = EmbreeCaster(lab.world(lab.soup), workers)
    ranges = [
        caster.open(lab.placed(30, at=at)).cast(lab.pulses(320, at=at), lab.NEAR_M, lab.FAR_M).range_m
        for at in (np.zeros(3), lab.UTM_M, np.array([1e7, -1e7, 0.0]))
    ]
    for other in ranges[1:]:
        same = np.isfinite(ranges[0]) & np.isfinite(other)
        assert (np.isfinite(ranges[0]) == np.isfinite(other)).mean() > 0.9999
        difference_m = np.abs(ranges[0][same] - other[same])
        assert np.median(difference_m) < 1e-6
        assert np.quantile(difference_m, 0.999) < 1e-4


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
    [(0.02, 100.0, False), (0.5, 100.0, True), (100.0, 100.0, True), (100.001, 100.0, False), (131.07, 131.07, True)],
)
def test_light_begins_at_the_lens_and_ends_at_its_reach(workers, wall_m, reach_m, is_seen):
    """A wall nearer than the lens or farther than the reach is not seen; one between or just there is, at its distance."""
    window, shape = lab.upright((wall_m, -50.0, 50.0, -50.0, 50.0))
    scene = EmbreeCaster(lab.world(shape), workers).open(window)
    hits = scene.cast(lab.level_pulses(np.zeros(8)), np.array([0.0419]), reach_m)
    assert hits.range_m[0] == (np.float32(wall_m) if is_seen else np.inf)


@pytest.mark.parametrize("count", [0, 30])
@pytest.mark.parametrize("model", ["none", "adaptive"])
def test_where_nothing_stands_all_is_sky(workers, count, model):
    """An empty window, and meshes without faces, are met by no ray; an adaptive beam ends after its first round."""
    empty = Mesh(np.zeros((0, 3), "f4"), np.zeros((0, 3), "u4"))
    scene = EmbreeCaster(lab.world(lambda _: (empty, empty)), workers).open(lab.placed(count))
    hits = scene.cast(lab.pulses(8), lab.NEAR_M, lab.FAR_M, lab.beam(model))
    assert (hits.count == (1 if model == "none" else 8)).all()
    assert np.isinf(hits.range_m).all()
    assert (hits.surface == NO_SURFACE).all()


def test_a_broken_packet_is_refused(workers):
    """Firings that do not fill packets of eight rays are a programming error and named."""
    scene = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(1))
    with pytest.raises(ValueError, match="found 12 sequences, expected a multiple of 8"):
        scene.cast(lab.pulses(12), lab.NEAR_M, lab.FAR_M)


def brute_force(window, meshes, origin_m, direction):
    """Range and surface of the nearest triangle on each ray (n, 3), in float64, the first one where several are as near."""
    corners_m, surfaces = flatten(window, meshes)
    range_m, surface = np.full(len(origin_m), np.inf), np.full(len(origin_m), NO_SURFACE, "u4")
    for i, (from_m, along) in enumerate(zip(origin_m, direction, strict=True)):
        at_m = ranges_m(corners_m, from_m, along)
        at_m[at_m < 0.0] = np.inf
        if np.isfinite(at_m).any():
            range_m[i], surface[i] = at_m.min(), surfaces[at_m.argmin()]
    return range_m, surface


def test_rays_at_edges_and_corners_are_decided_in_float64(workers):
    """Of 912 rays at edges and corners, where Embree's instruction sets differ, each meets what float64 says, to 2 um."""
    window, rng = lab.placed(30), np.random.default_rng(8)
    corners_m, _ = flatten(window, lab.soup)
    chosen = rng.integers(0, len(corners_m), 912)
    share = rng.dirichlet([1.0, 1.0, 1.0], 912)
    share[:608, 2] = 0.0  # on an edge, and half of those in a corner
    share[:304, 1] = 0.0
    share /= share.sum(axis=1)[:, None]
    at_m = np.einsum("ni,nij->nj", share, corners_m[chosen])
    origin_m = np.zeros(3) + rng.uniform(-1, 1, (912, 3))
    direction = at_m - origin_m
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    hits = (
        EmbreeCaster(lab.world(lab.soup), workers)
        .open(window)
        .cast(lab.rays(origin_m + window.origin_m, direction), np.zeros(1), lab.FAR_M)
    )
    from_m = (origin_m + window.origin_m - window.origin_m).astype("f4").astype(float)
    range_m, surface = brute_force(window, lab.soup, from_m, direction.astype("f4").astype(float))
    assert np.array_equal(hits.surface, surface)
    hit = np.isfinite(range_m)
    assert hit.mean() > 0.8
    assert np.abs(hits.range_m[hit] - range_m[hit]).max() < 2e-6


def test_of_two_faces_at_one_place_the_first_is_met(workers):
    """Of walls at the same place, each ray meets the one with the lowest number, at their range."""
    wall = (10.0, -3.0, 3.0, -3.0, 3.0)
    window, shape = lab.upright(wall, wall, wall)
    y_m = np.linspace(-2.5, 2.5, 64)
    hits = EmbreeCaster(lab.world(shape), workers).open(window).cast(lab.level_pulses(y_m), np.zeros(1), 60.0)
    assert (hits.surface == 0).all()
    assert (hits.range_m == 10.0).all()


@pytest.mark.parametrize("model", ["none", "adaptive"])
def test_no_number_of_embree_reaches_a_hit(workers, monkeypatch, model):
    """With Embree's triangles off by up to 20 um, each in a way of its own, every hit has the same bits."""
    window, firings, beam = lab.placed(30), lab.pulses(256), lab.beam(model)
    true = EmbreeCaster(lab.world(lab.soup), workers).open(window).cast(firings, lab.NEAR_M, lab.FAR_M, beam)
    rng = np.random.default_rng(9)

    def disturbed(vertices_m, triangles):
        wider_m = widened(vertices_m, triangles)
        return wider_m + rng.uniform(-2e-5, 2e-5, wider_m.shape).astype("f4")

    monkeypatch.setattr(build, "widened", disturbed)
    other = EmbreeCaster(lab.world(lab.soup), workers).open(window).cast(firings, lab.NEAR_M, lab.FAR_M, beam)
    lab.assert_same_bits(true, other)


def test_the_layout_of_arrays_does_not_matter(workers):
    """Meshes whose vertices and faces are views with gaps, or stored by columns, are met in the bits of plain ones."""

    def spread(array):
        room = np.zeros((2 * len(array), array.shape[1] + 1), array.dtype)
        room[::2, 1:] = array
        return room[::2, 1:]

    def views(key):
        triangles, quads = lab.soup(key)
        columns = Mesh(np.asfortranarray(quads.vertices_m), np.asfortranarray(quads.faces))
        return Mesh(spread(triangles.vertices_m), spread(triangles.faces)), columns

    window, firings = lab.placed(30), lab.pulses(256)
    plain, other = (
        EmbreeCaster(lab.world(shape), workers).open(window).cast(firings, lab.NEAR_M, lab.FAR_M)
        for shape in (lab.soup, views)
    )
    lab.assert_same_bits(plain, other)
