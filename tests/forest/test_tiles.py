"""Tiles and their ground."""

import numpy as np
import trimesh

from vlp16emu.forest.ground.triangles import ground_triangles
from vlp16emu.forest.tiles import TILE_M, TileKey, ground_mesh, tile_origin_m, tiles_within
from vlp16emu.world.polyline import distance_m

LINE = np.array([[3.0, 5.0], [90.0, 40.0]])


def test_no_tile_in_reach_is_left_out():
    """Every point within reach of the line lies on one of the tiles, and no tile is farther than its diagonal beyond."""
    tiles = tiles_within(LINE, 50.0)
    points = np.random.default_rng(1).uniform(-80, 180, (20_000, 2))
    near = points[distance_m(points, LINE) < 50.0]
    have = {tuple(t) for t in tiles.tolist()}
    assert {tuple(t) for t in np.floor(near / TILE_M).astype(int).tolist()} <= have
    assert distance_m((tiles + 0.5) * TILE_M, LINE).max() < 50 + TILE_M
    assert tiles.tolist() == sorted(tiles.tolist())


def test_ground_vertices_are_terrain_heights(terrain):
    """Each grid vertex lies on the terrain within float32, also far from the origin, and every face looks up or out."""
    key = TileKey(40_000, -3)
    mesh = ground_mesh(key, terrain.height_m)
    origin = tile_origin_m(key.ix, key.iy, terrain.height_m)
    points, faces = ground_triangles((key.ix * TILE_M, key.iy * TILE_M), TILE_M, terrain.height_m)
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
    origin = aim + np.column_stack([rng.choice([-8.0, 8.0], 4000), rng.uniform(-2, 2, 4000), rng.uniform(2, 4, 4000)])
    places, rays, _ = ground.ray.intersects_location(origin, aim - origin, multiple_hits=False)
    assert len(np.unique(rays)) == 4000
    assert np.abs(places[:, 2] - terrain.height_m(places[:, 0], places[:, 1])).max() < 0.01
