"""The inner loop: packets of eight rays through Embree, compiled, without the GIL.

A packet holds eight consecutive firings of one laser: neighbouring azimuths, which is what Embree's
coherent traversal wants. Which rays share a packet depends on firing numbers alone.
"""

import math

import llvmlite.binding
import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from vlp16emu.raycast.embree_library import FLAG_COHERENT, library, library_path

__all__ = ["PACKET", "cast_packets"]

PACKET = 8
"""Rays per packet; 16 is slower without AVX-512."""

library()
llvmlite.binding.load_library_permanently(str(library_path()))
_intersect = types.ExternalFunction(
    "rtcIntersect8", types.void(types.uintp, types.uintp, types.uintp, types.uintp)
)

# Rows of RTCRayHit8, each of eight 4-byte words (rtcore_ray.h).
_ORG, _TNEAR, _DIR, _TIME, _TFAR, _MASK, _ID, _FLAGS = 0, 3, 4, 7, 8, 9, 10, 11
_NG, _GEOM, _INST = 12, 18, 19
_ROWS = 21
_ALIGN = 64
_NONE = np.uint32(0xFFFFFFFF)


@numba.njit(cache=True, nogil=True)
def _aligned(bytes_: int) -> NDArray[np.uint8]:
    """Memory that starts at a multiple of 64 bytes."""
    raw = np.zeros(bytes_ + _ALIGN, np.uint8)
    skip = (-raw.ctypes.data) % _ALIGN
    return raw[skip : skip + bytes_]


@numba.njit(cache=True, nogil=True)
def _arguments(context: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """RTCIntersectArguments: flags, feature mask (all), then pointers to context, no filter, no callback.

    Each thread needs its own context: a shared one loses hits on instances silently.
    """
    words = _aligned(64).view(np.uint32)
    words[0], words[1] = FLAG_COHERENT, _NONE
    address = np.uint64(context.ctypes.data)
    words[2], words[3] = np.uint32(address & np.uint64(0xFFFFFFFF)), np.uint32(address >> np.uint64(32))
    return words


@numba.njit(cache=True, nogil=True)
def cast_packets(
    scene: int,
    window_origin_m: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    near_m: NDArray[np.float64],
    far_m: float,
    first_surface: NDArray[np.uint32],
    normal_matrix: NDArray[np.float32],
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
) -> None:
    """Cast one ray per pulse.

    Parameters
    ----------
    scene : address of a committed RTCScene of instances
    window_origin_m : (3,) taken from the origins in float64, before the step to float32
    origin_m, direction : (k, L, 3) float64, k a multiple of `PACKET`
    near_m, far_m : (L,) where each laser's light begins, and where it is given up
    first_surface, normal_matrix : (n,), (n, 3, 3) per instance, as in `placement`
    range_m, surface, cos_incidence : (k, L) outputs
    """
    rays = _aligned(_ROWS * PACKET * 4).view(np.float32).reshape(_ROWS, PACKET)
    words, valid = rays.view(np.uint32), _aligned(PACKET * 4).view(np.int32)
    valid[:] = -1
    context = _aligned(16).view(np.uint32)
    arguments = _arguments(context)
    for first in range(0, origin_m.shape[0], PACKET):
        for j in range(origin_m.shape[1]):
            for r in range(PACKET):
                i = first + r
                _load(rays, r, origin_m[i, j], window_origin_m, direction[i, j])
                _reset(rays, words, r, near_m[j], far_m)
            context[:] = _NONE
            _intersect(valid.ctypes.data, scene, rays.ctypes.data, arguments.ctypes.data)
            for r in range(PACKET):
                i, instance = first + r, words[_INST, r]
                if instance == _NONE:
                    range_m[i, j], surface[i, j], cos_incidence[i, j] = np.inf, _NONE, 0.0
                else:
                    range_m[i, j] = rays[_TFAR, r]
                    surface[i, j] = first_surface[instance] + words[_GEOM, r]
                    cos_incidence[i, j] = _cosine(normal_matrix[instance], rays, r)


@numba.njit(cache=True, nogil=True)
def _load(
    rays: NDArray[np.float32],
    r: int,
    origin_m: NDArray[np.float64],
    window_origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> None:
    """Put ray r on its line."""
    for a in range(3):
        rays[_ORG + a, r] = np.float32(origin_m[a] - window_origin_m[a])
        rays[_DIR + a, r] = np.float32(direction[a])


@numba.njit(cache=True, nogil=True)
def _reset(rays: NDArray[np.float32], words: NDArray[np.uint32], r: int, near_m: float, far_m: float) -> None:
    """Give ray r its limits and take away what it hit before."""
    rays[_TNEAR, r], rays[_TIME, r], rays[_TFAR, r] = near_m, 0.0, far_m
    words[_MASK, r], words[_ID, r], words[_FLAGS, r] = _NONE, r, 0
    words[_GEOM, r], words[_INST, r] = _NONE, _NONE


@numba.njit(cache=True, nogil=True)
def _cosine(matrix: NDArray[np.float32], rays: NDArray[np.float32], r: int) -> np.float32:
    """Cosine between a ray and the world normal; Embree gives normals in the shape's coordinates."""
    dot, square = np.float32(0.0), np.float32(0.0)
    for a in range(3):
        n = matrix[a, 0] * rays[_NG, r] + matrix[a, 1] * rays[_NG + 1, r] + matrix[a, 2] * rays[_NG + 2, r]
        dot += n * rays[_DIR + a, r]
        square += n * n
    return np.float32(min(abs(float(dot)) / math.sqrt(square), 1.0)) if square > 0.0 else np.float32(0.0)
