"""The very many."""

import resource
from pathlib import Path as FilePath

import numpy as np
import pytest
from stability.lab import cast, faces, opened, pulses

from vlp16emu.errors import InputError
from vlp16emu.extras.meshes.files import UserMesh
from vlp16emu.extras.meshes.furnished import Furnished
from vlp16emu.extras.meshes.settings import MeshFile, MeshPlace
from vlp16emu.types import Mesh
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall

_PANE_QUADS = 8


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
        Furnished(hall, meshes=[(section, stone)], reach_m=100.0)
