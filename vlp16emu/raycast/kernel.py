"""The inner loop: sub-rays of a pulse as one packet of eight through what is near, and those that miss on into what is far.

Eight sequences are cast at a time, step by step: all their pulses through the faces that are near, then those that are
left through what is far, so that the memory of one does not drive out that of the other. Which rays share a packet depends
on firing numbers and on what was met, never on threads. What makes no arrays counts no references (`_nrt=False`), and
loops take arrays out of tuples first: a twentieth of the time.
"""

from typing import Any

import numba
import numpy as np

from vlp16emu.raycast.adaptive import RayBudget, enough
from vlp16emu.raycast.batch import COSINE, DIRECTION, LANES, ORIGIN, RANGE, Batch, MetRays, PulseBatch
from vlp16emu.raycast.beam import ROUND, lay, pulse_axes, reach_of, turn
from vlp16emu.raycast.packet import DIR, NONE, ORG, PACKET, TIME, RayPacket, Target, cast_packet, ray_met, set_filter
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, I8, U2, U4

_USUAL = 10
"""Sub-rays of a pulse, for which there is room at first; memory of this size is used again and needs no clearing."""


@numba.njit(cache=True, nogil=True)
def _hits(n: int) -> MetRays:
    return MetRays(np.empty(n, np.float32), np.empty(n, np.uint32), np.empty(n, np.float32))


def go_on(passage: Any, light: PulseBatch, batch: Batch, todo: int, count: int, reach: np.float32) -> None:
    """Let the rays of pulses that have met nothing near go on through what is far.

    Whoever has something far says how, by `numba.extending.overload`: casting what is near needs none of it.

    Parameters
    ----------
    reach : how far from the middle they are at most, in standard deviations of the beam
    """
    raise NotImplementedError


@numba.njit(cache=True, nogil=True)
def cast_lines(
    near: Target,
    beyond: Target | None,
    passage: Any,
    light: PulseBatch,
    packet: RayPacket,
    batch: Batch,
    range_m: F4,
    surface: U4,
    cos_incidence: F4,
) -> None:
    """Cast one ray per pulse; packets hold eight consecutive firings of a laser. Fills arrays (k, L).

    Where nothing is far, `beyond` and `passage` are None, and numba leaves out what is for them.
    """
    pulses, one = PACKET * light.origin_m.shape[1], ZERO + 1
    set_filter(packet)
    for first in light.order:
        _cast_middles(near, beyond, light, packet, batch, first)
        if passage is not None:
            go_on(passage, light, batch, pulses, one, np.float32(0.0))
        for q in range(pulses):
            i, j, met = first + q % PACKET, q // PACKET, batch.surface[q, 0]
            range_m[i, j] = np.float32(np.inf) if met == NONE else batch.row[q, RANGE]
            surface[i, j], cos_incidence[i, j] = met, batch.row[q, COSINE]


