"""The very thin, and the very many."""

import resource
from pathlib import Path as FilePath

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm
from stability.lab import PULSES, beam, cast, faces, opened, pulses, wall

from vlp16emu.errors import InputError
from vlp16emu.extras.meshes.files import UserMesh
from vlp16emu.extras.meshes.furnished import Furnished, Furniture
from vlp16emu.extras.meshes.settings import MeshFile, MeshPlace
from vlp16emu.types import Firings, Mesh
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall

F8 = NDArray[np.float64]

_TWIG_M, _AWAY_M = 1e-3, 100.0
_SIGMA_M = (0.0127 + 0.003 * _AWAY_M) / 4
"""Of the light there, to the side."""
_PANE_QUADS = 8


def _before_a_twig(y_m: F8) -> Firings:
    n = len(y_m)
    return pulses(np.column_stack([0 * y_m, y_m, 0 * y_m]), np.tile([1.0, 0.0, 0.0], (n, 1)))


def test_thin_twig():
    """An upright twig of 1 mm, 100 m away, is hit by the share of the light that the profile of the beam puts there."""
    half_m = _TWIG_M / 2
    twig = faces(np.array([[(_AWAY_M, y, z) for y, z in ((-half_m, -5), (half_m, -5), (half_m, 5), (-half_m, 5))]]))
    scene = opened([twig, wall(110.0)])
    beside_m = np.repeat(np.linspace(-1.5, 1.5, 16) * _SIGMA_M, 2 * PULSES)
    expected = norm.cdf((half_m - beside_m) / _SIGMA_M) - norm.cdf((-half_m - beside_m) / _SIGMA_M)
    for model in ("fixed", "angle"):  # shares of light, and chances of a hit
        hits = cast(scene, _before_a_twig(beside_m), beam(model))
        seen = (hits.surface == 0).reshape(len(beside_m), -1).mean(axis=1)
        assert abs((seen - expected).mean()) <= 4 * seen.std() / np.sqrt(len(seen))  # standard errors
        assert not (~np.isfinite(hits.range_m)).any()  # rays lost
    beside_m = np.linspace(-1.0, 1.0, PULSES) * _TWIG_M
    sure = np.abs(np.abs(beside_m) - half_m) > 1e-5
    met = cast(scene, _before_a_twig(beside_m)).surface == 0
    assert (met == (np.abs(beside_m) < half_m))[sure].all()  # but for 0.01 mm


def _pane() -> Mesh:
    edges = np.linspace(-1.0, 1.0, _PANE_QUADS + 1)
    low, high, x = edges[:-1], edges[1:], np.full(_PANE_QUADS, 10.0)
    corners = [(x, low, x - 11), (x, high, x - 11), (x, high, x - 9), (x, low, x - 9)]
    return faces(np.stack([np.column_stack(corner) for corner in corners], axis=1))


def _resident_kb() -> float:
    """Memory that this process holds (Linux, proc(5))."""
    pages = int(FilePath("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1024


def test_crowd():
    """Ten thousand instances of a pane in one place are hit where it is, to 10 um, and take at most 3 kB each."""
    count, pane = 10_000, _pane()
    direction = np.column_stack([np.ones(8), np.linspace(-0.05, 0.05, 8), np.zeros(8)])
    length = np.linalg.norm(direction, axis=1)
    before_kb = _resident_kb()
    scene = opened([pane], times=count)
    assert (_resident_kb() - before_kb) / count <= 3
    hits = cast(scene, pulses(np.zeros((8, 3)), direction / length[:, None], lasers=1))
    assert np.abs(hits.range_m - 10.0 * length).max() <= 1e-5


def test_too_many():
    """More things of the user's own than have numbers are refused."""
    stone = UserMesh(FilePath("stone.obj"), np.zeros(3), (("stone", _pane()),), 1.0)
    places = [MeshPlace(x_m=50.0, y_m=0.0, z_m=0.0)] * 65_537
    section = MeshFile(file="stone.obj", unit="m", up="z", semantic="stone", places=places)
    hall = HallWorld(Hall(kind="hall", length_m=9.0, width_m=9.0, height_m=9.0))
    with pytest.raises(InputError, match="at most 65536"):
        Furnished(hall, furniture=[Furniture(section, stone)], reach_m=100.0)
