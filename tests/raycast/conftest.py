"""A small window with every difficulty: triangles and quads, scaled and turned shapes, far from the origin."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from vlp16emu.motion import Standing
from vlp16emu.sensor import BEAM_TABLES, Clock, Head, Rotor
from vlp16emu.types import SURFACE, Mesh, SensorModel, Window

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
    return Window(
        origin_m=np.asarray(at, float),
        shapes=(1, 2, 3),
        shape=rng.integers(0, 3, count).astype("i4"),
        world_T_shape=transforms,
        first_surface=(np.arange(count) * 2).astype("u4"),
        surfaces=np.zeros(2 * count, SURFACE),
    )


def pulses(count, *, first=0, at=UTM_M, tilt_deg=2.0):
    """Firings of a static sensor in the middle of it."""
    rotor = Rotor(600, 0.0, 0.0, 0.0, 0.0, 1)
    head = Head(BEAM_TABLES[SensorModel.VLP_16], rotor, Clock(True, 0, 0.0), 10**18)
    return head.aim(first, count, Standing(np.asarray(at, float) + [0, 0, 0.1], 30.0, tilt_deg, 1.0).poses_at)


@pytest.fixture(scope="session")
def lab():
    """What tests of casters share."""
    return SimpleNamespace(soup=soup, placed=placed, pulses=pulses, near_m=NEAR_M, far_m=FAR_M, utm_m=UTM_M)


@pytest.fixture(scope="session")
def workers():
    with ThreadPoolExecutor(2) as pool:
        yield pool
