"""The fast caster against the slow twin, and against itself."""

import gc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from raycast.reference import ReferenceCaster, flatten

from vlp16emu.raycast import build
from vlp16emu.raycast.build import widened
from vlp16emu.raycast.near import EmbreeCaster
from vlp16emu.types import NO_SURFACE, SURFACE, Mesh, Window


def assert_same_hits(ours, other, *, range_m, cosine):
    """Both casters hit the same, to the given errors."""
    assert (np.isfinite(ours.range_m) == np.isfinite(other.range_m)).all()
    hit = np.isfinite(ours.range_m)
    assert 0.5 < hit.mean() < 1.0
    assert (ours.surface == other.surface).all()
    assert np.abs(ours.range_m[hit] - other.range_m[hit]).max() < range_m
    assert np.abs(ours.cos_incidence - other.cos_incidence).max() < cosine


def test_hits_are_those_of_the_slow_twin(lab, workers):
    """Ranges, surfaces and incidence of turned and scaled instances at UTM coordinates equal brute force in float64."""
    window, firings = lab.placed(30), lab.pulses(64)
    fast = EmbreeCaster(lab.world(lab.soup), workers).open(window).cast(firings, lab.near_m, lab.far_m)
    slow = ReferenceCaster(lab.soup).open(window).cast(firings, lab.near_m, lab.far_m)
    assert_same_hits(fast, slow, range_m=5e-6, cosine=1e-5)


def test_things_that_share_a_surface_are_hit_alike(lab, workers):
    """Turned, mirrored and scaled things of which four each show one surface hit the same as by the slow twin."""
    shared = lab.placed(30)
    shared = replace(shared, first_surface=(shared.first_surface // 4 * 2).astype("u4"))
    firings = lab.pulses(64)
    fast = EmbreeCaster(lab.world(lab.soup), workers).open(shared).cast(firings, lab.near_m, lab.far_m)
    slow = ReferenceCaster(lab.soup).open(shared).cast(firings, lab.near_m, lab.far_m)
    assert_same_hits(fast, slow, range_m=5e-6, cosine=1e-5)


def test_an_empty_mesh_does_not_matter(lab, workers):
    """Meshes without faces are no obstacle, and hit nothing."""
    empty = Mesh(np.zeros((0, 3), "f4"), np.zeros((0, 3), "u4"))
    window, firings = lab.placed(30), lab.pulses(8)
    scene = EmbreeCaster(lab.world(lambda _: (empty, empty)), workers).open(window)
    assert np.isinf(scene.cast(firings, lab.near_m, lab.far_m).range_m).all()


def test_distance_from_the_origin_of_the_world_does_not_matter(lab, workers):
    """The same scene at UTM coordinates, at 1e7 m and at zero gives the same distances."""
    caster = EmbreeCaster(lab.world(lab.soup), workers)
    ranges = [
        caster.open(lab.placed(30, at=at)).cast(lab.pulses(320, at=at), lab.near_m, lab.far_m).range_m
        for at in (np.zeros(3), lab.utm_m, np.array([1e7, -1e7, 0.0]))
    ]
    for other in ranges[1:]:
        same = np.isfinite(ranges[0]) & np.isfinite(other)
        assert (np.isfinite(ranges[0]) == np.isfinite(other)).mean() > 0.9999
        difference_m = np.abs(ranges[0][same] - other[same])
        assert np.median(difference_m) < 1e-6
        assert np.quantile(difference_m, 0.999) < 1e-4


def test_batches_do_not_matter(lab, workers):
    """Cast in one go or in pieces of eight firings: the same bits."""
    scene = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30))
    whole = scene.cast(lab.pulses(64), lab.near_m, lab.far_m)
    for first in range(0, 64, 8):
        piece = scene.cast(lab.pulses(8, first=first), lab.near_m, lab.far_m)
        rows = slice(16 * first, 16 * (first + 8))
        assert (piece.range_m == whole.range_m[rows]).all()
        assert (piece.surface == whole.surface[rows]).all()
        assert (piece.cos_incidence == whole.cos_incidence[rows]).all()


def test_threads_do_not_matter(lab, workers):
    """Eight casts at once on a shared scene give the bits of one cast alone."""
    scene, firings = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.pulses(320)
    alone = scene.cast(firings, lab.near_m, lab.far_m)
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(lambda _: scene.cast(firings, lab.near_m, lab.far_m), range(8)))
    for hits in together:
        assert (hits.range_m == alone.range_m).all()
        assert (hits.surface == alone.surface).all()


def test_building_is_repeatable(lab, workers):
    """Two builds of the same window, on any thread, give the same bits."""
    window, firings = lab.placed(30), lab.pulses(320)
    first, second = (
        EmbreeCaster(lab.world(lab.soup), workers).open(window).cast(firings, lab.near_m, lab.far_m) for _ in range(2)
    )
    assert (first.range_m == second.range_m).all()
    assert (first.surface == second.surface).all()
    assert (first.cos_incidence == second.cos_incidence).all()


def test_shapes_are_kept_from_window_to_window(lab, workers):
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


def test_light_begins_at_the_lens_and_ends_at_its_reach(lab, workers):
    """A wall nearer than the lens or farther than the reach is not seen; one between is, at its distance."""

    def wall(_key):
        vertices = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]], "f4")
        return (Mesh(vertices, np.array([[0, 1, 2, 3]], "u4")),)

    from vlp16emu.types import Firings

    origin_m, direction = np.zeros((8, 1, 3)), np.zeros((8, 1, 3))
    direction[..., 2] = -1.0
    one = np.zeros((8, 1))
    firings = Firings(0, one.astype(np.int64), np.zeros(8, np.int64), one, np.zeros(8), origin_m, direction, None)
    seen = {}
    for depth_m in (0.02, 0.5, 99.0, 101.0):
        transform = np.eye(3, 4)[None].copy()
        transform[0, 2, 3] = -depth_m
        window = Window(np.zeros(3), ("wall",), np.zeros(1, "i4"), transform, np.zeros(1, "u4"), np.zeros(1, SURFACE))
        hits = EmbreeCaster(lab.world(wall), workers).open(window).cast(firings, np.array([0.0419]), 100.0)
        seen[depth_m] = float(hits.range_m[0])
    assert seen == {0.02: np.inf, 0.5: 0.5, 99.0: 99.0, 101.0: np.inf}


