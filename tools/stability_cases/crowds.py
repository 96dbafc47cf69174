"""The very thin, and the very many."""

import resource
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from stability_cases.lab import PULSES, beam, cast, faces, opened, pulses, wall
from stability_cases.row import Row, refused
from vlp16emu.extras.meshes.files import PartMesh, UserMesh
from vlp16emu.extras.meshes.furnished import Furnished, Furniture
from vlp16emu.extras.meshes.settings import MeshFile, MeshPlace
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import Firings, Mesh
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall

Array = NDArray[np.float64]

_TWIG_M, _AWAY_M = 1e-3, 100.0
_SIGMA_M = (0.0127 + 0.003 * _AWAY_M) / 4
"""Of the light there, to the side."""
_PANE_QUADS = 8


def _before_a_twig(y_m: Array) -> Firings:
    n = len(y_m)
    return pulses(np.column_stack([0 * y_m, y_m, 0 * y_m]), np.tile([1.0, 0.0, 0.0], (n, 1)))


def thin_twig() -> Iterator[Row]:
    """Look at an upright twig of a millimetre, 100 m away, before a wall."""
    half_m = _TWIG_M / 2
    twig = faces(np.array([[(_AWAY_M, y, z) for y, z in ((-half_m, -5), (half_m, -5), (half_m, 5), (-half_m, 5))]]))
    scene = opened([twig, wall(110.0)])
    beside_m = np.repeat(np.linspace(-1.5, 1.5, 16) * _SIGMA_M, 2 * PULSES)
    expected = norm.cdf((half_m - beside_m) / _SIGMA_M) - norm.cdf((-half_m - beside_m) / _SIGMA_M)
    for model, name in (("fixed", "share of light"), ("angle", "chance of a hit")):
        hits = cast(scene, _before_a_twig(beside_m), beam(model))
        seen = (hits.surface == 0).reshape(len(beside_m), -1).mean(axis=1)
        errors = abs(float((seen - expected).mean())) * np.sqrt(len(seen)) / float(seen.std())
        yield Row("twig of 1 mm at 100 m", f"{name}, standard errors", errors, 4)
        yield Row("twig of 1 mm at 100 m", "rays lost", int((~np.isfinite(hits.range_m)).sum()), 0)
    beside_m = np.linspace(-1.0, 1.0, PULSES) * _TWIG_M
    sure = np.abs(np.abs(beside_m) - half_m) > 1e-5
    met = cast(scene, _before_a_twig(beside_m)).surface == 0
    wrong = int((met != (np.abs(beside_m) < half_m))[sure].sum())
    yield Row("twig of 1 mm at 100 m, one ray", "pulses wrong by over 0.01 mm", wrong, 0)


def _pane() -> Mesh:
    edges = np.linspace(-1.0, 1.0, _PANE_QUADS + 1)
    low, high, x = edges[:-1], edges[1:], np.full(_PANE_QUADS, 10.0)
    corners = [(x, low, x - 11), (x, high, x - 11), (x, high, x - 9), (x, low, x - 9)]
    return faces(np.stack([np.column_stack(corner) for corner in corners], axis=1))


def _resident_kb() -> float:
    """Memory that this process holds (Linux, proc(5))."""
    pages = int(FilePath("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1024


def _cast_s(scene: Geometry, firings: Firings) -> tuple[Array, float]:
    """Ranges of pulses, and the lesser of two times that casting them takes."""
    times_s = []
    for _ in range(2):
        began_s = time.thread_time()
        hits = cast(scene, firings)
        times_s.append(time.thread_time() - began_s)
    return hits.range_m.astype(np.float64), min(times_s)


def crowd() -> Iterator[Row]:
    """Place ten thousand instances of a pane in one place, and cast a packet of pulses through them all."""
    count, pane = 10_000, _pane()
    direction = np.column_stack([np.ones(8), np.linspace(-0.05, 0.05, 8), np.zeros(8)])
    length = np.linalg.norm(direction, axis=1)
    firings = pulses(np.zeros((8, 3)), direction / length[:, None], lasers=1)
    _, tenth_s = _cast_s(opened([pane], times=count // 10), firings)
    before_kb = _resident_kb()
    scene = opened([pane], times=count)
    grown_kb = _resident_kb() - before_kb
    range_m, whole_s = _cast_s(scene, firings)
    name = "10 000 instances in one place"
    yield Row(name, "largest error, m", float(np.abs(range_m - 10.0 * length).max()), 1e-5)
    yield Row(name, "cost of one over that among a tenth as many", whole_s / (10 * tenth_s), 3)
    yield Row(name, "memory, kB per instance", grown_kb / count, 3)


def too_many() -> Iterator[Row]:
    """Bring more things of the user's own than have numbers."""
    stone = UserMesh(FilePath("stone.obj"), np.zeros(3), (PartMesh("stone", _pane()),), 1.0)
    places = [MeshPlace(x_m=50.0, y_m=0.0, z_m=0.0)] * 65_537
    section = MeshFile(file="stone.obj", unit="m", up="z", semantic="stone", places=places)
    hall = HallWorld(Hall(kind="hall", length_m=9.0, width_m=9.0, height_m=9.0))
    furniture = [Furniture(section, stone)]
    put = partial(Furnished, hall, furniture=furniture, reach_m=100.0)
    yield refused("65 537 meshes in a scene", put, "at most 65536")
