"""A small window with every difficulty: triangles and quads, scaled and turned shapes, far from the origin."""

import math
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from vlp16emu.motion import Standing
from vlp16emu.raycast import BeamModel, Footprint
from vlp16emu.sensor import BEAM_TABLES, Clock, Head, Rotor
from vlp16emu.types import SURFACE, Firings, Mesh, SensorModel, Window

UTM_M = np.array([432_100.0, 6_901_234.0, 87.0])
NEAR_M = BEAM_TABLES[SensorModel.VLP_16].near_m
FAR_M = 100.0


def soup(key):
    """Two meshes of random small faces: triangles, and planar quads above them."""
    rng = np.random.default_rng(key)
    corners_m = rng.uniform(-1, 1, (200, 1, 3)) + rng.normal(0, 0.2, (200, 4, 3))
    corners_m[:, 3] = corners_m[:, 0] + corners_m[:, 2] - corners_m[:, 1]
    triangles = Mesh(corners_m[:, :3].reshape(-1, 3).astype("f4"), np.arange(600, dtype="u4").reshape(-1, 3))
    quads = Mesh(
        (corners_m + [0, 0, 1]).reshape(-1, 3).astype("f4"), np.arange(800, dtype="u4").reshape(-1, 4)
    )
    return triangles, quads


def placed(count, *, at=UTM_M, scaled=True, seed=1):
    """Window of `count` turned, mirrored and scaled soups about a point."""
    rng = np.random.default_rng(seed)
    transforms = np.zeros((count, 3, 4))
    for transform in transforms:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        transform[:, :3] = turn @ np.diag(rng.uniform(0.5, 2.0, 3)) if scaled else turn
        transform[:, 3] = at + rng.uniform(-8, 8, 3)
    surfaces = np.zeros(2 * count, SURFACE)
    surfaces["reflectance"] = rng.uniform(0.1, 0.9, 2 * count)
    return Window(
        origin_m=np.asarray(at, float),
        shapes=(1, 2, 3),
        shape=(np.arange(count) % 3).astype("i4"),
        world_T_shape=transforms,
        first_surface=(np.arange(count) * 2).astype("u4"),
        surfaces=surfaces,
    )


def pulses(count, *, first=0, at=UTM_M, tilt_deg=2.0):
    """Firings of a static sensor in the middle of it."""
    rotor = Rotor(600, 0.0, 0.0, 0.0, 0.0, 1)
    head = Head(BEAM_TABLES[SensorModel.VLP_16], rotor, Clock(True, 0, 0.0), 10**18)
    standing = Standing(np.asarray(at, float) + [0, 0, 0.1], 30.0, tilt_deg, 1.0)
    return head.aim(first, count, standing.poses_at, across=True)


def beam(model, **changed):
    """The footprint of a VLP-16."""
    width = {"spot_m": (0.0127, 0.0095), "divergence_rad": (0.003, 0.0015)}
    usual = {"rays": 32, "target_m": 0.05, "resolution_m": 1.0, "seed": 7} | width
    return Footprint(BeamModel(model), **(usual | changed))


def level_pulses(y_m, lasers=1):
    """Firings (k, lasers) along x from points beside each other, k positions y."""
    k = len(y_m)
    origin_m, direction, across = np.zeros((k, lasers, 3)), np.zeros((k, lasers, 3)), np.zeros((k, lasers, 3))
    origin_m[..., 1], direction[..., 0], across[..., 1] = np.asarray(y_m)[:, None], 1.0, -1.0
    zero = np.zeros((k, lasers))
    return Firings(
        0, zero.astype("i8"), zero[:, 0].astype("i8"), zero, zero[:, 0], origin_m, direction, across
    )


def upright(*rectangles, reflectance=0.5):
    """Window of upright rectangles (x, y from, y to, z from, z to), each a surface, and its shapes."""
    meshes = tuple(
        Mesh(
            np.array([[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]], "f4"),
            np.array([[0, 1, 2, 3]], "u4"),
        )
        for x, y0, y1, z0, z1 in rectangles
    )
    surfaces = np.zeros(len(meshes), SURFACE)
    surfaces["reflectance"] = reflectance
    place = np.eye(3, 4)[None].copy()
    window = Window(np.zeros(3), ("all",), np.zeros(1, "i4"), place, np.zeros(1, "u4"), surfaces)
    return window, lambda _key: meshes


def world(shape, near_m=math.inf, far_tile=None, seed=0):
    """What a caster needs of a world: shapes, and, where it has a medium, tiles."""
    return SimpleNamespace(shape=shape, near_m=near_m, far_tile=far_tile, seed=seed)


@pytest.fixture(scope="session")
def lab():
    """What tests of casters share."""
    return SimpleNamespace(
        soup=soup,
        placed=placed,
        pulses=pulses,
        beam=beam,
        level_pulses=level_pulses,
        upright=upright,
        world=world,
        near_m=NEAR_M,
        far_m=FAR_M,
        utm_m=UTM_M,
    )


@pytest.fixture(scope="session")
def workers():
    with ThreadPoolExecutor(2) as pool:
        yield pool
