"""The inner loop: sub-rays of a pulse as one packet of eight through what is near, those that miss on into what is far.

Which rays share a packet depends on firing numbers and on what was met, never on threads. What makes no arrays counts no
references (`_nrt=False`), and loops take arrays out of tuples first: a twentieth of the time.
"""

import math
from typing import NamedTuple

import llvmlite.binding
import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from vlp16emu.raycast.adaptive import enough, flat_enough
from vlp16emu.raycast.beam import ROUND, lay, pulse_axes, turn
from vlp16emu.raycast.build import tilt
from vlp16emu.raycast.embree import FLAG_COHERENT, library, library_path
from vlp16emu.raycast.march import Lanes, Medium, lanes, march

__all__ = ["PACKET", "Light", "Target", "Wish", "cast_lines", "cast_pulses"]

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
_BEND = 2.0
"""Times the target that a smooth surface may bend over three pulses: within the light of one of them it bends by a
thirtieth of that."""
_STEPS = 2.5
"""Times the beam's divergence that neighbours may be apart in order to say something: the VLP-16 at 1200 rpm is at 2.3."""


class Target(NamedTuple):
    """What is cast against as faces."""

    scene: int
    """Address of a committed RTCScene of instances; 0 where there is nothing."""
    window_origin_m: NDArray[np.float64]
    """(3,) taken from the origins in float64, before the step to float32."""
    first_surface: NDArray[np.uint32]
    """(n,) per instance, as in `Window`."""
    normal_matrix: NDArray[np.float32]
    """(n, 3, 3) per instance, as in `geometry`."""
    shear: NDArray[np.float32]
    """(knots, n, 2) per instance, as in `build.Motion`."""
    reflectance: NDArray[np.float32]
    """(m,) of the surfaces."""


class Light(NamedTuple):
    """What is cast: the pulses of a batch, and how wide they are."""

    origin_m: NDArray[np.float64]
    """(k, L, 3), k a multiple of `PACKET`; `direction` and `across` alike, the latter empty for light without width."""
    direction: NDArray[np.float64]
    across: NDArray[np.float64]
    time: NDArray[np.float32]
    """(k, L) between the scene's first knot and its last, 0..1."""
    near_m: NDArray[np.float64]
    """(L,) where each laser's light begins."""
    far_m: float
    """Where it is given up."""
    order: NDArray[np.int64]
    """(k / 8,) first sequence of each packet, in the order of casting."""
    quarters: NDArray[np.float32]
    """(4,) as in `Footprint`; `seed` alike."""
    seed: int
    first: int
    """Number of the first firing sequence."""


class Wish(NamedTuple):
    """How many sub-rays are wanted."""

    most: int
    """Of a pulse."""
    adaptive: bool
    """Whether `adaptive.enough` is asked after each round if there must be more."""
    target_m: float
    resolution_m: float


class _Hits(NamedTuple):
    """Hits of eight sequences, or of a batch: three arrays of one shape."""

    range_m: NDArray[np.float32]
    surface: NDArray[np.uint32]
    cos_incidence: NDArray[np.float32]


class _Packet(NamedTuple):
    """A thread's own packet, and room for what goes on into the medium."""

    rays: NDArray[np.float32]
    words: NDArray[np.uint32]
    valid: NDArray[np.int32]
    context: NDArray[np.uint32]
    arguments: NDArray[np.uint32]
    lanes: Lanes
    axes: NDArray[np.float32]
    """(4, 3) of the pulse."""
    line: NDArray[np.float32]
    """(6,) the first two of them."""
    who: NDArray[np.int64]
    """(8,) which ray of the packet each lane is."""
    middle: NDArray[np.float32]
    """(2, 8) range and cosine of what the middles of eight pulses met near by, and the surface."""
    middle_surface: NDArray[np.uint32]


@numba.njit(cache=True, nogil=True)
def _aligned(bytes_: int) -> NDArray[np.uint8]:
    """Memory that starts at a multiple of 64 bytes."""
    raw = np.zeros(bytes_ + _ALIGN, np.uint8)
    return raw[(-raw.ctypes.data) % _ALIGN :][:bytes_]


