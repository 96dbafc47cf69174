"""Triangles of the ground, and the plane cut into tiles."""

import numpy as np
import pytest
import trimesh

from vlp16emu.foliage.polyline import distance_m
from vlp16emu.forest.ground.terrain import TerrainHeights
from vlp16emu.forest.settings import Terrain
from vlp16emu.forest.tiles import TILE_M, TileKey, ground_mesh, ground_triangles, tile_origin_m, tiles_within

EDGE_M = 10.0


def ground(**changes):
    """Ground that is flat but for what is said."""
    return TerrainHeights(Terrain(**{"hill_rms_m": 0.0, "rough_rms_m": 0.0, **changes}), seed=3)


ROUGH = ground(hill_rms_m=2.5, rough_rms_m=0.1, mounds_per_ha=60.0, pits_per_ha=60.0)


def off_m(points_m, faces, height_m):
    """Distances of places all over each face from the ground over or under them."""
    share = np.random.default_rng(1).dirichlet([1.0, 1.0, 1.0], (len(faces), 20))
    x, y, z = np.moveaxis(np.einsum("fkc,fcd->fkd", share, points_m[faces]), -1, 0)
    return np.abs(z - height_m(x, y)).ravel()


RUTS = ground(trail_spacing_m=10.0, trail_towards_deg=30.0)


@pytest.mark.parametrize(
    "terrain", [ground(pits_per_ha=600.0), RUTS, ROUGH], ids=["pits", "ruts", "old growth"]
)
def test_triangles_follow_the_ground_to_millimetres(terrain):
    """In pits and ruts and on rough ground, where a grid of 0.5 m is off by 30 mm, one place in a thousand
    is off by 5 mm and none by 7."""
    off = off_m(*ground_triangles((40.0, -20.0), EDGE_M, terrain.height_m), terrain.height_m)
    assert np.quantile(off, 0.999) < 0.005
    assert off.max() < 0.007
    grid = np.arange(21) * 0.5
    y, x = np.meshgrid(grid - 20.0, grid + 40.0, indexing="ij")
    z = terrain.height_m(x, y)
    middle = terrain.height_m(x[:-1, :-1] + 0.25, y[:-1, :-1] + 0.25)
    assert np.abs(middle - (z[:-1, :-1] + z[1:, 1:]) / 2).max() > 0.03


def test_even_ground_has_two_triangles_to_a_square():
    """A plane has no vertex but those of squares of 0.5 m, hills under 1 % more."""
    points_m, faces = ground_triangles((0.0, 0.0), EDGE_M, ground(slope_deg=20.0).height_m)
    assert (len(points_m), len(faces)) == (21**2, 2 * 20**2)
    assert np.array_equal(points_m[:, :2] % 0.5, np.zeros((21**2, 2)))
    assert len(ground_triangles((0.0, 0.0), EDGE_M, ground(hill_rms_m=1.0).height_m)[1]) < 1.01 * 2 * 20**2


def test_triangles_cover_the_ground_once_without_cracks():
    """Over four squares side by side each edge of a triangle is that of one other, but for those around
    all four."""
    pieces, corners = [], [(x, y) for x in (0.0, 10.0) for y in (-10.0, 0.0)]
    for corner_m in corners:
        points_m, faces = ground_triangles(corner_m, EDGE_M, ROUGH.height_m)
        pieces.append(points_m[faces])
    triangles = np.concatenate(pieces)
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert (across[:, 2] > 0).all()
    assert across[:, 2].sum() / 2 == pytest.approx(400.0)
    points_m, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    assert len(np.unique(points_m[:, :2], axis=0)) == len(points_m)
    index = index.reshape(-1, 3)
    edges = np.sort(np.concatenate([index[:, [0, 1]], index[:, [1, 2]], index[:, [2, 0]]]), axis=1)
    edges, times = np.unique(edges, axis=0, return_counts=True)
    assert set(times.tolist()) == {1, 2}
    outer = points_m[edges[times == 1]]
    around = (outer[..., 0] % 20.0 == 0.0) | (np.abs(outer[..., 1]) == 10.0)
    assert around.all()


LINE = np.array([[3.0, 5.0], [90.0, 40.0]])


def test_no_tile_in_reach_is_left_out():
    """Every point within reach of the line lies on one of the tiles, and no tile is farther than its
    diagonal beyond."""
    tiles = tiles_within(LINE, 50.0)
    points = np.random.default_rng(1).uniform(-80, 180, (20_000, 2))
    near = points[distance_m(points, LINE) < 50.0]
    have = {tuple(t) for t in tiles.tolist()}
    assert {tuple(t) for t in np.floor(near / TILE_M).astype(int).tolist()} <= have
    assert distance_m((tiles + 0.5) * TILE_M, LINE).max() < 50 + TILE_M
    assert tiles.tolist() == sorted(tiles.tolist())


def test_ground_vertices_are_terrain_heights(terrain):
    """Each vertex of the grid, by rows from south to north, lies on the terrain, also far from the origin;
    every face looks up or out."""
    key = TileKey(40_000, -3)
    mesh = ground_mesh(key, terrain.height_m)
    origin = tile_origin_m(key.ix, key.iy, terrain.height_m)
    points, faces = ground_triangles((key.ix * TILE_M, key.iy * TILE_M), TILE_M, terrain.height_m)
    assert np.array_equal(points[:, 2], terrain.height_m(points[:, 0].copy(), points[:, 1].copy()))
    assert np.array_equal(np.lexsort((points[:, 0], points[:, 1])), np.arange(len(points)))
    grid = mesh.vertices_m[: len(points)].astype(np.float64) + origin
    assert np.abs(grid[:, 2] - terrain.height_m(grid[:, 0], grid[:, 1])).max() < 2e-6
    solid = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    surface = solid.face_normals[: len(faces)]
    hem = solid.face_normals[len(faces) :]
    outward = solid.triangles_center[len(faces) :, :2] - TILE_M / 2
    assert (surface[:, 2] > 0.7).all()
    assert np.abs(hem[:, 2]).max() < 1e-6
    assert ((hem[:, :2] * outward).sum(axis=1) > 0).all()


def test_no_light_falls_through_the_seams(terrain):
    """Oblique rays at the seam of two tiles always meet one of the two, at most 0.01 m off the terrain."""
    parts = []
    for key in (TileKey(0, 0), TileKey(1, 0)):
        mesh = ground_mesh(key, terrain.height_m)
        vertices = mesh.vertices_m.astype(np.float64) + tile_origin_m(key.ix, key.iy, terrain.height_m)
        parts.append(trimesh.Trimesh(vertices, mesh.faces, process=False))
    ground = trimesh.util.concatenate(parts)
    rng = np.random.default_rng(3)
    y = rng.uniform(5, 15, 4000)
    aim = np.column_stack([rng.normal(20.0, 0.02, 4000), y, terrain.height_m(np.full(4000, 20.0), y)])
    origin = aim + np.column_stack(
        [rng.choice([-8.0, 8.0], 4000), rng.uniform(-2, 2, 4000), rng.uniform(2, 4, 4000)]
    )
    places, rays, _ = ground.ray.intersects_location(origin, aim - origin, multiple_hits=False)
    assert len(np.unique(rays)) == 4000
    assert np.abs(places[:, 2] - terrain.height_m(places[:, 0], places[:, 1])).max() < 0.01
