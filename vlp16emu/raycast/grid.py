"""What is far in a window, as light goes through it: ground as a grid, stems as cones, foliage as bricks of voxels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Ground", "Medium", "Stems"]


class Ground(NamedTuple):
    """The ground."""

    height_m: NDArray[np.float32]
    """(4 x + 1, 4 y + 1) at the corners of voxel columns."""
    surface: NDArray[np.uint32]
    """(x, y) of the column of bricks."""
    corner_x_m: float
    corner_y_m: float
    steepest: float
    """Greatest slope."""


class Stems(NamedTuple):
    """Stems, and where they stand."""

    first: NDArray[np.int32]
    """(4 x, 4 y, 2) where the stems of each column of voxels begin and stop in `of`."""
    of: NDArray[np.int32]
    """Stems of the columns, one column after the other."""
    line: NDArray[np.float64]
    """(n, 7) foot, unit axis, and widest radius."""
    profile: NDArray[np.float32]
    """(n, 3, knots) heights along the axis, radii, and the greatest radius from there upwards."""
    surface: NDArray[np.uint32]
    """(n, 2) of root flare and stem."""
    flare_m: NDArray[np.float32]
    """(n,) height along the axis at which the flare ends."""


class Medium(NamedTuple):
    """What is far in a window, relative to the window's origin."""

    near_m: float
    """Range at which it begins; nothing where it is infinite."""
    corner_m: tuple[float, float, float]
    """Of the grid of bricks."""
    corner: tuple[int, int, int]
    """The same in voxels of the world."""
    brick: NDArray[np.uint64]
    """(x, y, z, 2) of each brick which voxels hold anything, and in which a stem may be met, as in `Block`."""
    first: NDArray[np.uint32]
    """(x, y, z) number of each brick's first voxel."""
    record: NDArray[np.uint32]
    """(m,) of voxels, as in `Block`, and of some that are in other windows only."""
    first_owner: NDArray[np.uint32]
    """(m,) of each of them."""
    owner: NDArray[np.uint64]
    """(o,) as in `Block`."""
    surface: NDArray[np.uint32]
    """(x / 10, y / 10, 9) first surfaces of each tile and of those around it."""
    cosine: NDArray[np.float32]
    """(laws, knots, QUANTILES) as in `Cloud`."""
    ground: Ground
    stems: Stems
    seed: int
