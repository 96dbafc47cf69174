"""What is far beside what is near: stems and ground against their meshes, windows, users' walls, and wind."""

import itertools
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from raycast import lab

from vlp16emu.foliage import far as room
from vlp16emu.foliage.far import FarCaster
from vlp16emu.foliage.ground import greatest_steps_m
from vlp16emu.raycast.near import EmbreeGeometry
from vlp16emu.types import NO_SURFACE, SURFACE, Mesh, PlantPart, Semantic, Window

AT_M = np.array([[10.0, 10.0, 6.0]])


def around(count, at_m, *, low_deg=-15.0, high_deg=15.0, seed=2):
    """Rays (count, 3) from a place, all around, by azimuth."""
    rng = np.random.default_rng(seed)
    azimuth = np.sort(rng.uniform(0, 2 * np.pi, count))
    sine = np.sin(np.radians(rng.uniform(low_deg, high_deg, count)))
    level = np.sqrt(1 - sine**2)
    direction = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), sine])
    return np.broadcast_to(np.asarray(at_m, float), (count, 3)), direction


def cast(scene, origin_m, direction, far_m=60.0, **beam):
    light = [lab.beam(**beam)] if beam else []
    return scene.cast(lab.rays(origin_m, direction), np.zeros(1), far_m, *light)


@pytest.fixture(scope="module")
def both(workers):
    """Nine bare tiles, and their window as a medium from 2 m on and as faces."""
    far, near = (lab.Tiles(near_m, things=False, per_tile=8) for near_m in (2.0, math.inf))
    window = far.window(AT_M)
    return window, FarCaster(far, workers).open(window), FarCaster(near, workers).open(window)


def part_of(window, surface):
    """Part of each surface, 255 where nothing was met."""
    known = np.where(surface == NO_SURFACE, 0, surface)
    return np.where(surface == NO_SURFACE, 255, window.surfaces["part"][known])


def stems_alike(window, ours, true, *, same_share, high_m):
    """Which true hits are of stems, and which agree in surface, after both casts are seen to agree on
    stems."""
    stem = np.isin(part_of(window, true.surface), [PlantPart.STEM, PlantPart.ROOT_FLARE])
    assert stem.sum() > 2000
    same = ours.surface == true.surface
    assert same[stem].mean() > same_share
    off_m = np.abs(ours.range_m[stem & same] - true.range_m[stem & same])
    assert np.median(off_m) < 0.003
    assert np.quantile(off_m, 0.95) < high_m
    return stem, same


def test_stems_from_afar_are_those_of_the_mesh(both):
    """Ranges to stems equal those of polygons with as much area within 3 mm in the median; labels agree
    for 99 % of rays."""
    window, far, near = both
    ours, true = (cast(scene, *around(40_000, AT_M[0])) for scene in (far, near))
    stem, same = stems_alike(window, ours, true, same_share=0.99, high_m=0.02)
    off = np.abs(ours.cos_incidence - true.cos_incidence)[stem & same]
    assert np.median(off) < 0.03  # a polygon's faces are flat


def test_bent_stems_from_afar_are_those_of_the_mesh(workers, both):
    """Stems that bow by 0.25 m are met where their polygons are, within 3 mm in the median; as straight
    ones they would not."""
    worlds = [lab.Tiles(near_m, things=False, per_tile=8, bow_m=0.25) for near_m in (2.0, math.inf)]
    scenes = [*(FarCaster(world, workers).open(world.window(AT_M)) for world in worlds), both[1]]
    ours, true, straight = (cast(scene, *around(40_000, AT_M[0])) for scene in scenes)
    stem, _ = stems_alike(worlds[0].window(AT_M), ours, true, same_share=0.985, high_m=0.03)
    assert (straight.surface == true.surface)[stem].mean() < 0.9


def test_the_steepest_ground_is_between_known_heights():
    """The greatest steps along both axes are those of all neighbours with known heights; 0 without any."""
    height_m = np.random.default_rng(1).normal(0.0, 3.0, (30, 40)).astype(np.float32)
    unknown = np.random.default_rng(2).random((30, 40)) < 0.3
    height_m[unknown] = -1e6
    known_x, known_y = ~unknown[1:] & ~unknown[:-1], ~unknown[:, 1:] & ~unknown[:, :-1]
    expected = np.abs(np.diff(height_m, axis=0))[known_x].max(), np.abs(np.diff(height_m))[known_y].max()
    assert greatest_steps_m(height_m, -5e5) == expected
    assert greatest_steps_m(np.full((3, 3), -1e6, np.float32), -5e5) == (0.0, 0.0)


