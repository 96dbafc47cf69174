"""Worlds far from the origin, in files and in the world itself, and places on the globe."""

import csv
import tempfile
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from stability_cases.case import Row, case, refusal
from vlp16emu import Emulator
from vlp16emu.extras.walk.path import Path as WalkedPath
from vlp16emu.motion.gnss import to_geodetic, to_local
from vlp16emu.motion.settings import Gps
from vlp16emu.packets import data_fields
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind

_UTM_M = 500_000, 5_700_000, 210
_FAR_M = 10_000_000, 10_000_000, 210
_ODD_M = (432_117, 6_901_233, 0)  # no corner of a tile: ground and trees are cut and rounded otherwise
_TREES_M = [(6.25, 4.5), (-5.0, 3.25), (-4.5, -6.0), (9.0, -9.5), (-8.25, 9.0)]
_WAY_M = [(-1.0, 0.5), (0.0, 0.0), (1.5, 0.25)]
_HALF_M = 60  # of the ground in the file, which the sensor's reach must not leave
_SPAN_S = 0.0, 0.1

_SCENE = """\
schema = 1
title = "A plot at some place"
seed = 3
sensor = {{ max_range_m = 20.0 }}
noise = {noise}
motion = {motion}

[world]
kind = "plot"
stem_list = "plot.csv"
origin_m = [{origin}]
texture = {texture}
near_m = {near_m}
dem = {{ file = "ground.asc" }}

[[world.meshes]]
file = "box.obj"
unit = "m"
up = "z"
places = [{{ x_m = {x}, y_m = {y}, above_ground_m = 0.5, yaw_deg = 30.0 }}]
"""
_BOX = """\
v -0.5 -0.5 -0.5
v 0.5 -0.5 -0.5
v 0 0.5 -0.5
v 0 0 0.5
f 1 3 2
f 1 2 4
f 2 3 4
f 3 1 4
"""


def _write_plot(folder: Path, files_m: tuple[int, ...], scene_m: tuple[int, ...], *, walk: bool) -> Path:
    """Write a plot whose files lie about one place of the map, and its scene about another of the world."""
    (folder / "box.obj").write_text(_BOX)
    with (folder / "plot.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["x", "y", "species", "dbh_cm", "height_m"])
        rows.writerows(
            [x + files_m[0], y + files_m[1], "norway_spruce", 30 + i, 24] for i, (x, y) in enumerate(_TREES_M)
        )
    cells = _HALF_M + 1
    corner = f"xllcenter {files_m[0] - _HALF_M}\nyllcenter {files_m[1] - _HALF_M}\n"
    heights = " ".join(f"{files_m[2] + x / 16:.4f}" for x in range(-_HALF_M, _HALF_M + 1, 2))
    header = f"ncols {cells}\nnrows {cells}\n{corner}cellsize 2\n"
    (folder / "ground.asc").write_text(header + f"{heights}\n" * cells)
    x, y = scene_m[0], scene_m[1]
    way = ", ".join(f"[{x + dx}, {y + dy}]" for dx, dy in _WAY_M)
    motion = f'{{ kind = "static", x_m = {x}.0, y_m = {y}.0 }}'
    if walk:
        motion = f'{{ kind = "walk", way_points_m = [{way}] }}'
    origin = ", ".join(f"{file - at}.0" for file, at in zip(files_m, scene_m, strict=True))
    scene = folder / "plot.toml"
    # Patches of texture, spots that lose records, and leaves beyond `near_m`, are drawn by their place in the
    # world: a world that stands elsewhere has others. So the moved one has no texture and no losses, and is
    # of faces as far as the sensor reaches.
    texture = 0.1 if walk else 0.0
    near_m = 12.0 if walk else 20.0
    noise = "{}" if walk else "{ records_lost = 0.0 }"
    place = {"x": f"{x + 4}.0", "y": f"{y - 3}.0"}
    drawn = {"texture": texture, "near_m": near_m, "noise": noise}
    scene.write_text(_SCENE.format(motion=motion, origin=origin, **drawn, **place))
    return scene


@cache
def _packets(files_m: tuple[int, ...], scene_m: tuple[int, ...], *, walk: bool) -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        emulator = Emulator(load(str(_write_plot(Path(folder), files_m, scene_m, walk=walk))))
        return [p.payload for p in emulator.packets(*_SPAN_S) if p.kind is PacketKind.DATA]


def _count_differences(near: list[bytes], far: list[bytes]) -> int:
    return sum(a != b for a, b in zip(near, far, strict=True))


def _codes(packets: list[bytes]) -> NDArray[np.int64]:
    """Distances in steps of 2 mm."""
    payloads = np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), -1)
    return data_fields(payloads)["blocks"]["records"]["distance_lsb"].astype(np.int64)


@case("the same plot with files at 0")
def far_files() -> Iterator[Row]:
    """Stem list and terrain in UTM coordinates, and 1e7 m from their zero, where float32 has steps of 1 m."""
    near = _packets((0, 0, 0), (0, 0, 0), walk=True)
    for name, at_m in (("UTM", _UTM_M), ("1e7 m", _FAR_M)):
        differ = _count_differences(near, _packets(at_m, (0, 0, 0), walk=True))
        yield Row(f"{name}: packets that differ", differ, 0)