@numba.njit(cache=True, nogil=True)
def _packet() -> _Packet:
    """Make an empty packet.

    RTCIntersectArguments: flags, feature mask (all), then pointers to context, no filter, no callback. Each thread needs
    its own context: a shared one loses hits on instances silently.
    """
    rays = _aligned(_ROWS * PACKET * 4).view(np.float32).reshape(_ROWS, PACKET)
    context, arguments = _aligned(16).view(np.uint32), _aligned(64).view(np.uint32)
    arguments[0], arguments[1] = FLAG_COHERENT, _NONE
    address = np.uint64(context.ctypes.data)
    arguments[2], arguments[3] = np.uint32(address & np.uint64(0xFFFFFFFF)), np.uint32(address >> np.uint64(32))
    words, axes = rays.view(np.uint32), np.zeros((4, 3), np.float32)
    for lane in range(PACKET):
        words[_MASK, lane], words[_ID, lane], words[_FLAGS, lane] = _NONE, lane, 0
    return _Packet(
        rays,
        words,
        _aligned(PACKET * 4).view(np.int32),
        context,
        arguments,
        lanes(),
        axes,
        axes.reshape(12),
        np.zeros(PACKET, np.int64),
        np.zeros((2, PACKET), np.float32),
        np.zeros(PACKET, np.uint32),
    )


@numba.njit(cache=True, nogil=True)
def _hits(shape: int | tuple[int, ...]) -> _Hits:
    """Make room for hits."""
    return _Hits(np.empty(shape, np.float32), np.empty(shape, np.uint32), np.empty(shape, np.float32))


@numba.njit(cache=True, nogil=True)
def cast_lines(
    near: Target,
    beyond: Target,
    medium: Medium,
    light: Light,
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
) -> None:
    """Cast one ray per pulse; packets hold eight consecutive firings of a laser. Fills arrays (k, L)."""
    packet = _packet()
    for first in light.order:
        _cast_eight_lines(near, beyond, medium, light, packet, first, range_m, surface, cos_incidence)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_eight_lines(
    near: Target,
    beyond: Target,
    medium: Medium,
    light: Light,
    packet: _Packet,
    first: int,
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
) -> None:
    """Cast one ray for each pulse of eight sequences."""
    rays, words, valid, context = packet.rays, packet.words, packet.valid, packet.context
    origin_m, direction, from_m, axis = light.origin_m, light.direction, near.window_origin_m, packet.axes
    reach_m = min(light.far_m, medium.near_m)
    L, flat = packet.lanes, packet.line
    for j in range(origin_m.shape[1]):
        valid[:] = -1
        for r in range(PACKET):
            i = first + r
            for a in range(3):
                rays[_ORG + a, r] = np.float32(origin_m[i, j, a] - from_m[a])
                rays[_DIR + a, r] = np.float32(direction[i, j, a])
            _reset(packet, r, light.near_m[j], reach_m, light.time[i, j])
        context[:] = _NONE
        _intersect(valid.ctypes.data, near.scene, rays.ctypes.data, packet.arguments.ctypes.data)
        missed = 0
        for r in range(PACKET):
            i = first + r
            if words[_INST, r] == _NONE:
                range_m[i, j], surface[i, j], cos_incidence[i, j] = np.inf, _NONE, 0.0
                missed += 1
                valid[r] = -1
            else:
                range_m[i, j], surface[i, j], cos_incidence[i, j] = _met(near, packet, r)
                valid[r] = 0
        if not missed or reach_m >= light.far_m:
            continue
        if beyond.scene:
            _intersect_beyond(beyond, packet, reach_m, light.far_m)
        for r in range(PACKET):
            if not valid[r]:
                continue
            i = first + r
            _lane(packet, beyond, r, 0, light.far_m)
            for a in range(3):
                axis[0, a], axis[1, a] = rays[_ORG + a, r], rays[_DIR + a, r]
            march(medium, L, 1, flat)
            if L.surface[0] != _NONE:
                range_m[i, j], surface[i, j], cos_incidence[i, j] = L.range_m[0], L.surface[0], L.cosine[0]