def test_the_ground_from_afar_is_that_of_the_mesh(both):
    """Ranges to the ground equal those of its triangles within 2 mm in the median, incidence alike; labels
    agree."""
    window, far, near = both
    ours, true = (
        cast(scene, *around(40_000, AT_M[0], low_deg=-60.0, high_deg=-2.0)) for scene in (far, near)
    )
    ground = (true.surface != NO_SURFACE) & (part_of(window, true.surface) == PlantPart.NONE)
    assert ground.sum() > 20_000
    same = ours.surface == true.surface
    assert same[ground].mean() > 0.995
    off_m = np.abs(ours.range_m[ground & same] - true.range_m[ground & same])
    assert np.median(off_m) < 0.002
    assert np.quantile(off_m, 0.99) < 0.05
    assert np.quantile(np.abs(ours.cos_incidence - true.cos_incidence)[ground & same], 0.98) < 0.01


def test_a_circle_fitted_at_30_m_has_the_dbh(workers):
    """Rays at the height of a stem's knot, 30 m away, lie on a circle of its diameter within 1 mm."""
    world = lab.Tiles(2.0, across=2, things=False, per_tile=1, height_m=lambda x, y: 0.0 * x + 0.0 * y)
    tiles = [(0, 0), (1, 0)]
    stem = world.tile(1, 0)[0][0]
    knot = 4
    middle_m = stem["foot_m"] + stem["along_m"][knot] * stem["axis"]
    at_m = middle_m - [30.0, 0.0, 0.0]
    world.tile(0, 0)[0]["foot_m"][0] = [2.0, 18.0, 0.0]
    scene = FarCaster(world, workers).open(world.window(at_m[None], tiles=tiles))
    azimuth = np.linspace(-0.012, 0.012, 4000)
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    hits = cast(scene, np.broadcast_to(at_m, (4000, 3)), direction)
    met = hits.range_m < 31.0
    assert met.sum() > 800
    points_m = hits.range_m[met, None].astype(float) * direction[met]
    # A leaning stem is cut level in an ellipse: seen along its axis it is a circle.
    axis = stem["axis"]
    one = np.cross(axis, [0.0, 1.0, 0.0])
    one /= np.linalg.norm(one)
    flat_m = points_m @ np.column_stack([one, np.cross(axis, one)])
    matrix = np.column_stack([2 * flat_m, np.ones(len(flat_m))])
    a, b, c = np.linalg.lstsq(matrix, (flat_m**2).sum(axis=1), rcond=None)[0]
    assert 2 * math.sqrt(c + a * a + b * b) == pytest.approx(2 * float(stem["radius_m"][knot]), abs=0.001)


def test_without_a_limit_all_is_cast_as_faces(workers):
    """`near_m` of infinity asks for no tile and has no medium, and meets what a window without tiles
    meets, bit by bit."""
    world = lab.Tiles(math.inf)
    window = world.window(AT_M)
    world.far_tile = None
    scene = FarCaster(world, workers).open(window)
    untiled = Window(**{field.name: getattr(window, field.name) for field in fields(Window)})
    plain = FarCaster(world, workers).open(untiled)
    assert type(scene) is EmbreeGeometry
    ours, other = (cast(s, *around(8000, AT_M[0])) for s in (scene, plain))
    assert np.isfinite(ours.range_m).mean() > 0.4
    lab.assert_same_bits(ours, other)


def test_near_by_all_is_as_with_faces_alone(workers):
    """What is met before the medium begins is met as in a window of faces, bit by bit, by one ray and by
    eight."""
    far, near = (lab.Tiles(near_m) for near_m in (15.0, math.inf))
    scenes = [FarCaster(world, workers).open(world.window(AT_M)) for world in (far, near)]
    for beam in ({}, {"model": "fixed", "rays": 8}):
        ours, true = (cast(scene, *around(8000, AT_M[0]), **beam) for scene in scenes)
        close = true.range_m < 15.0
        assert close.mean() > 0.2
        assert (close == (ours.range_m < 15.0)).all()
        for name in ("range_m", "surface", "cos_incidence"):
            assert (getattr(ours, name)[close] == getattr(true, name)[close]).all()


