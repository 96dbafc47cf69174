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
def cast_pulses(cast: Cast, beyond: Target | None, passage: Any, budget: RayBudget, count: U2, first_round: U4) -> U4:
    """Cast the sub-rays of every pulse, by rounds of eight.

    Parameters
    ----------
    count : (k, L) output, sub-rays of each pulse
    first_round : (3, k L r) output, bits of the ranges, surfaces, bits of the cosines of the first r of each, in order of
        pulses: the place of most is known before they are cast

    Returns
    -------
    (3, n) the same of all others, in order of pulses
    """
    batch, pulses, lasers = cast.batch, PACKET * count.shape[1], count.shape[1]
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
            if have == 0:
                todo = _settle_first(cast, budget, first_round, first * lasers, rays)
            else:
                todo = _settle(cast, budget, todo, have, rays)
            have += rays
        groups[first // PACKET] = _further(batch, min(ROUND, budget.most), first, count)
    n = ZERO
    for group in groups:
        n += group.shape[1]
    further, n = np.empty((3, n), np.uint32), ZERO
    for group in groups:
        further[:, n : n + group.shape[1]] = group
        n += group.shape[1]
    return further


@numba.njit(cache=True, nogil=True, _nrt=False)
def join_rounds(count: U2, first_round: U4, further: U4, hits: U4) -> None:
    """Fill hits (3, n) from those of first rounds and the others, as of `cast_pulses`, in order of pulses."""
    pulses, lasers = count.size, count.shape[1]
    each = first_round.shape[1] // pulses
    for row in range(3):
        of_first, rest, out = first_round[row], further[row], hits[row]
        begin = at = used = ZERO
        for pulse in range(pulses):
            more = count[pulse // lasers, pulse % lasers] - each
            if more or pulse == pulses - 1:
                stop = each * (pulse + 1)
                for a in range(stop - begin):
                    out[at + a] = of_first[begin + a]
                at, begin = at + stop - begin, stop
                for a in range(more):
                    out[at + a] = rest[used + a]
                at, used = at + more, used + more


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
def _settle_first(cast: Cast, budget: RayBudget, first_round: U4, begin: int, count: int) -> int:
    """Put the hits of the first round of all pulses in their place; list the pulses that need another, and return how many.

    Parameters
    ----------
    first_round : as of `cast_pulses`
    begin : number of the first pulse in it
    """
    batch, reflectance = cast.batch, cast.near.reflectance
    hits, row, met, most, left = batch.hits, batch.row, batch.surface, batch.scratch.shape[1], 0
    surface, lasers = first_round[1], met.shape[0] // PACKET
    range_m, cosine = first_round[0].view(np.float32), first_round[2].view(np.float32)
    for q in range(met.shape[0]):
        at = count * (begin + q % PACKET * lasers + q // PACKET)
        for lane in range(count):
            range_m[at + lane] = np.float32(np.inf) if met[q, lane] == NONE else row[q, RANGE + lane]
            surface[at + lane], cosine[at + lane] = met[q, lane], row[q, COSINE + lane]
        batch.have[q] = count
        needs_more, stop = count < budget.most, at + count
        if needs_more and budget.adaptive:
            ranges, surfaces, cosines = range_m[at:stop], surface[at:stop], cosine[at:stop]
            needs_more = not enough(ranges, surfaces, cosines, reflectance, budget, batch.scratch)
        if needs_more:
            for lane in range(count):
                to = q * most + lane
                hits.range_m[to], hits.surface[to] = range_m[at + lane], surface[at + lane]
                hits.cos_incidence[to] = cosine[at + lane]
            batch.todo[left] = q
            left += 1
    return left


@numba.njit(cache=True, nogil=True, _nrt=False)
def _settle(cast: Cast, budget: RayBudget, todo: int, have: int, count: int) -> int:
    """Take the hits of a further round; list the pulses that need another, and return how many."""
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
def _further(batch: Batch, each: int, first: int, count: U2) -> U4:
    """Count the hits of eight sequences and return those behind the first `each` in order of pulses, (3, n) as `cast_pulses`."""
    most, n = batch.scratch.shape[1], ZERO
    for q in range(PACKET * count.shape[1]):
        count[first + q % PACKET, q // PACKET] = batch.have[q]
        n += batch.have[q] - each
    further, n = np.empty((3, n), np.uint32), ZERO
    range_m, cosine = further[0].view(np.float32), further[2].view(np.float32)
    for i in range(PACKET):
        for j in range(count.shape[1]):
            begin = (PACKET * j + i) * most
            for s in range(each, batch.have[PACKET * j + i]):
                range_m[n], further[1, n] = batch.hits.range_m[begin + s], batch.hits.surface[begin + s]
                cosine[n] = batch.hits.cos_incidence[begin + s]
                n += 1
    return further
