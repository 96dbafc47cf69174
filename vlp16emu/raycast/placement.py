"""Transforms of a window's placements, as casters want them."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import Window

__all__ = ["normal_matrices", "relative_to_window"]


def relative_to_window(window: Window) -> NDArray[np.float64]:
    """window_T_shape (n, 3, 4): placements relative to the window's origin, still in float64."""
    transforms = window.world_T_shape.copy()
    transforms[:, :, 3] -= window.origin_m
    return transforms


def normal_matrices(window: Window) -> NDArray[np.float32]:
    """(n, 3, 3) inverse transposes, which take a shape's normals to the world also where it is scaled."""
    return np.ascontiguousarray(np.linalg.inv(window.world_T_shape[:, :, :3]).transpose(0, 2, 1), np.float32)
