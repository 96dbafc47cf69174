"""The inner loop: sub-rays of a pulse as one packet of eight through what is near, and those that miss on into what is far.

Eight sequences are cast at a time, step by step: all their pulses through the faces that are near, then those that are
left through what is far, so that the memory of one does not drive out that of the other. Which rays share a packet depends
on firing numbers and on what was met, never on threads. What makes no arrays counts no references (`_nrt=False`), and
loops take arrays out of tuples first: a twentieth of the time.
"""

from typing import Any, NamedTuple

import numba
import numpy as np

from vlp16emu.raycast.adaptive import RayBudget, enough
from vlp16emu.raycast.batch import COSINE, DIRECTION, LANES, ORIGIN, RANGE, Batch, PulseBatch
from vlp16emu.raycast.beam import ROUND, lay, pulse_axes, reach_of, turn
from vlp16emu.raycast.packet import DIR, NONE, ORG, PACKET, TIME, RayPacket, Target, cast_packet, ray_met, set_filter
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, U2, U4


class Cast(NamedTuple):
    """One thread's cast of a batch of pulses against near faces."""

    near: Target
    light: PulseBatch
    packet: RayPacket
    batch: Batch


def go_on(passage: Any, cast: Cast, todo: int, count: int, reach: np.float32) -> None:
    """Let the rays of pulses that have met nothing near go on through what is far.

    A far medium overloads it by `numba.extending.overload`: casting near faces needs none of it.

    Parameters
    ----------
    reach : how far from the middle they are at most, in standard deviations of the beam
    """
    raise NotImplementedError


@numba.njit(cache=True, nogil=True)
def cast_lines(cast: Cast, beyond: Target | None, passage: Any, range_m: F4, surface: U4, cos_incidence: F4) -> None:
    """Cast one ray per pulse; packets hold eight consecutive firings of a laser. Fill arrays (k, L).

    If nothing is far, `beyond` and `passage` are None, and numba leaves out what is for them.
    """
    batch, pulses, one = cast.batch, PACKET * cast.light.origin_m.shape[1], ZERO + 1
    set_filter(cast.packet)
    for first in cast.light.order:
        _cast_middles(cast, beyond, first)
        if passage is not None:
            go_on(passage, cast, pulses, one, np.float32(0.0))
        for q in range(pulses):
            i, j, met = first + q % PACKET, q // PACKET, batch.surface[q, 0]
            range_m[i, j] = np.float32(np.inf) if met == NONE else batch.row[q, RANGE]
            surface[i, j], cos_incidence[i, j] = met, batch.row[q, COSINE]


@numba.njit(cache=True, nogil=True)
def cast_pulses(cast: Cast, beyond: Target | None, passage: Any, budget: RayBudget, count: U2) -> U4:
    """Cast the sub-rays of every pulse, by rounds of eight.

    Parameters
    ----------
    count : (k, L) output, sub-rays of each pulse; n in all

    Returns
    -------
    (3, n) in order of pulses: bits of the ranges, surfaces, bits of the cosines
    """
    batch, pulses = cast.batch, PACKET * count.shape[1]
    set_filter(cast.packet)
    groups = [np.empty((3, 0), np.uint32) for _ in range(count.shape[0] // PACKET)]
    for first in cast.light.order:
        todo, have = pulses, ZERO
        for q in range(pulses):
            batch.todo[q] = q
        while todo:
            rays = min(ROUND, budget.most - have)
            _cast_near(cast, beyond, budget, first, todo, have, rays)
            if passage is not None:
                go_on(passage, cast, todo, rays, reach_of(have, budget.adaptive))
            todo, have = _settle(cast, budget, todo, have, rays), have + rays
        groups[first // PACKET] = _taken(batch, first, count)
    n = ZERO
    for group in groups:
        n += group.shape[1]
    hits, n = np.empty((3, n), np.uint32), ZERO
    for group in groups:
        hits[:, n : n + group.shape[1]] = group
        n += group.shape[1]
    return hits


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_middles(cast: Cast, beyond: Target | None, first: int) -> None:
    """Cast the middles of the pulses of eight sequences against faces, those of a laser as one packet."""
    near, light, packet, batch = cast
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
        _put_down(cast, beyond, PACKET * j, ZERO + 1, ZERO + PACKET)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _cast_near(
    cast: Cast, beyond: Target | None, budget: RayBudget, first: int, todo: int, have: int, count: int
) -> None:
    """Cast the next sub-rays of pulses, which have some already, against faces, those of a pulse as one packet."""
    near, light, packet, batch = cast
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
        _put_down(cast, beyond, q, ZERO, count)


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _put_down(cast: Cast, beyond: Target | None, q: int, step: int, count: int) -> None:
    """Store hits, of all rays of pulse q (step 0) or of one ray of each pulse from q on (step 1); send the others on."""
    near, light, packet, batch = cast
    instance, valid, row, surface = packet.instance, packet.valid, batch.row, batch.surface
    missed, far_m = 0, light.far_m
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
        _send_on(cast, beyond, q, step, count)


@numba.njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _send_on(cast: Cast, beyond: Target, q: int, step: int, count: int) -> None:
    """Store the rays that go on for the medium, and cast them against what is cast as faces at any range."""
    _, light, packet, batch = cast
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
    cast_packet(beyond, packet, light.reach_m, light.far_m)
    for r in range(count):
        if valid[r] and instance[r] != NONE:
            to, lane = q + step * r, (1 - step) * r
            row[to, RANGE + lane], surface[to, lane], row[to, COSINE + lane] = ray_met(beyond, packet, r)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _settle(cast: Cast, budget: RayBudget, todo: int, have: int, count: int) -> int:
    """Take the hits of a round; list the pulses that need another, and return how many."""
    batch, reflectance = cast.batch, cast.near.reflectance
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
        needs_more = own < budget.most
        if needs_more and budget.adaptive:
            stop = begin + own
            ranges, surfaces, cosines = range_m[begin:stop], surface[begin:stop], cosine[begin:stop]
            needs_more = not enough(ranges, surfaces, cosines, reflectance, budget, batch.scratch)
        if needs_more:
            batch.todo[left] = q
            left += 1
    return left


@numba.njit(cache=True, nogil=True)
def _taken(batch: Batch, first: int, count: U2) -> U4:
    """Count the hits of eight sequences and return them in order of pulses, (3, n) as in `cast_pulses`."""
    most, n = batch.scratch.shape[1], ZERO
    for q in range(PACKET * count.shape[1]):
        count[first + q % PACKET, q // PACKET] = batch.have[q]
        n += batch.have[q]
    hits, n = np.empty((3, n), np.uint32), ZERO
    range_bits, surface, cosine_bits = hits[0], hits[1], hits[2]
    range_m, cosine = range_bits.view(np.float32), cosine_bits.view(np.float32)
    for i in range(PACKET):
        for j in range(count.shape[1]):
            begin, own = (PACKET * j + i) * most, batch.have[PACKET * j + i]
            for s in range(own):
                range_m[n + s] = batch.hits.range_m[begin + s]
                surface[n + s] = batch.hits.surface[begin + s]
                cosine[n + s] = batch.hits.cos_incidence[begin + s]
            n += own
    return hits
