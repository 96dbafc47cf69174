"""The inner loop: packets of eight rays through Embree, compiled, without the GIL.

A packet holds eight consecutive firings of one laser, neighbouring azimuths, or sub-rays of one footprint or of
neighbouring ones: near each other, which is what Embree's coherent traversal wants. Which rays share a packet
depends on firing numbers and on what was hit, never on threads. What makes no arrays counts no references
(`_nrt=False`), and loops take arrays out of tuples first: a twentieth of the time.
"""

import math
from typing import NamedTuple

import llvmlite.binding
import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from vlp16emu.raycast.adaptive import enough
from vlp16emu.raycast.embree_library import FLAG_COHERENT, library, library_path
from vlp16emu.raycast.embree_sway import tilt
from vlp16emu.raycast.embree_task import Light, Target, Wish
from vlp16emu.raycast.footprint import ROUND, pulse_axes, sub_ray, turn

__all__ = ["PACKET", "cast_packets", "cast_sub_rays"]

PACKET = 8
"""Rays per packet; 16 is slower without AVX-512."""

library()
llvmlite.binding.load_library_permanently(str(library_path()))
_intersect = types.ExternalFunction(
    "rtcIntersect8", types.void(types.uintp, types.uintp, types.uintp, types.uintp)
)

# Rows of RTCRayHit8, each of eight 4-byte words (rtcore_ray.h).
_ORG, _TNEAR, _DIR, _TIME, _TFAR, _MASK, _ID, _FLAGS = 0, 3, 4, 7, 8, 9, 10, 11
_NG, _GEOM, _INST, _ROWS = 12, 18, 19, 21
_ALIGN = 64
_NONE = np.uint32(0xFFFFFFFF)


@numba.njit(cache=True, nogil=True)
def _aligned(bytes_: int) -> NDArray[np.uint8]:
    """Memory that starts at a multiple of 64 bytes."""
    raw = np.zeros(bytes_ + _ALIGN, np.uint8)
    return raw[(-raw.ctypes.data) % _ALIGN :][:bytes_]


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
    target: Target,
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    time: NDArray[np.float32],
    near_m: NDArray[np.float64],
    far_m: float,
    order: NDArray[np.int64],
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
) -> None:
    """Cast one ray per pulse.

    Parameters
    ----------
    origin_m, direction : (k, L, 3) float64, k a multiple of `PACKET`
    time : (k, L) between the scene's first knot and its last, 0..1
    near_m, far_m : (L,) where each laser's light begins, and where it is given up
    order : (k / 8,) first sequence of each packet, in the order of casting
    range_m, surface, cos_incidence : (k, L) outputs
    """
    scene, window_origin_m, shear = target.scene, target.window_origin_m, target.shear
    first_surface, normal_matrix = target.first_surface, target.normal_matrix
    packet = _packet()
    rays, words, valid, context = packet.rays, packet.words, packet.valid, packet.context
    valid[:] = -1
    lines = np.empty((origin_m.shape[1], 6, PACKET), np.float32)
    for first in order:
        _lay(lines, first, origin_m, window_origin_m, direction)
        for j in range(origin_m.shape[1]):
            for r in range(PACKET):
                for a in range(3):
                    rays[_ORG + a, r], rays[_DIR + a, r] = lines[j, a, r], lines[j, 3 + a, r]
                _reset(rays, words, r, near_m[j], far_m, time[first + r, j])
            context[:] = _NONE
            _intersect(valid.ctypes.data, scene, rays.ctypes.data, packet.arguments.ctypes.data)
            for r in range(PACKET):
                i, instance = first + r, words[_INST, r]
                if instance == _NONE:
                    range_m[i, j], surface[i, j], cos_incidence[i, j] = np.inf, _NONE, 0.0
                else:
                    range_m[i, j] = rays[_TFAR, r]
                    surface[i, j] = first_surface[instance] + words[_GEOM, r]
                    cos_incidence[i, j] = _cosine(normal_matrix, shear, instance, rays, r)


class _Hits(NamedTuple):
    """Hits of eight sequences, or of a batch: three arrays of one shape."""

    range_m: NDArray[np.float32]
    surface: NDArray[np.uint32]
    cos_incidence: NDArray[np.float32]


@numba.njit(cache=True, nogil=True)
def _hits(shape: int | tuple[int, ...]) -> _Hits:
    """Make room for hits."""
    return _Hits(np.empty(shape, np.float32), np.empty(shape, np.uint32), np.empty(shape, np.float32))


class _Packet(NamedTuple):
    """A thread's own packet, and to whom its rays belong."""

    rays: NDArray[np.float32]
    words: NDArray[np.uint32]
    valid: NDArray[np.int32]
    context: NDArray[np.uint32]
    arguments: NDArray[np.uint32]
    pulse: NDArray[np.int64]
    """(8,) of the eight, and which of its sub-rays (`sample`)."""
    sample: NDArray[np.int64]


