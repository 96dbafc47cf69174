"""The very thin, and the very many."""

import resource
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path as FilePath

import numpy as np
from scipy.stats import norm

from stability_cases.case import Row, case, refusal
from stability_cases.lab import PULSES, beam, cast, faces, open_scene, pulses, wall
from vlp16emu.extras.meshes.files import UserMesh
from vlp16emu.extras.meshes.furnish import Furnished
from vlp16emu.extras.meshes.settings import MeshFile, MeshPlace
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import F8, Firings, Mesh
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall

_TWIG_M = 1e-3
_AWAY_M = 100.0
_SIGMA_M = (0.0127 + 0.003 * _AWAY_M) / 4  # of the light there, to the side
_PANE_QUADS = 8
_TIMED_FROM = 100_000  # instances: casts among fewer take too short a time for a bound that tests hold


@case("closed form: integral of the beam's Gaussian profile")
def thin_twig() -> Iterator[Row]:
    """A twig of 1 mm in a beam of 31 cm, 100 m away: a three-hundredth of the beam's width."""
    half_m = _TWIG_M / 2
    corners = (-half_m, -5), (half_m, -5), (half_m, 5), (-half_m, 5)
    twig = faces(np.array([[(_AWAY_M, y, z) for y, z in corners]]))
    scene = open_scene([twig, wall(110.0)])

    def beside(y_m: F8) -> Firings:
        return pulses(np.column_stack([0 * y_m, y_m, 0 * y_m]), np.tile([1.0, 0.0, 0.0], (len(y_m), 1)))

    y_m = np.repeat(np.linspace(-1.5, 1.5, 16) * _SIGMA_M, 2 * PULSES)
    expected = norm.cdf((half_m - y_m) / _SIGMA_M) - norm.cdf((-half_m - y_m) / _SIGMA_M)
    for model, name in (("fixed", "64 rays: share of light"), ("angle", "one drawn ray: chance of a hit")):
        hits = cast(scene, beside(y_m), beam(model))
        seen = (hits.surface == 0).reshape(len(y_m), -1).mean(axis=1)
        off = abs(float((seen - expected).mean())) * np.sqrt(len(seen)) / float(seen.std())
        yield Row(f"{name}, standard errors", off, 4)
        yield Row(f"{name.split(':')[0]}: rays lost", int((~np.isfinite(hits.range_m)).sum()), 0)
    y_m = np.linspace(-1.0, 1.0, PULSES) * _TWIG_M
    sure = np.abs(np.abs(y_m) - half_m) > 1e-5
    met = cast(scene, beside(y_m)).surface == 0
    yield Row("one ray: pulses wrong by over 0.01 mm", int((met != (np.abs(y_m) < half_m))[sure].sum()), 0)


def _pane() -> Mesh:
    edges = np.linspace(-1.0, 1.0, _PANE_QUADS + 1)
    low = edges[:-1]
    high = edges[1:]
    x = np.full(_PANE_QUADS, 10.0)
    corners = [(x, low, x - 11), (x, high, x - 11), (x, high, x - 9), (x, low, x - 9)]
    return faces(np.stack([np.column_stack(corner) for corner in corners], axis=1))


def _resident_kb() -> float:
    """Memory that this process holds (Linux, proc(5))."""
    pages = int(FilePath("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1024


def _cast_s(scene: Geometry, firings: Firings) -> tuple[F8, float]:
    """Ranges of pulses, and the lesser of two CPU times that casting them takes."""
    times_s = []
    for _ in range(2):
        began_s = time.thread_time()
        hits = cast(scene, firings)
        times_s.append(time.thread_time() - began_s)
    return hits.range_m.astype(np.float64), min(times_s)


def _crowd(count: int) -> Iterator[Row]:
    direction = np.column_stack([np.ones(8), np.linspace(-0.05, 0.05, 8), np.zeros(8)])
    length = np.linalg.norm(direction, axis=1)
    firings = pulses(np.zeros((8, 3)), direction / length[:, None], lasers=1)
    pane = _pane()
    _, tenth_s = _cast_s(open_scene([pane], times=count // 10), firings)
    before_kb = _resident_kb()
    scene = open_scene([pane], times=count)
    grown_kb = _resident_kb() - before_kb
    range_m, whole_s = _cast_s(scene, firings)
    yield Row(f"{count}: range, m", float(np.abs(range_m - 10.0 * length).max()), 1e-5)
    yield Row(f"{count}: memory, kB per instance", grown_kb / count, 3)
    if count > _TIMED_FROM:
        yield Row(f"{count}: time of a cast over that among a tenth, over ten", whole_s / (10 * tenth_s), 3)


@case("closed form in float64; proc(5)")
def crowd() -> Iterator[Row]:
    """Ten thousand instances of a pane in one place: every ray meets all of them."""
    yield from _crowd(10_000)


@case("closed form in float64; proc(5)", is_slow=True)
def vast_crowd() -> Iterator[Row]:
    """A million instances in one place."""
    yield from _crowd(1_000_000)


@case("refusal")
def too_many_meshes() -> Iterator[Row]:
    """More things of the user's own than their numbers, of 16 bits, can hold."""
    stone = UserMesh(FilePath("stone.obj"), np.zeros(3), (("stone", _pane()),), 1.0)
    places = [MeshPlace(x_m=50.0, y_m=0.0, z_m=0.0)] * 65_537
    section = MeshFile(file="stone.obj", unit="m", up="z", semantic="stone", places=places)
    hall = HallWorld(Hall(kind="hall", length_m=9.0, width_m=9.0, height_m=9.0))
    furnish = partial(Furnished, hall, meshes=[(section, stone)], reach_m=100.0)
    yield refusal("a scene of 65 537", furnish, "at most 65536")
