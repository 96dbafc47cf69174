"""Worlds far from the origin: the same plot at map coordinates, in files and in the world itself."""

import csv
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu import Emulator
from vlp16emu.extras.walk.path import Path as WalkedPath
from vlp16emu.packets import data_fields
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind

_FAR_M = 10_000_000, 10_000_000, 210
_ODD_M = 432_117, 6_901_233, 0  # no corner of a tile: ground and trees are cut otherwise there, and round otherwise
_TREES_M = [(6.25, 4.5), (-5.0, 3.25), (-4.5, -6.0), (9.0, -9.5), (-8.25, 9.0)]
_WAY_M = [(-1.0, 0.5), (0.0, 0.0), (1.5, 0.25)]
_HALF_M = 60  # of the ground in the file, which the sensor's reach must not leave
_SPAN_S = 0.0, 0.1

_SCENE = """\
schema = 1
title = "A plot at some place"
seed = 3
sensor = {{ max_range_m = 20.0 }}
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


def write_plot(folder: Path, files_m: tuple[int, ...], scene_m: tuple[int, ...], *, walk: bool) -> Path:
    """Write a plot whose files lie about one place of the map, and its scene about another one of the world."""
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
    motion = (
        f'{{ kind = "walk", way_points_m = [{way}] }}' if walk else f'{{ kind = "static", x_m = {x}.0, y_m = {y}.0 }}'
    )
    origin = ", ".join(f"{file - at}.0" for file, at in zip(files_m, scene_m, strict=True))
    scene = folder / "plot.toml"
    # Patches of texture, and leaves beyond `near_m`, are drawn by their place in the world: a world that stands elsewhere has
    # others. So the moved one has no texture, and is of faces as far as the sensor reaches.
    texture, near_m = (0.1, 12.0) if walk else (0.0, 20.0)
    place = {"x": f"{x + 4}.0", "y": f"{y - 3}.0"}
    scene.write_text(_SCENE.format(motion=motion, origin=origin, texture=texture, near_m=near_m, **place))
    return scene


def _packets(files_m: tuple[int, ...], scene_m: tuple[int, ...], *, walk: bool) -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        emulator = Emulator(load(str(write_plot(Path(folder), files_m, scene_m, walk=walk))))
        return [p.payload for p in emulator.packets(*_SPAN_S) if p.kind is PacketKind.DATA]


def _codes(packets: list[bytes]) -> NDArray[np.int64]:
    """Distances in steps of 2 mm."""
    payloads = np.frombuffer(b"".join(packets), np.uint8).reshape(len(packets), -1)
    return data_fields(payloads)["blocks"]["records"]["distance_lsb"].astype(np.int64)


def test_far_files():
    """With stem list and ground in map coordinates, 1e7 m from their zero, a walk has the packets of the same plot at zero."""
    near = _packets((0, 0, 0), (0, 0, 0), walk=True)
    assert _packets(_FAR_M, (0, 0, 0), walk=True) == near


def test_far_worlds():
    """A world moved by whole tiles to 1e7 m gives the same bytes; by another offset distances move by a step of 2 mm at most."""
    near = _packets((0, 0, 0), (0, 0, 0), walk=False)
    far_m = *_FAR_M[:2], 0
    assert _packets(far_m, far_m, walk=False) == near
    moved = np.abs(_codes(_packets(_ODD_M, _ODD_M, walk=False)) - _codes(near))
    assert moved.max() <= 1  # distance moved, steps of 2 mm


def _flat(x_m: NDArray[np.float64], _y_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ground at height 0."""
    return np.zeros_like(x_m)


def _followed(way_m: NDArray[np.float64], along_m: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return points (n, 3) and headings (n,) at arc lengths (n,) of a path."""
    return [derivatives[:, 0] for derivatives in WalkedPath(way_m, _flat).derivatives_at(along_m)]


def test_far_walks():
    """The same path 100 km and 900 km from the origin is moved by two steps of float64 at most, and turned by 1e-9 rad."""
    way_m = np.array(_WAY_M)
    along_m = np.linspace(0.0, 2.6, 10_001)
    near_m, heading_rad = _followed(way_m, along_m)
    for away_m in (1e5, 9e5):
        far_m, far_rad = _followed(way_m + away_m, along_m)
        assert np.abs(far_m[:, :2] - away_m - near_m[:, :2]).max() <= 2 * np.spacing(away_m)
        assert np.abs(far_rad - heading_rad).max() <= 1e-9
