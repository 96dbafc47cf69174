"""Far tiles: the interface between forests and the far medium.

A window with tiles is cast as faces up to `near_m` and as a medium beyond; other windows are cast as faces
alone.
"""

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vlp16emu.foliage.voxel import COLUMNS, FINER, QUANTILES
from vlp16emu.trees import Tree
from vlp16emu.types import F4, F8, I8, U1, U4, ShapeKey, Window, World

STEM = np.dtype(
    [
        ("foot_m", "<f8", 3),  # world: point where the axis leaves the ground, or the first leader
        ("axis", "<f8", 3),  # unit vector, upwards
        ("along_m", "<f4", 16),  # knots of the profile, from the foot along the axis, ascending
        # At the knots, east and north: offset of the section's centre from the axis.
        ("aside_m", "<f4", (2, 16)),
        ("radius_m", "<f4", 16),  # at the knots, linear in between; 0 at the tip of an unbroken tree
        ("flare_m", "<f4"),  # along the axis: end of the root flare
        ("row", "<u4", 2),  # rows of the tile's surfaces: root flare, and the stem above it
    ]
)
"""A far stem, or its second leader: circles across the axis."""

EXACT = 255
"""In place of a `PlantPart`: a mesh of a `FarTile` that is exact as `STEM`s, not part of the medium."""

SIDE_CODES = 255  # greatest code of a side, for as much side as ground
SIDE_ROW_BIT = 8  # first bit of the row of its surface


@dataclass(frozen=True, slots=True)
class FarTile:
    """A far square of the world, 20 m wide: its part in the medium, and its exact part."""

    corner_m: F8  # (3,) south-west corner; the height is a multiple of 2 m, near the ground
    keys: tuple[ShapeKey, ...]  # distinct shapes of the medium
    shape: I8  # (n,) of each placement, index into `keys`
    world_T_shape: F8  # (n, 3, 4)
    first_surface: I8  # (n,) first row in the tile's surfaces
    first_part: I8  # (shapes + 1,) first mesh of each shape in `part`
    part: U1  # (meshes,) `PlantPart` or `EXACT`
    stems: NDArray[np.void]  # (s,) `STEM`
    ground_m: F8
    """Heights (85, 85) every 0.25 m in x and y, from 0.5 m outside the corner to 0.5 m outside the opposite
    one."""
    sides: U4 = field(default_factory=lambda: np.zeros((COLUMNS * FINER, COLUMNS * FINER), np.uint32))
    """Sides of things that are too low for the medium, on squares (80, 80) of 0.25 m: their projected area
    over that of the square, 255 for 1, and from `SIDE_ROW_BIT` the row of their surface in the tile."""
    facing: F4 = field(default_factory=lambda: np.ones(QUANTILES, np.float32))
    """(QUANTILES,) quantiles of the cosine of incidence of such things, the same for all tiles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TiledWindow(Window):
    """A window with squares that may be cast as a far medium."""

    track_m: F8  # (t, 3) sensor positions of the window; near and far refer to them
    tiles: tuple[tuple[int, int, int], ...]
    """Squares (ix, iy) whose far medium `TiledWorld.far_tile` makes, and their first rows in `surfaces`."""
    far: NDArray[np.bool_]  # (n,) mask of the placements that `tiles` represent
    low: NDArray[np.bool_]
    """(n,) mask of the others that near light alone meets: so low that far light meets the ground instead, or
    loose stems, which the far medium has as `STEM`s."""

    def with_more(self, count: int) -> Tree:
        """Return the fields of the window for `count` more placements that are exact at any range."""
        exact = np.zeros(count, np.bool_)
        return {"far": np.append(self.far, exact), "low": np.append(self.low, exact)}


@runtime_checkable
class TiledWorld(World, Protocol):
    """A world of squares that are cast as a far medium beyond `near_m`."""

    @property
    def name(self) -> str:
        """Return a digest of all inputs of its `far_tile`s; empty if they are not kept on disk."""

    def far_tile(self, ix: int, iy: int) -> FarTile:
        """Return a far square of the world; equal arguments give equal squares."""

    def core(self, key: ShapeKey) -> F8 | None:
        """Return heights and radii (2, k) of the stem around the z axis of a shape that has none itself.

        None for other shapes. Heights ascend; what is inside the stem is not part of the far medium.
        """
