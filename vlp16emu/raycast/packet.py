"""The Embree packet: eight rays that are cast together, and what they meet.

What makes no arrays counts no references (`_nrt=False`), and loops take arrays out of tuples first.
"""

import math
from typing import NamedTuple

import llvmlite.binding
import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from vlp16emu.raycast.build import tilt
from vlp16emu.raycast.embree import FLAG_COHERENT, library, library_path
from vlp16emu.raycast.pieces import LEVEL

__all__ = [
    "DIR",
    "INST",
    "NONE",
    "ORG",
    "PACKET",
    "RayPacket",
    "Target",
    "cast_beyond",
    "cast_packet",
    "ray_met",
    "ray_packet",
    "reset",
]

PACKET = 8
"""Rays per packet; 16 is slower without AVX-512."""

library()
llvmlite.binding.load_library_permanently(str(library_path()))
_intersect = types.ExternalFunction(
    "rtcIntersect8", types.void(types.uintp, types.uintp, types.uintp, types.uintp)
)

# Rows of RTCRayHit8, each of eight 4-byte words (rtcore_ray.h).
ORG, _TNEAR, DIR, _TIME, _TFAR, _MASK, _ID, _FLAGS = 0, 3, 4, 7, 8, 9, 10, 11
_NG, _GEOM, INST, _ROWS = 12, 18, 19, 21
_ALIGN = 64
NONE = np.uint32(0xFFFFFFFF)


class Target(NamedTuple):
    """What is cast against as faces."""

    scene: int
    """Address of a committed RTCScene of instances that level rays may meet; 0 where there is nothing."""
    steep: int
    """The same for rays that are not `LEVEL`; 0 also where none such is cast."""
    window_origin_m: NDArray[np.float64]
    """(3,) taken from the origins in float64, before the step to float32."""
    first_surface: NDArray[np.uint32]
    """(n,) per instance, as in `Window`."""
    normal_matrix: NDArray[np.float32]
    """(n, 3, 3) per instance, as in `geometry`."""
    shear: NDArray[np.float32]
    """(knots, n, 2) per instance, as in `build.InstanceMotion`."""
    reflectance: NDArray[np.float32]
    """(m,) of the surfaces."""


class RayPacket(NamedTuple):
    """A thread's own packet."""

    rays: NDArray[np.float32]
    words: NDArray[np.uint32]
    valid: NDArray[np.int32]
    context: NDArray[np.uint32]
    arguments: NDArray[np.uint32]


@numba.njit(cache=True, nogil=True)
def _aligned(bytes_: int) -> NDArray[np.uint8]:
    """Memory that starts at a multiple of 64 bytes."""
    raw = np.zeros(bytes_ + _ALIGN, np.uint8)
    return raw[(-raw.ctypes.data) % _ALIGN :][:bytes_]


@numba.njit(cache=True, nogil=True)
def ray_packet() -> RayPacket:
    """Make an empty packet.

    RTCIntersectArguments: flags, feature mask (all), then pointers to context, no filter, no callback. Each thread needs
    its own context: a shared one loses hits on instances silently.
    """
    rays = _aligned(_ROWS * PACKET * 4).view(np.float32).reshape(_ROWS, PACKET)
    context, arguments = _aligned(16).view(np.uint32), _aligned(64).view(np.uint32)
    arguments[0], arguments[1] = FLAG_COHERENT, NONE
    address = np.uint64(context.ctypes.data)
    arguments[2], arguments[3] = (
        np.uint32(address & np.uint64(0xFFFFFFFF)),
        np.uint32(address >> np.uint64(32)),
    )
    words = rays.view(np.uint32)
    for lane in range(PACKET):
        words[_MASK, lane], words[_ID, lane], words[_FLAGS, lane] = NONE, lane, 0
    return RayPacket(
        rays,
        words,
        _aligned(PACKET * 4).view(np.int32),
        context,
        arguments,
    )


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def cast_packet(target: Target, packet: RayPacket) -> None:
    """Cast the rays of a packet that are valid, all of them as steep ones where one is steep."""
    rays, rise = packet.rays, np.float32(0.0)
    for lane in range(PACKET):
        rise = max(rise, abs(rays[DIR + 2, lane]))
    scene = target.scene if rise <= LEVEL else target.steep
    if scene:
        packet.context[:] = NONE
        _intersect(packet.valid.ctypes.data, scene, rays.ctypes.data, packet.arguments.ctypes.data)


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def cast_beyond(beyond: Target, packet: RayPacket, reach_m: float, far_m: float) -> None:
    """Cast the rays that are still valid against what is cast as faces at any range."""
    rays, valid = packet.rays, packet.valid
    for lane in range(PACKET):
        if valid[lane]:
            rays[_TNEAR, lane], rays[_TFAR, lane] = reach_m, far_m
    cast_packet(beyond, packet)


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def ray_met(target: Target, packet: RayPacket, r: int) -> tuple[np.float32, np.uint32, np.float32]:
    """Range, surface and cosine of incidence of what ray r met."""
    instance = packet.words[INST, r]
    surface = np.uint32(target.first_surface[instance] + packet.words[_GEOM, r])
    return (
        packet.rays[_TFAR, r],
        surface,
        _cosine(target.normal_matrix, target.shear, instance, packet.rays, r),
    )


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def reset(packet: RayPacket, r: int, near_m: float, far_m: float, time: float) -> None:
    """Give ray r its limits and its time, and take away what it hit before."""
    rays, words = packet.rays, packet.words
    rays[_TNEAR, r], rays[_TIME, r], rays[_TFAR, r] = near_m, time, far_m
    words[_GEOM, r], words[INST, r] = NONE, NONE


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cosine(
    matrix: NDArray[np.float32], shear: NDArray[np.float32], n: int, rays: NDArray[np.float32], r: int
) -> np.float32:
    """Cosine between a ray and the world normal; Embree gives normals in the shape's coordinates."""
    dot, square, leaned = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for a in range(3):
        turned = np.float32(0.0)
        for b in range(3):
            turned += matrix[n, a, b] * rays[_NG + b, r]
        if shear.shape[0]:  # normals of what is sheared level change in height only
            if a < 2:
                leaned += tilt(shear, rays[_TIME, r], n, a) * turned
            else:
                turned -= leaned
        dot += turned * rays[DIR + a, r]
        square += turned * turned
    return np.float32(min(abs(float(dot)) / math.sqrt(square), 1.0)) if square > 0.0 else np.float32(0.0)
