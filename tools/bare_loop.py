"""The least that casts: rays loaded and handed to Embree, which is what all casting is measured by."""
# ruff: noqa: SLF001  # it reaches under the caster

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast import LINE, Footprint, Scene
from vlp16emu.raycast import embree_kernel as kernel
from vlp16emu.raycast.footprint import sub_rays
from vlp16emu.types import Firings

__all__ = ["bare", "in_order", "packets"]


@numba.njit(nogil=True)
def bare(
    scene: int,
    rays: NDArray[np.float32],
    near_m: NDArray[np.float64],
    far_m: float,
    range_m: NDArray[np.float32],
) -> None:
    """Load packets (n, 6, 8) with near limits (n,) and call Embree, and nothing else."""
    packet = kernel._packet()
    words = packet.words
    packet.valid[:] = -1
    for p in range(rays.shape[0]):
        for lane in range(8):
            kernel._reset(packet.rays, words, lane, near_m[p], far_m)
            for a in range(3):
                packet.rays[a, lane], packet.rays[4 + a, lane] = rays[p, a, lane], rays[p, 3 + a, lane]
        packet.context[:] = 0xFFFFFFFF
        kernel._intersect(
            packet.valid.ctypes.data, scene, packet.rays.ctypes.data, packet.arguments.ctypes.data
        )
        for lane in range(8):
            range_m[p, lane] = packet.rays[8, lane] if words[19, lane] != 0xFFFFFFFF else np.inf


def packets(opened: Scene, firings: Firings, beam: Footprint) -> NDArray[np.float32]:
    """Rays of a block, ready to load and in the order in which the chain casts them, (n, 6, 8)."""
    shape = firings.t_ns.shape
    if beam is LINE:
        origin_m, direction = firings.origin_m, firings.direction
    else:
        none = np.zeros(shape, np.int64)
        origin_m, direction = sub_rays(firings, beam, none, none + beam.rays)
    six = (
        np.concatenate([origin_m - opened._target.window_origin_m, direction], axis=-1)
        .astype(np.float32)
        .reshape(-1, 6)
    )
    return np.ascontiguousarray(in_order(six, shape[1], beam.rays).transpose(0, 2, 1))


def in_order(rays: NDArray[np.float32], lasers: int, per_pulse: int) -> NDArray[np.float32]:
    """From the order of pulses (n, c) to that of casting (n / 8, 8, c): laser by laser in eight sequences."""
    eights = rays.reshape(-1, 8, lasers, per_pulse, rays.shape[-1])
    return eights.transpose(0, 2, 1, 3, 4).reshape(-1, 8, rays.shape[-1])
