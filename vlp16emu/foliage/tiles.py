"""Far tiles: the contract between forests and the medium that they become.

A window with tiles is cast as faces to `near_m`, and beyond as a medium; any other one as faces alone.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import F8, I8, U1, ShapeKey, Window, World

STEM = np.dtype(
    [
        ("foot_m", "<f8", 3),  # world: where the axis leaves the ground, or the first leader
        ("axis", "<f8", 3),  # unit vector, upwards
        ("along_m", "<f4", 16),  # knots of the profile, from the foot along the axis, ascending
        ("aside_m", "<f4", (2, 16)),  # at the knots, to east and north: from the axis to the section's middle
        ("radius_m", "<f4", 16),  # at the knots, in between linear; 0 at a whole tree's tip
        ("flare_m", "<f4"),  # along the axis: where the root flare ends
        ("row", "<u4", 2),  # of the tile's surfaces: root flare, and the stem above it
    ]
)
"""A far stem, or the second leader of one: circles across its axis."""

EXACT = 255  # stands for the `PlantPart` of a `FarTile`'s mesh that is exact as `STEM`s, and no medium


@dataclass(frozen=True, slots=True)
class FarTile:
    """A far square of the world, 20 m wide: what becomes a medium, and what stays exact."""

    corner_m: F8  # (3,) south-west corner; the height is a multiple of 2 m, near the ground
    keys: tuple[ShapeKey, ...]  # different shapes of what becomes a medium
    shape: I8  # (n,) of each placement, index into `keys`
    world_T_shape: F8  # (n, 3, 4)
    first_surface: I8  # (n,) row of the tile's surfaces
    first_part: I8  # (shapes + 1,) where the meshes of each shape begin in `part`
    part: U1  # (meshes,) `PlantPart` of each, or `EXACT`
    stems: NDArray[np.void]  # (s,) `STEM`
    ground_m: F8
    """(85, 85) heights every 0.25 m in x and y, from 0.5 m outside the corner to 0.5 m outside the opposite one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TiledWindow(Window):
    """A window with squares that may be cast as a far medium."""

    track_m: F8  # (t, 3) positions of the sensors that the window is for, to which things are near or far
    tiles: tuple[tuple[int, int, int], ...]
    """Squares (ix, iy) whose far medium `TiledWorld.far_tile` makes, and the row of `surfaces` at which theirs begin."""
    far: NDArray[np.bool_]  # (n,) which placements `tiles` stand for
    low: NDArray[np.bool_]  # (n,) which of the others are so low that far light meets the ground in their place

    def with_more(self, count: int) -> dict[str, Any]:
        """Return the further fields of the window for `count` placements that are exact at any range."""
        exact = np.zeros(count, np.bool_)
        return {"far": np.append(self.far, exact), "low": np.append(self.low, exact)}


class TiledWorld(World, Protocol):
    """A world of squares that are a far medium beyond `near_m`."""

    @property
    def name(self) -> str:
        """Return a digest of all that decides its `far_tile`s; empty if nothing of it is kept on disk."""

    def far_tile(self, ix: int, iy: int) -> FarTile:
        """Return a far square of the world; the same square is always the same."""
