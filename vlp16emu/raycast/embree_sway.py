"""What moves in a scene: instances whose transform Embree takes from the time of the ray."""

from typing import NamedTuple

import llvmlite.binding
import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from vlp16emu.errors import RunError
from vlp16emu.raycast.baking import Layout
from vlp16emu.raycast.embree_library import FORMAT_FLOAT3X4_ROW_MAJOR, library, library_path
from vlp16emu.raycast.placement import sheared
from vlp16emu.types import Window

__all__ = ["Motion", "motion_of", "set_steps", "tilt"]

_MOST_KNOTS = 129
"""RTC_MAX_TIME_STEP_COUNT (Embree 4, rtcore_common.h)."""

library()
llvmlite.binding.load_library_permanently(str(library_path()))
_set_count = types.ExternalFunction("rtcSetGeometryTimeStepCount", types.void(types.uintp, types.uint32))
_set_transform = types.ExternalFunction(
    "rtcSetGeometryTransform", types.void(types.uintp, types.uint32, types.int32, types.uintp)
)


class Motion(NamedTuple):
    """How the instances of a scene move while it lasts."""

    start_ns: int
    """UTC of the first knot."""
    span_ns: int
    """To the last one; 0 where nothing moves."""
    shear: NDArray[np.float32]
    """(k, n, 2) as in `Sway`, of all instances; no knots where nothing moves."""

    def times(self, t_ns: NDArray[np.int64]) -> NDArray[np.float32]:
        """Ray times 0..1 of any shape, for UTC; before and after the span its ends."""
        if not self.span_ns:
            return np.zeros(t_ns.shape, np.float32)
        return np.clip((t_ns - self.start_ns) / self.span_ns, 0.0, 1.0).astype(np.float32)


def motion_of(window: Window, layout: Layout) -> tuple[Motion, dict[int, NDArray[np.float32]]]:
    """Motion of a window's scene, in which the layout's piles come first and then its instances.

    Returns
    -------
    The motion, and window_T_shape (k, 3, 4) at all knots of each instance that moves

    Raises
    ------
    RunError
        where a window lasts too long for Embree
    """
    if (sway := window.sway) is None:
        return Motion(0, 0, np.empty((0, 0, 2), np.float32)), {}
    if len(sway.shear) > _MOST_KNOTS:
        raise RunError(f"wind: found {len(sway.shear)} knots in a window, Embree takes {_MOST_KNOTS}")
    numbers = len(layout.piles) + np.searchsorted(layout.instances, sway.placement)
    shear = np.zeros((len(sway.shear), len(layout.piles) + len(layout.instances), 2), np.float32)
    shear[:, numbers] = sway.shear
    transforms = sheared(window.world_T_shape[sway.placement], sway.foot_z_m, sway.shear)
    transforms[..., 3] -= window.origin_m
    by_instance = np.ascontiguousarray(transforms.swapaxes(0, 1), np.float32)
    span_ns = sway.step_ns * (len(sway.shear) - 1)
    moving = dict(zip(numbers.tolist(), by_instance, strict=True))
    return Motion(sway.start_ns, span_ns, shear), moving


@numba.njit(cache=True, nogil=True)
def set_steps(geometry: int, transforms: NDArray[np.float32]) -> None:
    """Give an instance, the address of a geometry, its transforms (k, 3, 4), evenly over times 0 to 1."""
    _set_count(geometry, len(transforms))
    for knot in range(len(transforms)):
        _set_transform(geometry, knot, FORMAT_FLOAT3X4_ROW_MAJOR, transforms[knot].ctypes.data)


@numba.njit(cache=True, nogil=True)
def tilt(shear: NDArray[np.float32], time: float, instance: int, axis: int) -> np.float32:
    """Shear of an instance at a ray time, between knots as Embree has it."""
    at = time * np.float32(shear.shape[0] - 1)
    knot = min(int(at), shear.shape[0] - 2)
    before, after = shear[knot, instance, axis], shear[knot + 1, instance, axis]
    return np.float32(before + (at - np.float32(knot)) * (after - before))