@pytest.mark.parametrize("model", ["none", "fixed", "adaptive"])
def test_batches_threads_and_revolutions_do_not_matter_in_a_medium(workers, model):
    """A second revolution, pieces of eight, and a scene of another caster give the same hits, bit by bit."""
    world = lab.Tiles()
    origin_m, direction = around(1600, AT_M[0])
    beam = {} if model == "none" else {"model": model, "rays": 8}
    scenes = [FarCaster(w, workers).open(w.window(AT_M)) for w in (world, world, lab.Tiles())]
    whole = cast(scenes[0], origin_m, direction, **beam)
    for scene in scenes:
        again = cast(scene, origin_m, direction, **beam)
        lab.assert_same_bits(again, whole)
    light = [lab.beam(**beam)] if beam else []
    pieces = [
        scenes[0].cast(lab.rays(origin_m[n : n + 8], direction[n : n + 8], n), np.zeros(1), 60.0, *light)
        for n in range(0, 1600, 8)
    ]
    lab.assert_same_bits(lab.joined(pieces), whole)
    leaf = part_of(world.window(AT_M), whole.surface) == PlantPart.LEAF
    assert leaf.mean() > 0.02


def test_cold_and_warm_caches_give_the_same(workers):
    """A window opened after others, whose blocks and clouds are kept, is that of a fresh caster, bit by
    bit."""
    world = lab.Tiles(2.0, across=3)
    elsewhere = world.window(
        AT_M + [[-20.0, 0.0, 0.0]], [(ix, iy) for ix in (-3, -2, -1, 0) for iy in (-1, 0, 1)]
    )
    window, warm = (
        world.window(AT_M, [(ix, iy) for ix in (-1, 0, 1) for iy in (-1, 0, 1)]),
        FarCaster(world, workers),
    )
    kept = warm.open(elsewhere)
    scenes = warm.open(window), FarCaster(world, workers).open(window)
    ours, fresh = (cast(scene, *around(4000, AT_M[0])) for scene in scenes)
    lab.assert_same_bits(ours, fresh)
    assert kept.medium.brick[..., 0].any()


def with_wall(window, x_m):
    """Put a wall of a user's across x into a window."""
    corners_m = [[x_m, -90.0, -30.0], [x_m, 90.0, -30.0], [x_m, 90.0, 60.0], [x_m, -90.0, 60.0]]
    mesh = Mesh(np.array(corners_m, "f4"), np.array([[0, 1, 2, 3]], "u4"))
    row = np.zeros(1, SURFACE)
    row["reflectance"], row["semantic"], row["instance"] = 0.5, Semantic.OTHER, 7
    walled = replace(
        window,
        shapes=(*window.shapes, "wall"),
        shape=np.append(window.shape, len(window.shapes)).astype("i4"),
        world_T_shape=np.concatenate([window.world_T_shape, np.eye(3, 4)[None]]),
        first_surface=np.append(window.first_surface, len(window.surfaces)).astype("u4"),
        surfaces=np.concatenate([window.surfaces, row]),
        far=np.append(window.far, False),
        low=np.append(window.low, False),
    )
    return walled, mesh


@pytest.mark.parametrize("beam", [{}, {"model": "fixed", "rays": 8}])
def test_a_users_wall_in_the_wood_is_hit_exactly(workers, beam):
    """At 40 m a wall is met at its range to 0.02 mm, hides what is behind it, and changes nothing before
    it or beside it."""
    world = lab.Tiles(10.0, across=2)
    bare, at_m = world.window(AT_M), AT_M[0] + [0.0, 0.0, 4.0]
    window, wall = with_wall(bare, 50.0)
    grown = world.shape
    world.shape = lambda key: (wall,) if key == "wall" else grown(key)
    caster, number = FarCaster(world, workers), len(bare.surfaces)
    rays = around(16_000, at_m, low_deg=-8.0, high_deg=8.0)
    ours, without = (cast(caster.open(w), *rays, far_m=70.0, **beam) for w in (window, bare))
    met = ours.surface == number
    each = len(met) // 16_000
    assert met.sum() > 100
    if each == 1:
        true_m = 40.0 / rays[1][met, 0]
        assert np.abs(ours.range_m[met] - true_m).max() < 2e-5 * 2
    assert (without.range_m[met] > ours.range_m[met]).all()
    for name in ("range_m", "surface", "cos_incidence"):
        assert (getattr(ours, name)[~met] == getattr(without, name)[~met]).all()
    behind = np.isfinite(ours.range_m) & ~met
    along_m = np.repeat(rays[1][:, 0], each)[behind] * ours.range_m[behind]
    assert along_m.max() < 40.2