def test_empty_window_is_all_sky(lab, workers):
    """Nothing placed, nothing hit."""
    hits = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(0)).cast(lab.pulses(8), lab.near_m, lab.far_m)
    assert np.isinf(hits.range_m).all()
    assert (hits.surface == NO_SURFACE).all()


def test_a_broken_packet_is_refused(lab, workers):
    """Firings that do not fill packets of eight rays are a programming error and named."""
    scene = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(1))
    with pytest.raises(ValueError, match="found 12 sequences, expected a multiple of 8"):
        scene.cast(lab.pulses(12), lab.near_m, lab.far_m)


def brute_force(window, meshes, origin_m, direction):
    """Range and surface of the nearest triangle on each ray (n, 3), in float64, the first one where several are as near."""
    corners_m, surfaces = flatten(window, meshes)
    a_m, u, v = corners_m[:, 0], corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]
    range_m, surface = np.full(len(origin_m), np.inf), np.full(len(origin_m), NO_SURFACE, "u4")
    for i, (from_m, along) in enumerate(zip(origin_m, direction, strict=True)):
        across, to_m = np.cross(along, v), from_m - a_m
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / (u * across).sum(axis=1)
            first, turned = scale * (to_m * across).sum(axis=1), np.cross(to_m, u)
            second, at_m = scale * (turned @ along), scale * (turned * v).sum(axis=1)
            inside = (first >= 0) & (second >= 0) & (first + second <= 1) & (at_m >= 0)
        if inside.any():
            nearest = np.flatnonzero(inside)[at_m[inside].argmin()]
            range_m[i], surface[i] = at_m[nearest], surfaces[nearest]
    return range_m, surface


def test_rays_at_edges_and_corners_are_decided_in_float64(lab, workers):
    """Of 3 000 rays at edges and corners, where Embree's instruction sets differ, each meets what float64 says, to 2 um."""
    window, rng = lab.placed(30), np.random.default_rng(8)
    corners_m, _ = flatten(window, lab.soup)
    chosen = rng.integers(0, len(corners_m), 3000)
    share = rng.dirichlet([1.0, 1.0, 1.0], 3000)
    share[:2000, 2] = 0.0  # on an edge, and half of those in a corner
    share[:1000, 1] = 0.0
    share /= share.sum(axis=1)[:, None]
    at_m = np.einsum("ni,nij->nj", share, corners_m[chosen])
    origin_m = np.zeros(3) + rng.uniform(-1, 1, (3000, 3))
    direction = at_m - origin_m
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    hits = (
        EmbreeCaster(lab.world(lab.soup), workers)
        .open(window)
        .cast(lab.rays(origin_m + window.origin_m, direction), np.zeros(1), lab.far_m)
    )
    from_m = (origin_m + window.origin_m - window.origin_m).astype("f4").astype(float)
    range_m, surface = brute_force(window, lab.soup, from_m, direction.astype("f4").astype(float))
    assert np.array_equal(hits.surface, surface)
    hit = np.isfinite(range_m)
    assert hit.mean() > 0.8
    assert np.abs(hits.range_m[hit] - range_m[hit]).max() < 2e-6


def test_of_two_faces_at_one_place_the_first_is_met(lab, workers):
    """Of walls at the same place, each ray meets the one with the lowest number, at their range."""
    wall = (10.0, -3.0, 3.0, -3.0, 3.0)
    window, shape = lab.upright(wall, wall, wall)
    y_m = np.linspace(-2.5, 2.5, 64)
    hits = EmbreeCaster(lab.world(shape), workers).open(window).cast(lab.level_pulses(y_m), np.zeros(1), 60.0)
    assert (hits.surface == 0).all()
    assert (hits.range_m == 10.0).all()


@pytest.mark.parametrize("model", ["none", "adaptive"])
def test_no_number_of_embree_reaches_a_hit(lab, workers, monkeypatch, model):
    """With Embree's triangles off by up to 20 um, each in a way of its own, every hit has the same bits."""
    window, firings, beam = lab.placed(30), lab.pulses(256), lab.beam(model)
    true = EmbreeCaster(lab.world(lab.soup), workers).open(window).cast(firings, lab.near_m, lab.far_m, beam)
    rng = np.random.default_rng(9)

    def disturbed(vertices_m, triangles):
        wider_m = widened(vertices_m, triangles)
        return wider_m + rng.uniform(-2e-5, 2e-5, wider_m.shape).astype("f4")

    monkeypatch.setattr(build, "widened", disturbed)
    other = EmbreeCaster(lab.world(lab.soup), workers).open(window).cast(firings, lab.near_m, lab.far_m, beam)
    for name in ("count", "range_m", "surface", "cos_incidence"):
        assert getattr(true, name).tobytes() == getattr(other, name).tobytes()


def test_the_layout_of_arrays_does_not_matter(lab, workers):
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
        EmbreeCaster(lab.world(shape), workers).open(window).cast(firings, lab.near_m, lab.far_m)
        for shape in (lab.soup, views)
    )
    for name in ("range_m", "surface", "cos_incidence"):
        assert getattr(plain, name).tobytes() == getattr(other, name).tobytes()
