"""Transforms of a window's placements, as casters want them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import Window

__all__ = ["frozen", "normal_matrices", "relative_to_window", "sheared"]


def relative_to_window(window: Window) -> NDArray[np.float64]:
    """window_T_shape (n, 3, 4): placements relative to the window's origin, still in float64."""
    transforms = window.world_T_shape.copy()
    transforms[:, :, 3] -= window.origin_m
    return transforms


def normal_matrices(window: Window) -> NDArray[np.float32]:
    """(n, 3, 3) inverse transposes, which take a shape's normals to the world also where it is scaled."""
    return np.ascontiguousarray(np.linalg.inv(window.world_T_shape[:, :, :3]).transpose(0, 2, 1), np.float32)


def sheared(
    world_T_shape: NDArray[np.float64], foot_z_m: NDArray[np.float64], shear: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Move placements (m, 3, 4) level by `shear` (..., m, 2) per metre over a foot (m,): (..., m, 3, 4)."""
    over_foot = world_T_shape[:, 2].copy()
    over_foot[:, 3] -= foot_z_m
    moved = np.broadcast_to(world_T_shape, (*shear.shape[:-1], 3, 4)).copy()
    moved[..., :2, :] += shear[..., None] * over_foot[:, None]
    return moved


def frozen(window: Window, t_ns: int) -> Window:
    """Still window that a moving one is at a time, or at its first or last where that is outside."""
    if (sway := window.sway) is None:
        return window
    steps = len(sway.shear) - 1
    at = min(max((t_ns - sway.start_ns) / sway.step_ns, 0.0), float(steps))
    knot = min(int(at), steps - 1)
    shear = sway.shear[knot] + (at - knot) * (sway.shear[knot + 1] - sway.shear[knot])
    transforms = window.world_T_shape.copy()
    transforms[sway.placement] = sheared(transforms[sway.placement], sway.foot_z_m, shear)
    return replace(window, world_T_shape=transforms, sway=None)