@numba.njit(cache=True, nogil=True)
def _packet() -> _Packet:
    """Make an empty packet."""
    rays = _aligned(_ROWS * PACKET * 4).view(np.float32).reshape(_ROWS, PACKET)
    context = _aligned(16).view(np.uint32)
    return _Packet(
        rays,
        rays.view(np.uint32),
        _aligned(PACKET * 4).view(np.int32),
        context,
        _arguments(context),
        np.zeros(PACKET, np.int64),
        np.zeros(PACKET, np.int64),
    )


@numba.njit(cache=True, nogil=True)
def cast_sub_rays(
    target: Target,
    light: Light,
    wish: Wish,
    middle: tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]],
    count: NDArray[np.uint16],
) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]:
    """Cast the sub-rays of every pulse, by rounds.

    Parameters
    ----------
    middle : ranges, surfaces and cosines (k, L) of the rays along the middles, where they are the first sub-rays
    count : (k, L) output, sub-rays of each pulse; n in all

    Returns
    -------
    Ranges, surfaces and cosines (n,) in order of pulses.
    """
    packet, shape, n = _packet(), (PACKET, wish.first.shape[1], wish.most), 0
    eight = _hits(shape)
    axes, shift = np.empty((PACKET, 12)), np.empty((PACKET, 2), np.uint32)
    done, order = np.empty(shape[:2], np.int64), np.empty((2, wish.most))
    room, begin = _hits(wish.first.size * wish.most), np.empty(len(light.order), np.int64)
    for first in light.order:
        done[:] = 0
        if wish.by_rounds:
            eight.range_m[:, :, 0] = middle[0][first : first + PACKET]
            eight.surface[:, :, 0] = middle[1][first : first + PACKET]
            eight.cos_incidence[:, :, 0] = middle[2][first : first + PACKET]
            done[:] = (eight.surface[:, :, 0] != _NONE) | (light.judged_m >= light.far_m)
        for j in range(shape[1]):
            _cast_eight(target, light, wish, packet, first, j, axes, shift, order, eight, done)
        begin[first // PACKET] = n
        n = _put_down(eight, done, first, count, room, n)
    out = _hits(n)
    _put_in_order(room, begin, count, out)
    return out.range_m, out.surface, out.cos_incidence


@numba.njit(cache=True, nogil=True, _nrt=False)
def _put_down(
    eight: _Hits, done: NDArray[np.int64], first: int, count: NDArray[np.uint16], room: _Hits, n: int
) -> int:
    """Put the hits of eight sequences into the order of pulses, from number n on; gives the next number."""
    range_m, surface, cos_incidence = room.range_m, room.surface, room.cos_incidence
    from_range_m, from_surface, from_cos_incidence = eight.range_m, eight.surface, eight.cos_incidence
    for r in range(done.shape[0]):
        for j in range(done.shape[1]):
            have = count[first + r, j] = done[r, j]
            for s in range(have):
                range_m[n + s], surface[n + s] = from_range_m[r, j, s], from_surface[r, j, s]
                cos_incidence[n + s] = from_cos_incidence[r, j, s]
            n += have
    return n


@numba.njit(cache=True, nogil=True, _nrt=False)
def _put_in_order(room: _Hits, begin: NDArray[np.int64], count: NDArray[np.uint16], out: _Hits) -> None:
    """Put hits into the order of sequences; those of each eight begin at a number of their own."""
    range_m, surface, cos_incidence = out.range_m, out.surface, out.cos_incidence
    from_range_m, from_surface, from_cos_incidence = room.range_m, room.surface, room.cos_incidence
    n = 0
    for eight in range(begin.shape[0]):
        have = count[eight * PACKET : (eight + 1) * PACKET].sum()
        for s in range(begin[eight], begin[eight] + have):
            range_m[n], surface[n] = from_range_m[s], from_surface[s]
            cos_incidence[n] = from_cos_incidence[s]
            n += 1


@numba.njit(cache=True, nogil=True)
def _cast_eight(
    target: Target,
    light: Light,
    wish: Wish,
    packet: _Packet,
    first: int,
    j: int,
    axes: NDArray[np.float64],
    shift: NDArray[np.uint32],
    order: NDArray[np.float64],
    hits: _Hits,
    done: NDArray[np.int64],
) -> None:
    """Cast what eight consecutive pulses of laser j want."""
    wanted = np.empty(PACKET, np.int64)
    for r in range(PACKET):
        wanted[r] = wish.first[first + r, j]
        if wanted[r] > done[r, j]:
            pulse_axes(light.origin_m, light.direction, light.across, first + r, j, axes, r)
            for a in range(3):
                axes[r, a] -= target.window_origin_m[a]
            shift[r, 0], shift[r, 1] = turn(light.seed, light.first + first + r, j)
    open_ = True
    while open_:
        _cast_round(target, light, wish.by_rounds, packet, first, j, axes, shift, done, wanted, hits)
        open_ = False
        for r in range(PACKET):
            asked, s = wanted[r] - done[r, j], wanted[r]
            done[r, j] = s
            if (
                asked
                and s < wish.most
                and not enough(
                    hits.range_m[r, j, :s],
                    hits.surface[r, j, :s],
                    hits.cos_incidence[r, j, :s],
                    target.reflectance,
                    wish.target_m,
                    wish.resolution_m,
                    order,
                )
            ):
                wanted[r] = min(s + ROUND, wish.most)
                open_ = True


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_round(
    target: Target,
    light: Light,
    by_rounds: bool,
    packet: _Packet,
    first: int,
    j: int,
    axes: NDArray[np.float64],
    shift: NDArray[np.uint32],
    done: NDArray[np.int64],
    wanted: NDArray[np.int64],
    hits: _Hits,
) -> None:
    """Cast sub-rays `done` to `wanted` of eight pulses. Packets of rounds hold one pulse each: that is 3 to 6 % quicker."""
    rays, words, pulse, sample = packet.rays, packet.words, packet.pulse, packet.sample
    quarters, time, lane = light.quarters, light.time, 0
    for r in range(PACKET):
        for s in range(done[r, j], wanted[r]):
            x_m, y_m, z_m, x, y, z = sub_ray(axes, r, quarters, shift[r, 0], shift[r, 1], s, by_rounds)
            rays[_ORG, lane], rays[_ORG + 1, lane], rays[_ORG + 2, lane] = x_m, y_m, z_m
            rays[_DIR, lane], rays[_DIR + 1, lane], rays[_DIR + 2, lane] = x, y, z
            near_m = light.judged_m if by_rounds and s == 0 else light.near_m[j]
            _reset(rays, words, lane, near_m, light.far_m, time[first + r, j])
            pulse[lane], sample[lane] = r, s
            lane += 1
            if lane == PACKET or (by_rounds and s + 1 == wanted[r]):
                _shoot(target, packet, lane, j, hits)
                lane = 0
    if lane:
        _shoot(target, packet, lane, j, hits)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _shoot(target: Target, packet: _Packet, lanes: int, j: int, hits: _Hits) -> None:
    """Cast the first rays of a packet and put down what each met."""
    rays, words, valid = packet.rays, packet.words, packet.valid
    for lane in range(PACKET):
        valid[lane] = -1 if lane < lanes else 0
    packet.context[:] = _NONE
    _intersect(valid.ctypes.data, target.scene, rays.ctypes.data, packet.arguments.ctypes.data)
    pulse, sample = packet.pulse, packet.sample
    first_surface, normal_matrix, shear = target.first_surface, target.normal_matrix, target.shear
    range_m, surface, cos_incidence = hits.range_m, hits.surface, hits.cos_incidence
    for lane in range(lanes):
        r, s, instance = pulse[lane], sample[lane], words[_INST, lane]
        if instance == _NONE:
            range_m[r, j, s], surface[r, j, s], cos_incidence[r, j, s] = np.inf, _NONE, 0.0
        else:
            range_m[r, j, s] = rays[_TFAR, lane]
            surface[r, j, s] = first_surface[instance] + words[_GEOM, lane]
            cos_incidence[r, j, s] = _cosine(normal_matrix, shear, instance, rays, lane)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _lay(
    lines: NDArray[np.float32],
    first: int,
    origin_m: NDArray[np.float64],
    window_origin_m: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> None:
    """Bring the rays of eight sequences into the order of packets, (L, 6, 8): read in one go, as memory likes it."""
    for r in range(PACKET):
        for j in range(origin_m.shape[1]):
            for a in range(3):
                lines[j, a, r] = np.float32(origin_m[first + r, j, a] - window_origin_m[a])
                lines[j, 3 + a, r] = np.float32(direction[first + r, j, a])


@numba.njit(cache=True, nogil=True, _nrt=False)
def _reset(
    rays: NDArray[np.float32], words: NDArray[np.uint32], r: int, near_m: float, far_m: float, time: float
) -> None:
    """Give ray r its limits and its time, and take away what it hit before."""
    rays[_TNEAR, r], rays[_TIME, r], rays[_TFAR, r] = near_m, time, far_m
    words[_MASK, r], words[_ID, r], words[_FLAGS, r] = _NONE, r, 0
    words[_GEOM, r], words[_INST, r] = _NONE, _NONE


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
        dot += turned * rays[_DIR + a, r]
        square += turned * turned
    return np.float32(min(abs(float(dot)) / math.sqrt(square), 1.0)) if square > 0.0 else np.float32(0.0)