@numba.njit(cache=True, nogil=True)
def cast_pulses(
    near: Target, beyond: Target, medium: Medium, light: Light, wish: Wish, count: NDArray[np.uint16]
) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]:
    """Cast the sub-rays of every pulse, by rounds of eight.

    Parameters
    ----------
    count : (k, L) output, sub-rays of each pulse; n in all

    Returns
    -------
    Ranges, surfaces and cosines (n,) in order of pulses.
    """
    packet, n = _packet(), 0
    pulse, room = _hits(-(-wish.most // ROUND) * ROUND), _hits(count.size * wish.most)
    scratch, begin = np.empty((2, wish.most + ROUND)), np.empty(count.shape, np.int64)
    for first in light.order:
        n = _cast_eight(near, beyond, medium, light, wish, packet, first, pulse, scratch, count, begin, room, n)
    out = _hits(n)
    _put_in_order(room, begin, count, out)
    return out.range_m, out.surface, out.cos_incidence


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_eight(
    near: Target,
    beyond: Target,
    medium: Medium,
    light: Light,
    wish: Wish,
    packet: _Packet,
    first: int,
    pulse: _Hits,
    scratch: NDArray[np.float64],
    count: NDArray[np.uint16],
    begin: NDArray[np.int64],
    room: _Hits,
    n: int,
) -> int:
    """Cast eight sequences, laser by laser, and put down what they meet from number n on; return the next number.

    Of an adaptive beam the rays along the middles of the eight pulses of a laser, which are neighbours, are cast near by
    first: where those of a pulse and of its neighbours meet nothing, no sub-ray is cast near by, and where they lie on one
    smooth surface the one ray is enough.
    """
    for j in range(count.shape[1]):
        judged = wish.adaptive and _cast_middles(near, medium, light, packet, first, j)
        for r in range(PACKET):
            i, have, clear = first + r, 0, False
            if judged:
                m = min(max(r, 1), PACKET - 2)
                middle = packet.middle
                met = packet.middle_surface
                clear = met[m - 1] == _NONE and met[m] == _NONE and met[m + 1] == _NONE and met[r] == _NONE
                bend_m = abs(middle[0, m - 1] + middle[0, m + 1] - np.float32(2.0) * middle[0, m])
                if bend_m <= _BEND * wish.target_m and flat_enough(light.quarters, middle[0, r], middle[1, r], wish.resolution_m):
                    pulse.range_m[0], pulse.cos_incidence[0], have = middle[0, r], middle[1, r], 1
                    pulse.surface[0] = packet.middle_surface[r]
            if not have:
                have = _cast_pulse(near, beyond, medium, light, wish, packet, i, j, pulse, scratch, clear)
            count[i, j], begin[i, j] = have, n
            _copy(pulse, 0, room, n, have)
            n += have
    return n


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_middles(near: Target, medium: Medium, light: Light, packet: _Packet, first: int, j: int) -> bool:
    """Cast the middles of eight pulses of a laser near by; whether they are so near each other that they say something."""
    rays, words, valid, middle = packet.rays, packet.words, packet.valid, packet.middle
    origin_m, direction, from_m = light.origin_m, light.direction, near.window_origin_m
    step2 = 0.0
    for a in range(3):
        step2 += (direction[first + 1, j, a] - direction[first, j, a]) ** 2
    reach_m = min(light.far_m, medium.near_m)
    if step2 > (_STEPS * 4.0 * light.quarters[2]) ** 2:
        return False
    valid[:] = -1
    for r in range(PACKET):
        for a in range(3):
            rays[_ORG + a, r] = np.float32(origin_m[first + r, j, a] - from_m[a])
            rays[_DIR + a, r] = np.float32(direction[first + r, j, a])
        _reset(packet, r, light.near_m[j], reach_m, light.time[first + r, j])
    packet.context[:] = _NONE
    _intersect(valid.ctypes.data, near.scene, rays.ctypes.data, packet.arguments.ctypes.data)
    for r in range(PACKET):
        middle[0, r], middle[1, r], packet.middle_surface[r] = np.float32(np.inf), np.float32(0.0), _NONE
        if words[_INST, r] != _NONE:
            middle[0, r], packet.middle_surface[r], middle[1, r] = _met(near, packet, r)
    return True


@numba.njit(cache=True, nogil=True, _nrt=False)
def _put_in_order(room: _Hits, begin: NDArray[np.int64], count: NDArray[np.uint16], out: _Hits) -> None:
    """Put hits into the order of pulses; those of each begin at a number of their own."""
    n = 0
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            _copy(room, begin[i, j], out, n, count[i, j])
            n += count[i, j]


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _copy(source: _Hits, begin: int, target: _Hits, at: int, count: int) -> None:
    """Copy hits."""
    range_m, surface, cosine = target.range_m, target.surface, target.cos_incidence
    from_range_m, from_surface, from_cosine = source.range_m, source.surface, source.cos_incidence
    for s in range(count):
        range_m[at + s], surface[at + s] = from_range_m[begin + s], from_surface[begin + s]
        cosine[at + s] = from_cosine[begin + s]


@numba.njit(cache=True, nogil=True, inline="always")
def _cast_pulse(
    near: Target,
    beyond: Target,
    medium: Medium,
    light: Light,
    wish: Wish,
    packet: _Packet,
    i: int,
    j: int,
    hits: _Hits,
    scratch: NDArray[np.float64],
    clear: bool,
) -> int:
    """Cast pulse i, j by rounds; return how many sub-rays it has. What is `clear` meets nothing near by."""
    pulse_axes(light.origin_m, light.direction, light.across, near.window_origin_m, i, j, packet.axes)
    u, v = turn(light.seed, light.first + i, j)
    have = 0
    while have < wish.most:
        lay(packet.rays, packet.axes, light.quarters, u, v, have, wish.adaptive)
        count = min(ROUND, wish.most - have)
        _cast_round(near, beyond, medium, packet, light.near_m[j], light.far_m, light.time[i, j], count, have, hits, clear)
        have += count
        if wish.adaptive and enough(
            hits.range_m[:have],
            hits.surface[:have],
            hits.cos_incidence[:have],
            near.reflectance,
            wish.target_m,
            wish.resolution_m,
            scratch,
        ):
            break
    return have


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _cast_round(
    near: Target,
    beyond: Target,
    medium: Medium,
    packet: _Packet,
    near_m: float,
    far_m: float,
    time: float,
    count: int,
    at: int,
    hits: _Hits,
    clear: bool,
) -> None:
    """Cast the first `count` rays of a packet, which are a pulse's, and put down what they meet from `at` on."""
    words, valid, who, L = packet.words, packet.valid, packet.who, packet.lanes
    range_m, surface, cos_incidence = hits.range_m, hits.surface, hits.cos_incidence
    reach_m = min(far_m, medium.near_m)
    for lane in range(PACKET):
        _reset(packet, lane, near_m, reach_m, time)
        valid[lane] = -1 if lane < count else 0
    if not clear:
        packet.context[:] = _NONE
        _intersect(valid.ctypes.data, near.scene, packet.rays.ctypes.data, packet.arguments.ctypes.data)
    missed = 0
    for lane in range(count):
        if words[_INST, lane] == _NONE:
            range_m[at + lane], surface[at + lane], cos_incidence[at + lane] = np.inf, _NONE, 0.0
            who[missed] = lane
            missed += 1
        else:
            range_m[at + lane], surface[at + lane], cos_incidence[at + lane] = _met(near, packet, lane)
            valid[lane] = 0
    if not missed or reach_m >= far_m:
        return
    if beyond.scene:
        _intersect_beyond(beyond, packet, reach_m, far_m)
    for n in range(missed):
        _lane(packet, beyond, who[n], n, far_m)
    march(medium, L, missed, packet.line)
    for n in range(missed):
        if L.surface[n] != _NONE:
            range_m[at + who[n]], surface[at + who[n]] = L.range_m[n], L.surface[n]
            cos_incidence[at + who[n]] = L.cosine[n]


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _intersect_beyond(beyond: Target, packet: _Packet, reach_m: float, far_m: float) -> None:
    """Cast the rays that are still valid against what is cast as faces at any range."""
    rays, valid = packet.rays, packet.valid
    for lane in range(PACKET):
        if valid[lane]:
            rays[_TNEAR, lane], rays[_TFAR, lane] = reach_m, far_m
    packet.context[:] = _NONE
    _intersect(valid.ctypes.data, beyond.scene, rays.ctypes.data, packet.arguments.ctypes.data)


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _lane(packet: _Packet, beyond: Target, ray: int, lane: int, far_m: float) -> None:
    """Take a ray of the packet, and what it has met beyond, for a lane of the medium."""
    rays, L = packet.rays, packet.lanes
    for a in range(3):
        L.origin_m[a, lane], L.direction[a, lane] = rays[_ORG + a, ray], rays[_DIR + a, ray]
    L.range_m[lane], L.surface[lane], L.cosine[lane] = np.float32(far_m), _NONE, np.float32(0.0)
    if packet.words[_INST, ray] != _NONE:
        L.range_m[lane], L.surface[lane], L.cosine[lane] = _met(beyond, packet, ray)


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _met(target: Target, packet: _Packet, r: int) -> tuple[np.float32, np.uint32, np.float32]:
    """Range, surface and cosine of incidence of what ray r met."""
    instance = packet.words[_INST, r]
    surface = np.uint32(target.first_surface[instance] + packet.words[_GEOM, r])
    return packet.rays[_TFAR, r], surface, _cosine(target.normal_matrix, target.shear, instance, packet.rays, r)


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _reset(packet: _Packet, r: int, near_m: float, far_m: float, time: float) -> None:
    """Give ray r its limits and its time, and take away what it hit before."""
    rays, words = packet.rays, packet.words
    rays[_TNEAR, r], rays[_TIME, r], rays[_TFAR, r] = near_m, time, far_m
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
