"""Cushions of moss in the far medium hide as much ground, and face light, as their faces do."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from vlp16emu.foliage.tiles import SIDE_ROW_BIT
from vlp16emu.forest.stand.cushions import side_of, sides_on
from vlp16emu.forest.stand.floor_shapes import FLOOR_VARIANTS, FloorKey, FloorKind, floor_meshes

SEED = 5
SINE = 0.1


@pytest.fixture(scope="module")
def moss():
    """A tile with 300 cushions and a heap of litter on level ground, from (20, 40, 0)."""
    rng = np.random.default_rng(3)
    n = 301
    keys = [FloorKey(FloorKind.MOSS_CUSHION, variant) for variant in range(FLOOR_VARIANTS)]
    height_m = rng.uniform(0.03, 0.08, n)
    world_T_shape = np.zeros((n, 3, 4))
    turn = rng.uniform(0, 2 * np.pi, n)
    world_T_shape[:, 0, 0] = world_T_shape[:, 1, 1] = 8 * height_m * np.cos(turn)
    world_T_shape[:, 1, 0] = 8 * height_m * np.sin(turn)
    world_T_shape[:, 0, 1] = -world_T_shape[:, 1, 0]
    world_T_shape[:, 2, 2] = height_m
    world_T_shape[:, :2, 3] = [20.0, 40.0] + rng.uniform(0.5, 19.5, (n, 2))
    shape = rng.integers(FLOOR_VARIANTS, size=n)
    shape[-1] = FLOOR_VARIANTS
    return SimpleNamespace(
        keys=(*keys, FloorKey(FloorKind.LITTER_HEAP, 0)),
        shape=shape,
        world_T_shape=world_T_shape,
        first_surface=100 + np.arange(n),
    )


def met_by_rays(moss):
    """Mask of rays at the ground (n,) that meet a cushion before it, and their cosines of incidence."""
    rng, n = np.random.default_rng(4), 40_000
    meshes = [floor_meshes(SEED, key)[0] for key in moss.keys]
    things = trimesh.util.concatenate(
        [
            trimesh.Trimesh(meshes[i].vertices_m @ place[:, :3].T + place[:, 3], meshes[i].faces)
            for i, place in zip(moss.shape[:-1], moss.world_T_shape[:-1], strict=True)
        ]
    )
    towards, level = rng.uniform(0, 2 * np.pi, n), np.sqrt(1 - SINE * SINE)
    direction = np.column_stack([level * np.cos(towards), level * np.sin(towards), np.full(n, -SINE)])
    ground_m = np.column_stack([rng.uniform([22.0, 42.0], [38.0, 58.0], (n, 2)), np.zeros(n)])
    place_m, ray, face = things.ray.intersects_location(
        ground_m - 1.5 * direction, direction, multiple_hits=False
    )
    over = place_m[:, 2] > 0
    met = np.zeros(n, bool)
    met[ray[over]] = True
    return met, -(things.face_normals[face[over]] * direction[ray[over]]).sum(axis=1)


def test_cushions_hide_as_much_ground_and_face_light_as_their_faces_do(moss):
    """Rays as from a sensor 2 m over the ground at 20 m meet cushions in place of the ground as often as the
    law of their sides says, to 10 %, and at cosines of incidence whose mean is within 0.03."""
    sides = sides_on(np.array([20.0, 40.0, 0.0]), moss, SEED)
    share = ((sides & 255) / 255).astype(float)[8:72, 8:72]  # squares from 22 to 38 m, and from 42 to 58 m
    met, cosine = met_by_rays(moss)
    assert met.mean() > 0.1
    assert (1 - np.exp(-share / SINE)).mean() == pytest.approx(met.mean(), rel=0.1)
    assert side_of(SEED)[1].mean() == pytest.approx(cosine.mean(), abs=0.03)


def test_squares_have_the_rows_of_their_cushions(moss):
    """Each square with a side has the row of a cushion that is less than three widths across away; litter has
    no side."""
    sides = sides_on(np.array([20.0, 40.0, 0.0]), moss, SEED)
    x, y = np.nonzero(sides)
    cushion = (sides[x, y] >> SIDE_ROW_BIT).astype(int) - 100
    assert len(x) > 1500
    assert (cushion >= 0).all()
    assert (cushion < 300).all()  # the heap is the last
    away_m = np.column_stack([20 + 0.25 * x, 40 + 0.25 * y]) + 0.125 - moss.world_T_shape[cushion, :2, 3]
    width_m = 8 * moss.world_T_shape[cushion, 2, 2]
    assert (np.abs(away_m).max(axis=1) < 0.125 + 1.42 * width_m).all()