@numba.njit(cache=True, nogil=True)
def cast_pulses(
    near: Target,
    beyond: Target | None,
    passage: Any,
    light: PulseBatch,
    packet: RayPacket,
    batch: Batch,
    budget: RayBudget,
    count: U2,
) -> tuple[F4, U4, F4]:
    """Cast the sub-rays of every pulse, by rounds of eight.

    Parameters
    ----------
    count : (k, L) output, sub-rays of each pulse; n in all

    Returns
    -------
    Ranges, surfaces and cosines (n,) in order of pulses.
    """
    n, pulses = ZERO, PACKET * count.shape[1]
    set_filter(packet)
    room, begin = _hits(count.size * _USUAL), np.empty(count.shape[0] // PACKET, np.int64)
    for first in light.order:
        todo, have = pulses, ZERO
        for q in range(pulses):
            batch.todo[q] = q
        while todo:
            rays = min(ROUND, budget.most - have)
            _cast_near(near, beyond, light, budget, packet, batch, first, todo, have, rays)
            if passage is not None:
                go_on(passage, light, batch, todo, rays, reach_of(have, budget.adaptive))
            todo, have = _settle(near, budget, batch, todo, have, rays), have + rays
        need = n + ROUND
        for q in range(pulses):
            need += batch.have[q]
        if need > room.range_m.size:
            longer = _hits(max(2 * room.range_m.size, need))
            _copy(room, ZERO, longer, ZERO, n)
            room = longer
        begin[first // PACKET] = n
        n = _take(batch, first, count, room, n)
    hits = _hits(n)
    _put_in_order(room, begin, count, hits)
    return hits.range_m, hits.surface, hits.cos_incidence


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_middles(
    near: Target, beyond: Target | None, light: PulseBatch, packet: RayPacket, batch: Batch, first: int
) -> None:
    """Cast the middles of the pulses of eight sequences against faces, those of a laser as one packet."""
    rays = packet.rays
    origin_m, direction, from_m = light.origin_m, light.direction, near.window_origin_m
    reach_m = light.reach_m
    for j in range(origin_m.shape[1]):
        for r in range(PACKET):
            i = first + r
            for a in range(3):
                rays[ORG + PACKET * a + r] = np.float32(origin_m[i, j, a] - from_m[a])
                rays[DIR + PACKET * a + r] = np.float32(direction[i, j, a])
                if beyond is not None:
                    batch.axes[PACKET * j + r, 0, a] = rays[ORG + PACKET * a + r]
                    batch.axes[PACKET * j + r, 1, a] = rays[DIR + PACKET * a + r]
            rays[TIME + r] = light.time[i, j]
        packet.valid[:] = -1
        cast_packet(near, packet, light.near_m[j], reach_m)
        _put_down(near, beyond, packet, batch, PACKET * j, ZERO + 1, ZERO + PACKET, reach_m, light.far_m)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_near(
    near: Target,
    beyond: Target | None,
    light: PulseBatch,
    budget: RayBudget,
    packet: RayPacket,
    batch: Batch,
    first: int,
    todo: int,
    have: int,
    count: int,
) -> None:
    """Cast the next sub-rays of pulses, which have some already, against faces, those of a pulse as one packet."""
    valid, reach_m = packet.valid, light.reach_m
    for t in range(todo):
        q = batch.todo[t]
        i, j, axes = first + q % PACKET, q // PACKET, batch.axes[q]
        if not have:
            pulse_axes(light.origin_m, light.direction, light.beam_axis, near.window_origin_m, i, j, axes)
        u, v = turn(light.seed, light.first + i, j)
        lay(packet.rays, axes, light.sigmas, u, v, have, budget.adaptive)
        for r in range(PACKET):
            packet.rays[TIME + r] = light.time[i, j]
            valid[r] = -1 if r < count else 0
        cast_packet(near, packet, light.near_m[j], reach_m)
        _put_down(near, beyond, packet, batch, q, ZERO, count, reach_m, light.far_m)


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _put_down(
    near: Target,
    beyond: Target | None,
    packet: RayPacket,
    batch: Batch,
    q: int,
    step: int,
    count: int,
    reach_m: float,
    far_m: float,
) -> None:
    """Put down what rays have met, of pulse q all (step 0) or one of each pulse from q on (step 1); cast what is left on."""
    instance, valid, row, surface = packet.instance, packet.valid, batch.row, batch.surface
    missed = 0
    for r in range(count):
        to, lane = q + step * r, (1 - step) * r
        if instance[r] == NONE:
            row[to, RANGE + lane], surface[to, lane], row[to, COSINE + lane] = np.float32(far_m), NONE, 0.0
            missed += 1
        else:
            row[to, RANGE + lane], surface[to, lane], row[to, COSINE + lane] = ray_met(near, packet, r)
        valid[r] = -1 if instance[r] == NONE else 0
        batch.missed[to] = missed > 0 if step == 0 else instance[r] == NONE
    if beyond is not None and missed:
        _send_on(beyond, packet, batch, q, step, count, reach_m, far_m)


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _send_on(
    beyond: Target, packet: RayPacket, batch: Batch, q: int, step: int, count: int, reach_m: float, far_m: float
) -> None:
    """Give the rays that go on to the medium, and cast them against what is cast as faces at any range."""
    own, instance, valid, row, surface = packet.own, packet.instance, packet.valid, batch.row, batch.surface
    if step == 0:
        for at in range(3 * LANES):
            row[q, ORIGIN + at], row[q, DIRECTION + at] = own[ORG + at], own[DIR + at]
    else:
        for r in range(count):
            if valid[r]:
                for a in range(3):
                    row[q + r, ORIGIN + LANES * a] = own[ORG + PACKET * a + r]
                    row[q + r, DIRECTION + LANES * a] = own[DIR + PACKET * a + r]
    if not beyond.scene:
        return
    cast_packet(beyond, packet, reach_m, far_m)
    for r in range(count):
        if valid[r] and instance[r] != NONE:
            to, lane = q + step * r, (1 - step) * r
            row[to, RANGE + lane], surface[to, lane], row[to, COSINE + lane] = ray_met(beyond, packet, r)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _settle(near: Target, budget: RayBudget, batch: Batch, todo: int, have: int, count: int) -> int:
    """Take the hits of a round; list the pulses that need another, and return how many."""
    hits, row, met, left = batch.hits, batch.row, batch.surface, 0
    range_m, surface, cosine = hits.range_m, hits.surface, hits.cos_incidence
    most, own = batch.scratch.shape[1], have + count
    for t in range(todo):
        q = batch.todo[t]
        begin, at = q * most, q * most + have
        for lane in range(LANES):
            range_m[at + lane] = np.float32(np.inf) if met[q, lane] == NONE else row[q, RANGE + lane]
            surface[at + lane], cosine[at + lane] = met[q, lane], row[q, COSINE + lane]
        batch.have[q] = own
        if own < budget.most and not (
            budget.adaptive
            and enough(
                range_m[begin : begin + own],
                surface[begin : begin + own],
                cosine[begin : begin + own],
                near.reflectance,
                budget,
                batch.scratch,
            )
        ):
            batch.todo[left] = q
            left += 1
    return left


@numba.njit(cache=True, nogil=True, _nrt=False)
def _take(batch: Batch, first: int, count: U2, room: MetRays, n: int) -> int:
    """Count the hits of eight sequences and append them to n others, in order of pulses; return how many there are then."""
    most = batch.scratch.shape[1]
    for i in range(PACKET):
        for j in range(count.shape[1]):
            q = PACKET * j + i
            count[first + i, j] = batch.have[q]
            for have in range(0, batch.have[q], ROUND):  # a round, also where the last has less
                _copy(batch.hits, q * most + have, room, n + have, ROUND)
            n += batch.have[q]
    return n


@numba.njit(cache=True, nogil=True, _nrt=False)
def _put_in_order(room: MetRays, begin: I8, count: U2, hits: MetRays) -> None:
    """Put hits into the order of pulses; those of each eight sequences begin at a place of their own."""
    n = ZERO
    for group in range(begin.size):
        own = ZERO
        for i in range(PACKET):
            for j in range(count.shape[1]):
                own += count[PACKET * group + i, j]
        _copy(room, begin[group], hits, n, own)
        n += own


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _copy(source: MetRays, begin: int, target: MetRays, at: int, count: int) -> None:
    for s in range(count):
        target.range_m[at + s] = source.range_m[begin + s]
    for s in range(count):
        target.surface[at + s] = source.surface[begin + s]
    for s in range(count):
        target.cos_incidence[at + s] = source.cos_incidence[begin + s]
