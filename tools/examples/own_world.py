#!/usr/bin/env python3
"""Your own world: bare dunes. A scene selects a class by its `kind`.

A package that declares it as an entry point of the group `vlp16emu.worlds` makes it available to all
scene files and commands.

tools/examples/own_world.py [SECONDS]
"""

import sys
from typing import Literal

import numpy as np

from vlp16emu import Emulator
from vlp16emu.settings import Size
from vlp16emu.types import SURFACE, Mesh, Semantic, Window
from vlp16emu.world.settings import WorldSection


class Dunes(WorldSection):
    """Dunes of sand, 200 m by 200 m."""

    kind: Literal["dunes"]
    height_m: Size = 2.0
    length_m: Size = 40.0

    def site(self, seed: int) -> "Site":
        """Return the ground; `seed` is the seed of random parts."""
        return Site(self)


class Site:
    """Ground and world in one class: a `Site` and a `World` of vlp16emu."""

    origin_m, obstacles, near_m, seed = (0.0, 0.0, 0.0), None, np.inf, 0

    def __init__(self, dunes: Dunes) -> None:
        self.dunes, self.name = dunes, repr(dunes)

    def height_m(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the height of the ground."""
        return self.dunes.height_m / 2 * np.sin(2 * np.pi * x_m / self.dunes.length_m) + 0 * y_m

    def world(self, path_xy_m: np.ndarray, **_: object) -> tuple["Site", None]:
        """Return the world around a path, and its moving parts."""
        return self, None

    def window(self, track_m: np.ndarray) -> Window:
        """Return the window in range of positions (n, 3): one shape of one surface, at its origin."""
        sand = np.zeros(1, SURFACE)
        sand["semantic"], sand["reflectance"] = Semantic.GROUND, 0.4
        first, place = np.zeros(1, np.uint32), np.eye(4)[None, :3]
        return Window(np.zeros(3), ("dunes",), np.zeros(1, np.int32), place, first, sand)

    def shape(self, key: object) -> tuple[Mesh]:
        """Return the mesh of the shape: squares of half a metre."""
        x_m, y_m = np.meshgrid(np.arange(-100, 100.5, 0.5), np.arange(-100, 100.5, 0.5))
        n = x_m.shape[1]
        corner = (np.arange(n - 1) + n * np.arange(len(x_m) - 1)[:, None]).ravel()
        squares = corner[:, None] + np.array([[0, 1, n + 1], [0, n + 1, n]]).reshape(-1)
        vertices_m = np.column_stack([x_m.ravel(), y_m.ravel(), self.height_m(x_m, y_m).ravel()])
        return (Mesh(vertices_m.astype(np.float32), squares.reshape(-1, 3).astype(np.uint32)),)

    def shape_name(self, key: object) -> str:
        """Return the name under which the store keeps the shape; empty to keep nothing."""
        return ""


if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    walk = {"kind": "walk", "way_points_m": [[-40, 0], [40, 5]]}
    scene = {"schema": 1, "title": "dunes", "motion": walk, "world": {"kind": "dunes", "height_m": 3.0}}
    recording = Emulator(scene).record("dunes.pcap", duration_s=seconds)
    print(recording.returns, "returns")