@case("the same world at 0")
def far_worlds() -> Iterator[Row]:
    """The world itself at UTM coordinates and at 1e7 m, by whole tiles and by an odd offset."""
    near = _packets((0, 0, 0), (0, 0, 0), walk=False)
    for name, (x_m, y_m, _) in (("UTM", _UTM_M), ("1e7 m", _FAR_M)):
        place = x_m, y_m, 0
        differ = _count_differences(near, _packets(place, place, walk=False))
        yield Row(f"{name}: packets that differ", differ, 0)
    moved = np.abs(_codes(_packets(_ODD_M, _ODD_M, walk=False)) - _codes(near))
    yield Row("(432 117, 6 901 233) m: distances moved, steps of 2 mm", int(moved.max()), 1)


def _flat(x_m: NDArray[np.float64], _y_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ground at height 0."""
    return np.zeros_like(x_m)


def _path_at(way_m: NDArray[np.float64], along_m: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return points (n, 3) and headings (n,) at arc lengths (n,) of a path."""
    return [derivatives[:, 0] for derivatives in WalkedPath(way_m, _flat).derivatives_at(along_m)]


def path_shift_m(away_m: float) -> float:
    """Return how far, in metres, a path at (`away_m`, `away_m`) is off the same path at 0 at most."""
    along_m = np.linspace(0.0, 2.6, 10_001)
    near_m = _path_at(np.array(_WAY_M), along_m)[0]
    far_m = _path_at(np.array(_WAY_M) + away_m, along_m)[0]
    return float(np.abs(far_m[:, :2] - away_m - near_m[:, :2]).max())


@case("the same path at 0")
def far_walks() -> Iterator[Row]:
    """A path 100 and 900 km from the origin; its bound is two steps of float64 at that distance."""
    along_m = np.linspace(0.0, 2.6, 10_001)
    way_m = np.array(_WAY_M)
    heading_rad = _path_at(way_m, along_m)[1]
    for away_m in (1e5, 9e5):
        far_rad = _path_at(way_m + away_m, along_m)[1]
        yield Row(f"{away_m / 1000:g} km: moved, m", path_shift_m(away_m), 2 * float(np.spacing(away_m)))
        yield Row(f"{away_m / 1000:g} km: turned, rad", float(np.abs(far_rad - heading_rad).max()), 1e-9)
    yield refusal("a path 10 000 km away", partial(WalkedPath, way_m + 1e7, _flat), "within 1e+06 m")


_PLACES = {  # latitude, longitude, height of the origin; east, north, up of a point
    "the north pole, within 1 cm": ((89.9999999, 12.0, 0.0), (300.0, -400.0, 2.0)),
    "the date line": ((10.0, 180.0, 0.0), (500.0, 100.0, 5.0)),
    "8 km up": ((-33.0, -70.0, 8000.0), (1e4, 1e4, 500.0)),
    "1000 km away": ((62.24, 25.75, 100.0), (7e5, 7e5, 0.0)),
    "the equator": ((0.0, 0.0, -400.0), (1e-3, -1e-3, 0.0)),
}


def _earth_m(geodetic: list[mpf]) -> list[mpf]:
    """Earth-centred coordinates of a WGS 84 place, with 50 digits (NGA.STND.0036, section 4)."""
    latitude = mp.radians(geodetic[0])
    longitude = mp.radians(geodetic[1])
    height = geodetic[2]
    flattening = 1 / mpf("298.257223563")
    e2 = flattening * (2 - flattening)
    normal = 6378137 / mp.sqrt(1 - e2 * mp.sin(latitude) ** 2)
    out = (normal + height) * mp.cos(latitude)
    up = (normal * (1 - e2) + height) * mp.sin(latitude)
    return [out * mp.cos(longitude), out * mp.sin(longitude), up]


def _enu_m(geodetic: list[mpf], origin: list[mpf]) -> list[mpf]:
    latitude = mp.radians(origin[0])
    longitude = mp.radians(origin[1])
    x, y, z = (a - b for a, b in zip(_earth_m(geodetic), _earth_m(origin), strict=True))
    outward = mp.cos(longitude) * x + mp.sin(longitude) * y
    east = mp.cos(longitude) * y - mp.sin(longitude) * x
    north = mp.cos(latitude) * z - mp.sin(latitude) * outward
    return [east, north, mp.cos(latitude) * outward + mp.sin(latitude) * z]


@case("mpmath, 50 digits")
def globe() -> Iterator[Row]:
    """Places on earth where formulas divide by 0 or jump: the pole, the date line, high up, far away."""
    with mp.workdps(50):
        for name, (origin, local_m) in _PLACES.items():
            gps = Gps(latitude_deg=origin[0], longitude_deg=origin[1], height_m=origin[2])
            found = to_geodetic(np.array([local_m]), gps)
            true_m = _enu_m([mpf(x) for x in found[0].tolist()], [mpf(x) for x in origin])
            error_m = max(abs(float(a - mpf(b))) for a, b in zip(true_m, local_m, strict=True))
            yield Row(f"{name}: to degrees, m", error_m, 1e-7)
            back_m = to_local(found, gps)[0].tolist()
            error_m = max(abs(float(a - mpf(b))) for a, b in zip(true_m, back_m, strict=True))
            yield Row(f"{name}: to metres, m", error_m, 1e-7)