def test_what_is_low_is_met_near_by_only(workers):
    """A thing that is said to be low is met at its range where light has not come to the medium, and
    passed by beyond."""
    world = lab.Tiles(10.0)
    bare, at_m = world.window(AT_M), AT_M[0] + [0.0, 0.0, 4.0]
    rays, grown = around(8000, at_m, low_deg=-8.0, high_deg=8.0), world.shape
    for x_m, is_met in ((15.0, True), (25.0, False)):
        window, wall = with_wall(bare, x_m)
        world.shape = lambda key, wall=wall: (wall,) if key == "wall" else grown(key)
        low = replace(window, low=np.append(np.zeros_like(bare.far), True))
        hits = [cast(FarCaster(world, workers).open(each), *rays) for each in (window, low, bare)]
        exact, ours, without = ((each.range_m, each.surface) for each in hits)
        is_wall = (exact[1] == len(bare.surfaces)) & (exact[0] < 10.0)
        assert (is_wall.sum() > 100) == is_met
        assert (ours[0][is_wall] == exact[0][is_wall]).all()
        assert (ours[0][~is_wall] == without[0][~is_wall]).all()


def test_things_that_sway_are_faces_at_any_range(workers):
    """Trees that sway, farther than `near_m`, are met where they are at the time of each pulse, as with
    faces alone."""
    far, near = (lab.Tiles(near_m) for near_m in (8.0, math.inf))
    window = far.window(AT_M)
    crowns = np.flatnonzero([window.shapes[s] == "crown" for s in window.shape])
    still = window.far.copy()
    still[crowns] = False
    shear = np.stack([np.zeros((len(crowns), 2)), np.full((len(crowns), 2), 0.2)])
    foot_z_m = window.world_T_shape[crowns, 2, 3] - 5.0
    swaying = replace(window, far=still, sway=lab.straight(0, 1_000_000_000, crowns, foot_z_m, shear))

    scenes = (
        FarCaster(lab.Tiles(8.0, crowns_far=False), workers).open(swaying),
        FarCaster(near, workers).open(swaying),
    )
    origin_m, direction = around(16_000, AT_M[0], low_deg=0.0, high_deg=40.0)
    firings = lab.rays(origin_m, direction)
    for t_ns in (0, 500_000_000, 1_000_000_000):
        at_once = replace(firings, t_ns=np.full_like(firings.t_ns, t_ns))
        ours, true = (scene.cast(at_once, np.zeros(1), 60.0) for scene in scenes)
        crown = np.isin(part_of(window, true.surface), [PlantPart.LEAF, PlantPart.BRANCH_FIRST_ORDER])
        crown &= true.range_m > 8.0
        assert crown.sum() > 300
        same = ours.surface == true.surface
        assert same[crown].mean() > 0.99
        assert np.abs(ours.range_m[crown & same] - true.range_m[crown & same]).max() < 1e-5
        assert np.abs(ours.cos_incidence - true.cos_incidence)[crown & same].max() < 1e-4


def test_a_window_of_ground_alone_has_a_medium(workers):
    """Where nothing grows or lies, and where there are stems only, the ground is far all the same."""
    for per_tile in (0, 3):
        world = lab.Tiles(5.0, things=False, per_tile=per_tile)
        scene = FarCaster(world, workers).open(world.window(AT_M))
        hits = cast(scene, *around(800, AT_M[0], low_deg=-40.0, high_deg=-10.0))
        assert (hits.range_m > 5.0).any()
        assert np.isfinite(hits.range_m).mean() > 0.9


def test_blocks_are_made_once(workers, monkeypatch):
    """A second window makes blocks only of tiles that are new."""
    made, real = [], room.block_of
    monkeypatch.setattr(room, "block_of", lambda *given: (made.append(given[3:]), real(*given))[1])
    world = lab.Tiles(2.0, across=3)
    far, square = FarCaster(world, workers), [*itertools.product(range(-2, 3), repeat=2)]
    row = [(3, iy) for iy in range(-2, 3)]
    for tiles, fresh in ((square, square), (square, []), ([*square, *row], row)):
        window = world.window(AT_M, tiles)
        far.medium(window, far.tiles(window))
        assert sorted(made) == fresh
        made.clear()
