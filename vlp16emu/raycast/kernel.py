"""The inner loop: sub-rays of a pulse as one packet of eight through what is near, those that miss on into what is far.

Which rays share a packet depends on firing numbers and on what was met, never on threads. What makes no arrays counts no
references (`_nrt=False`), and loops take arrays out of tuples first: a twentieth of the time.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.adaptive import enough, flat_enough
from vlp16emu.raycast.beam import ROUND, lay, pulse_axes, turn
from vlp16emu.raycast.grid import Medium
from vlp16emu.raycast.march import march
from vlp16emu.raycast.packet import (
    DIR,
    INST,
    NONE,
    ORG,
    PACKET,
    RayPacket,
    Target,
    cast_beyond,
    cast_packet,
    ray_met,
    ray_packet,
    reset,
    to_lane,
)

__all__ = ["Light", "Wish", "cast_lines", "cast_pulses"]

_BEND = 2.0
"""Times the target that a smooth surface may bend over three pulses: within the light of one of them it bends by a
thirtieth of that."""
_STEPS = 2.5
"""Times the beam's divergence that neighbours may be apart in order to say something: the VLP-16 at 1200 rpm is at 2.3."""
_OVERLAP, _MIDWAY_M = 0.3, 10.0
"""Share of the beam's width by which neighbours must at least be apart, at this range: nearer ones meet the same."""


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
    packet = ray_packet()
    for first in light.order:
        _cast_eight_lines(near, beyond, medium, light, packet, first, range_m, surface, cos_incidence)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_eight_lines(
    near: Target,
    beyond: Target,
    medium: Medium,
    light: Light,
    packet: RayPacket,
    first: int,
    range_m: NDArray[np.float32],
    surface: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
) -> None:
    """Cast one ray for each pulse of eight sequences."""
    rays, words, valid, axis = packet.rays, packet.words, packet.valid, packet.axes
    reach_m = min(light.far_m, medium.near_m)
    L, flat = packet.lanes, packet.line
    for j in range(light.origin_m.shape[1]):
        _cast_near(near, light, packet, first, j, reach_m)
        missed = 0
        for r in range(PACKET):
            i = first + r
            if words[INST, r] == NONE:
                range_m[i, j], surface[i, j], cos_incidence[i, j] = np.inf, NONE, 0.0
                missed += 1
                valid[r] = -1
            else:
                range_m[i, j], surface[i, j], cos_incidence[i, j] = ray_met(near, packet, r)
                valid[r] = 0
        if not missed or reach_m >= light.far_m:
            continue
        if beyond.scene:
            cast_beyond(beyond, packet, reach_m, light.far_m)
        for r in range(PACKET):
            if not valid[r]:
                continue
            i = first + r
            to_lane(packet, beyond, r, 0, light.far_m)
            for a in range(3):
                axis[0, a], axis[1, a] = rays[ORG + a, r], rays[DIR + a, r]
            march(medium, L, 1, flat)
            if L.surface[0] != NONE:
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
    packet, n = ray_packet(), 0
    pulse, room = _hits(-(-wish.most // ROUND) * ROUND), _hits(count.size * wish.most)
    scratch, begin = np.empty((2, wish.most + ROUND)), np.empty(count.shape, np.int64)
    for first in light.order:
        n = _cast_eight(
            near, beyond, medium, light, wish, packet, first, pulse, scratch, count, begin, room, n
        )
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
    packet: RayPacket,
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
                clear = met[m - 1] == NONE and met[m] == NONE and met[m + 1] == NONE and met[r] == NONE
                bend_m = abs(middle[0, m - 1] + middle[0, m + 1] - np.float32(2.0) * middle[0, m])
                if bend_m <= _BEND * wish.target_m and flat_enough(
                    light.quarters, middle[0, r], middle[1, r], wish.resolution_m
                ):
                    pulse.range_m[0], pulse.cos_incidence[0], have = middle[0, r], middle[1, r], 1
                    pulse.surface[0] = packet.middle_surface[r]
            if not have:
                have = _cast_pulse(near, beyond, medium, light, wish, packet, i, j, pulse, scratch, clear)
            count[i, j], begin[i, j] = have, n
            _copy(pulse, 0, room, n, have)
            n += have
    return n


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_middles(near: Target, medium: Medium, light: Light, packet: RayPacket, first: int, j: int) -> bool:
    """Cast the middles of eight pulses of a laser near by; whether they are so near each other that they say something."""
    words, middle, direction = packet.words, packet.middle, light.direction
    step2 = gap2_m2 = 0.0
    for a in range(3):
        step = direction[first + 1, j, a] - direction[first, j, a]
        gap_m = light.origin_m[first + 1, j, a] - light.origin_m[first, j, a] + _MIDWAY_M * step
        step2, gap2_m2 = step2 + step * step, gap2_m2 + gap_m * gap_m
    reach_m = min(light.far_m, medium.near_m)
    width_m = 4.0 * (light.quarters[0] + _MIDWAY_M * light.quarters[2])
    if step2 > (_STEPS * 4.0 * light.quarters[2]) ** 2 or gap2_m2 < (_OVERLAP * width_m) ** 2:
        return False
    _cast_near(near, light, packet, first, j, reach_m)
    for r in range(PACKET):
        middle[0, r], middle[1, r], packet.middle_surface[r] = np.float32(np.inf), np.float32(0.0), NONE
        if words[INST, r] != NONE:
            middle[0, r], packet.middle_surface[r], middle[1, r] = ray_met(near, packet, r)
    return True


@numba.njit(cache=True, nogil=True, _nrt=False, inline="always")
def _cast_near(near: Target, light: Light, packet: RayPacket, first: int, j: int, reach_m: float) -> None:
    """Cast the middles of a laser's pulses of eight sequences, up to a range."""
    rays, valid = packet.rays, packet.valid
    origin_m, direction, from_m = light.origin_m, light.direction, near.window_origin_m
    valid[:] = -1
    for r in range(PACKET):
        i = first + r
        for a in range(3):
            rays[ORG + a, r] = np.float32(origin_m[i, j, a] - from_m[a])
            rays[DIR + a, r] = np.float32(direction[i, j, a])
        reset(packet, r, light.near_m[j], reach_m, light.time[i, j])
    cast_packet(near, packet)


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
    packet: RayPacket,
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
        _cast_round(
            near,
            beyond,
            medium,
            packet,
            light.near_m[j],
            light.far_m,
            light.time[i, j],
            count,
            have,
            hits,
            clear,
        )
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
    packet: RayPacket,
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
        reset(packet, lane, near_m, reach_m, time)
        valid[lane] = -1 if lane < count else 0
    if not clear:
        cast_packet(near, packet)
    missed = 0
    for lane in range(count):
        if words[INST, lane] == NONE:
            range_m[at + lane], surface[at + lane], cos_incidence[at + lane] = np.inf, NONE, 0.0
            who[missed] = lane
            missed += 1
        else:
            range_m[at + lane], surface[at + lane], cos_incidence[at + lane] = ray_met(near, packet, lane)
            valid[lane] = 0
    if not missed or reach_m >= far_m:
        return
    if beyond.scene:
        cast_beyond(beyond, packet, reach_m, far_m)
    for n in range(missed):
        to_lane(packet, beyond, who[n], n, far_m)
    march(medium, L, missed, packet.line)
    for n in range(missed):
        if L.surface[n] != NONE:
            range_m[at + who[n]], surface[at + who[n]] = L.range_m[n], L.surface[n]
            cos_incidence[at + who[n]] = L.cosine[n]
