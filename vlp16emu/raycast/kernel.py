"""The inner loop: sub-rays of a pulse as one packet of eight through near faces.

Eight sequences are cast at a time. A far medium has loops of its own from the same steps: all pulses of eight
sequences through the near faces, then the remaining ones through the medium, so that their memory does not
compete for the cache. Which rays share a packet depends on firing numbers and hits, never on threads. Kernels
without new arrays count no references (`_nrt=False`), and loops take arrays out of tuples first: saves a
twentieth of the time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.kernels.compiler import array_kernel, inline_kernel, kernel
from vlp16emu.raycast.adaptive import RayBudget, energy_of, enough
from vlp16emu.raycast.beam import ROUND, draw_pattern, fill_sub_rays, pulse_axes
from vlp16emu.raycast.packet import (
    DIR,
    NONE,
    ORG,
    PACKET,
    TIME,
    RayPacket,
    Target,
    cast_packet,
    hit_of,
    set_filter,
)
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, F8, I8, U2, U4

LANES = ROUND  # rays of a row
ORIGIN, DIRECTION, RANGE, COSINE, ROW = (LANES * row for row in (0, 3, 6, 7, 8))
"""Offsets of rows of lanes in `Batch.row`, and its length."""
_RANGE = np.uint64(RANGE)
_COSINE = np.uint64(COSINE)
_OUTLINE_FACTOR = np.float32(16.0)
"""Light of a pulse over that of its neighbour, and over the threshold, from which a sixteenth of its light is
seen beside it: as much as a pulse may have that eight rays miss."""
_OUTLINE_RAYS = 24
"""Least number of rays of a pulse beside an outline: they meet what has a sixteenth of its light. With 64,
the most by default, `reference_forest` takes 8 % longer."""
AXES_TIME = 12  # place of the pulse's time in a row of `Batch.axes_row`


class PulseBatch(NamedTuple):
    """Pulses to cast, and their width."""

    origin_m: F8
    """(k, L, 3), k a multiple of `PACKET`; `direction` and `beam_axis` alike, the latter empty for light
    without width."""
    direction: F8
    beam_axis: F8
    time: F4  # (k, L) time between the scene's first knot and its last, 0..1
    near_m: F8  # (L,) range at which each laser's light begins
    reach_m: float  # range at which near faces end; else `far_m`
    far_m: float  # farthest range
    order: I8  # (k / 8,) first sequence of each packet, in the order of casting
    sigmas: F4  # (4,) as in `Footprint`; `seed` alike
    seed: int
    first: int  # number of the first firing sequence


class RayHits(NamedTuple):
    """Hits of rays: arrays of one length."""

    range_m: F4
    surface: U4
    cos_incidence: F4
    energy: F4  # by `energy_of`, 0 without a hit; only filled for adaptive beams


class Batch(NamedTuple):
    """Buffers for the pulses of eight sequences, ordered by laser."""

    row: F4
    """Rays (n, ROW) of a pulse, rows of eight: origins, directions, ranges, cosines; one ray for a beam
    without width."""
    surface: U4  # (n, 8)
    axes: F4
    """(n, 5, 3) axes of the pulses: the first two are the centre ray, and the last begins with `time`."""
    axes_row: F4  # (n, 15) the same numbers
    missed: NDArray[np.bool_]  # (n,) mask of pulses with rays that meet nothing near
    todo: I8  # (n,) numbers of the pulses to cast
    have: I8  # (n,) number of sub-rays of each
    light: F4  # (n,) energy of the first round of each, in m-2
    blank: I8  # (n,) rays of that round that meet what is too near for an echo
    hits: RayHits  # (n m,) hits of these, pulse by pulse; m is a multiple of eight
    scratch: F8  # (2, m) for sorting


def batch_of(pulses: int, max_rays: int) -> Batch:
    """Make buffers for pulses of up to `max_rays` sub-rays each."""
    max_rays = -(-max_rays // ROUND) * ROUND
    n = pulses * max_rays
    axes_row = np.zeros((pulses, 15), np.float32)
    return Batch(
        np.zeros((pulses, ROW), np.float32),
        np.zeros((pulses, LANES), np.uint32),
        axes_row.reshape(pulses, 5, 3),
        axes_row,
        np.zeros(pulses, np.bool_),
        np.arange(pulses),
        np.zeros(pulses, np.int64),
        np.zeros(pulses, np.float32),
        np.zeros(pulses, np.int64),
        RayHits(
            np.empty(n, np.float32), np.empty(n, np.uint32), np.empty(n, np.float32), np.empty(n, np.float32)
        ),
        np.empty((2, max_rays)),
    )


class Cast(NamedTuple):
    """One thread's cast of a batch of pulses against near faces."""

    near: Target
    light: PulseBatch
    packet: RayPacket
    batch: Batch


@array_kernel
def cast_lines(cast: Cast, range_m: F4, surface: U4, cos_incidence: F4) -> None:
    """Cast one ray per pulse and fill arrays (k, L); packets hold eight consecutive firings of a laser."""
    set_filter(cast.packet)
    for first in cast.light.order:
        cast_centre_rays(cast, None, first)
        write_centre_rays(cast, first, range_m, surface, cos_incidence)


@array_kernel
def cast_pulses(cast: Cast, budget: RayBudget, count: U2, first_round: U4) -> U4:
    """Cast the sub-rays of every pulse in rounds of eight.

    Parameters
    ----------
    count : (k, L) output, sub-rays of each pulse
    first_round : (3, k L r) output: bits of the ranges, surfaces, bits of the cosines of the first r of each,
        in order of pulses: most positions are known in advance

    Returns
    -------
    (3, n) the same for all further sub-rays, in order of pulses
    """
    set_filter(cast.packet)
    groups = empty_groups(count)
    for first in cast.light.order:
        todo = queue_all(cast.batch)
        have = ZERO
        while todo:
            rays = min(ROUND, budget.max_rays - have)
            cast_near(cast, None, budget, first, todo, have, rays)
            todo = settle(cast, budget, first_round, first, todo, have, rays)
            have = have + rays
        groups[first // PACKET] = further_hits(cast.batch, min(ROUND, budget.max_rays), first, count)
    return concatenate(groups)


@array_kernel
def empty_groups(count: U2) -> list[U4]:
    """Return empty hits for each eight sequences of pulses (k, L)."""
    return [np.empty((3, 0), np.uint32) for _ in range(count.shape[0] // PACKET)]


@kernel
def queue_all(batch: Batch) -> int:
    """Queue all pulses of eight sequences; return their number."""
    pulses = batch.todo.shape[0]
    for q in range(pulses):
        batch.todo[q] = q
    return pulses


@array_kernel
def concatenate(groups: list[U4]) -> U4:
    """Concatenate hits (3, n)."""
    n = ZERO
    for group in groups:
        n += group.shape[1]
    hits = np.empty((3, n), np.uint32)
    n = ZERO
    for group in groups:
        hits[:, n : n + group.shape[1]] = group
        n += group.shape[1]
    return hits


@kernel
def join_rounds(count: U2, first_round: U4, further: U4, hits: U4) -> None:
    """Fill hits (3, n) from first and further rounds, as in `cast_pulses`, in order of pulses."""
    pulses = count.size
    lasers = count.shape[1]
    per_pulse = first_round.shape[1] // pulses
    for row in range(3):
        of_first = first_round[row]
        of_further = further[row]
        out = hits[row]
        begin = at = used = ZERO
        for pulse in range(pulses):
            more = count[pulse // lasers, pulse % lasers] - per_pulse
            if more or pulse == pulses - 1:
                stop = per_pulse * (pulse + 1)
                for a in range(stop - begin):
                    out[at + a] = of_first[begin + a]
                at = at + stop - begin
                begin = stop
                for a in range(more):
                    out[at + a] = of_further[used + a]
                at = at + more
                used = used + more


@kernel
def write_centre_rays(cast: Cast, first: int, range_m: F4, surface: U4, cos_incidence: F4) -> None:
    """Write the hits of the centre rays of eight sequences into arrays (k, L)."""
    batch = cast.batch
    for q in range(batch.missed.shape[0]):
        i = first + q % PACKET
        j = q // PACKET
        met = batch.surface[q, 0]
        range_m[i, j] = np.float32(np.inf) if met == NONE else batch.row[q, RANGE]
        surface[i, j] = met
        cos_incidence[i, j] = batch.row[q, COSINE]


@kernel
def cast_centre_rays(cast: Cast, beyond: Target | None, first: int) -> None:
    """Cast the centre rays of the pulses of eight sequences against faces, one packet per laser.

    `beyond` are the faces at any range behind the near ones, for casts that go on through a far medium; with
    None, here and below, numba leaves out what they need.
    """
    near, light, packet, batch = cast
    rays = packet.rays
    origin_m = light.origin_m
    direction = light.direction
    from_m = near.window_origin_m
    reach_m = light.reach_m
    lasers = origin_m.shape[1]
    for r in range(PACKET):  # in the order of memory
        for j in range(lasers):
            own = batch.axes_row[PACKET * j + r]
            for a in range(3):
                own[a] = np.float32(origin_m[first + r, j, a] - from_m[a])
                own[3 + a] = np.float32(direction[first + r, j, a])
            own[AXES_TIME] = light.time[first + r, j]
    for j in range(lasers):
        for r in range(PACKET):
            own = batch.axes_row[PACKET * j + r]
            for a in range(3):
                rays[ORG + PACKET * a + r] = own[a]
                rays[DIR + PACKET * a + r] = own[3 + a]
            rays[TIME + r] = own[AXES_TIME]
        packet.valid[:] = -1
        cast_packet(near, packet, light.near_m[j], reach_m)
        _store_hits(cast, beyond, PACKET * j, ZERO + 1, ZERO + PACKET)


@kernel
def cast_near(
    cast: Cast, beyond: Target | None, budget: RayBudget, first: int, todo: int, have: int, count: int
) -> None:
    """Cast the next sub-rays of pulses against faces, one packet per pulse."""
    near, light, packet, batch = cast
    valid = packet.valid
    reach_m = light.reach_m
    if not have:
        _fill_axes(cast, first)
    for t in range(todo):
        q = batch.todo[t]
        i = first + q % PACKET
        j = q // PACKET
        axes = batch.axes[q]
        u, v = draw_pattern(light.seed, light.first + i, j)
        fill_sub_rays(packet.rays, axes, light.sigmas, u, v, have, budget.adaptive)
        for r in range(PACKET):
            packet.rays[TIME + r] = batch.axes_row[q, AXES_TIME]
            valid[r] = -1 if r < count else 0
        cast_packet(near, packet, light.near_m[j], reach_m)
        _store_hits(cast, beyond, q, ZERO, count)


@inline_kernel
def _fill_axes(cast: Cast, first: int) -> None:
    """Fill the axes of the pulses of eight sequences, in the order of memory, which is then read ahead."""
    near, light, _, batch = cast
    for r in range(PACKET):
        i = first + r
        for j in range(light.time.shape[1]):
            q = PACKET * j + r
            axes = batch.axes[q]
            pulse_axes(light.origin_m, light.direction, light.beam_axis, near.window_origin_m, i, j, axes)
            batch.axes_row[q, AXES_TIME] = light.time[i, j]


@inline_kernel
def _store_hits(cast: Cast, beyond: Target | None, q: int, step: int, count: int) -> None:
    """Store hits of all rays of pulse q (step 0), or of one ray per pulse from q on (step 1)."""
    near, light, packet, batch = cast
    instance = packet.instance
    valid = packet.valid
    row = batch.row
    surface = batch.surface
    missed = 0
    far_m = light.far_m
    for r in range(count):
        to = q + step * r
        lane = (1 - step) * r
        if instance[r] == NONE:
            row[to, RANGE + lane] = np.float32(far_m)
            surface[to, lane] = NONE
            row[to, COSINE + lane] = 0.0
            missed += 1
        else:
            row[to, RANGE + lane], surface[to, lane], row[to, COSINE + lane] = hit_of(near, packet, r)
        valid[r] = -1 if instance[r] == NONE else 0
        batch.missed[to] = missed > 0 if step == 0 else instance[r] == NONE
    if beyond is not None and missed:
        _store_misses(cast, beyond, q, step, count)


@inline_kernel
def _store_misses(cast: Cast, beyond: Target, q: int, step: int, count: int) -> None:
    """Store the rays that go on for the medium, and cast them against faces at any range."""
    _, light, packet, batch = cast
    world_rays = packet.world_rays
    instance = packet.instance
    valid = packet.valid
    row = batch.row
    surface = batch.surface
    if step == 0:
        for at in range(3 * LANES):
            row[q, ORIGIN + at] = world_rays[ORG + at]
            row[q, DIRECTION + at] = world_rays[DIR + at]
    else:
        for r in range(count):
            if valid[r]:
                for a in range(3):
                    row[q + r, ORIGIN + LANES * a] = world_rays[ORG + PACKET * a + r]
                    row[q + r, DIRECTION + LANES * a] = world_rays[DIR + PACKET * a + r]
    if not beyond.scene:
        return
    cast_packet(beyond, packet, light.reach_m, light.far_m)
    for r in range(count):
        if valid[r] and instance[r] != NONE:
            to = q + step * r
            lane = (1 - step) * r
            row[to, RANGE + lane], surface[to, lane], row[to, COSINE + lane] = hit_of(beyond, packet, r)


@kernel
def settle(
    cast: Cast, budget: RayBudget, first_round: U4, first: int, todo: int, have: int, count: int
) -> int:
    """Keep the hits of a round, queue the pulses that need another round, and return their number.

    Parameters
    ----------
    first_round : as in `cast_pulses`
    first : number of the first sequence
    """
    batch = cast.batch
    reflectance = cast.near.reflectance
    hits = batch.hits
    row = batch.row
    met = batch.surface
    light = batch.light
    range_m = hits.range_m
    surface = hits.surface
    cosine = hits.cos_incidence
    room = batch.scratch.shape[1]
    total = have + count
    lasers = met.shape[0] // PACKET
    first_m = first_round[0].view(np.float32)
    first_met = first_round[1]
    first_cosine = first_round[2].view(np.float32)
    for t in range(todo):
        q = batch.todo[t]
        begin = q * room
        own = row[q]
        own_met = met[q]
        at = np.uint64(begin + have)  # unsigned, also below: signed indices might count from the end
        for lane in range(np.uint64(LANES)):
            range_m[at + lane] = np.float32(np.inf) if own_met[lane] == NONE else own[_RANGE + lane]
            surface[at + lane] = own_met[lane]
            cosine[at + lane] = own[_COSINE + lane]
        if budget.adaptive:
            _weigh(hits, reflectance, at)
        if have == 0:
            to = np.uint64(count * ((first + q % PACKET) * lasers + q // PACKET))
            for lane in range(np.uint64(count)):
                first_m[to + lane] = range_m[at + lane]
                first_cosine[to + lane] = cosine[at + lane]
                first_met[to + lane] = surface[at + lane]
            if budget.adaptive:
                light[q], batch.blank[q] = _light_of(hits, at, budget.blank_m)
        batch.have[q] = total
    return _queue_again(cast, budget, todo, total) if total < budget.max_rays else 0


@inline_kernel
def _queue_again(cast: Cast, budget: RayBudget, todo: int, total: int) -> int:
    """Queue again the pulses among the first `todo` that need more than `total` rays; return their number."""
    batch = cast.batch
    hits = batch.hits
    room = batch.scratch.shape[1]
    left = 0
    for t in range(todo):
        q = batch.todo[t]
        needs_more = is_partly_hidden(batch.blank, q) or (
            total < _OUTLINE_RAYS and is_beside_outline(batch.light, budget, q)
        )
        if budget.adaptive and not needs_more:
            begin = q * room
            stop = begin + total
            if enough(hits.range_m[begin:stop], hits.energy[begin:stop], budget, batch.scratch):
                continue
        batch.todo[left] = q
        left += 1
    return left


@inline_kernel
def _weigh(hits: RayHits, reflectance: F4, begin: np.uint64) -> None:
    """Fill in the energies of a round of hits."""
    for lane in range(np.uint64(ROUND)):
        at = begin + lane
        energy = np.float32(0.0)
        if hits.surface[at] != NONE:
            energy = energy_of(reflectance[hits.surface[at]], hits.range_m[at], hits.cos_incidence[at])
        hits.energy[at] = energy


@inline_kernel
def _light_of(hits: RayHits, begin: np.uint64, blank_m: float) -> tuple[np.float32, int]:
    """Return the energy of a round of hits, in m-2.

    What is nearer than `blank_m` gives none; also returns the number of rays that meet it.
    """
    light = np.float32(0.0)
    blank = 0
    for lane in range(np.uint64(ROUND)):
        at = begin + lane
        is_blank = hits.range_m[at] < blank_m
        blank += is_blank
        light += np.float32(0.0) if is_blank else hits.energy[at]
    return light, blank


@inline_kernel
def is_partly_hidden(blank: I8, q: int) -> bool:
    """Return True if pulse q is at the outline of something that is too near for an echo.

    It hides a ray at least of the first round of the pulse, and not all of each of the eight firings of its
    laser.

    Parameters
    ----------
    blank : as in `Batch`
    """
    if blank[q] == 0:  # nearly all
        return False
    begin = q - q % PACKET
    hidden = 0
    for other in range(np.uint64(begin), np.uint64(begin + PACKET)):
        hidden += blank[other]
    return hidden < ROUND * PACKET


@inline_kernel
def is_beside_outline(light: F4, budget: RayBudget, q: int) -> bool:
    """Return True if pulse q is just beside the outline of something that is brighter than what it meets.

    The first round of the pulse before or after it, of the eight firings of its laser, has far more light, so
    much that what the faint edge of the beam adds may be seen.

    Parameters
    ----------
    light : (n,) energy of the first round of each pulse
    """
    brightest = light[q]
    if q % PACKET > 0:
        brightest = max(brightest, light[q - 1])
    if q % PACKET < PACKET - 1:
        brightest = max(brightest, light[q + 1])
    return bool(brightest > _OUTLINE_FACTOR * max(light[q], ROUND * budget.threshold))


@array_kernel
def further_hits(batch: Batch, per_pulse: int, first: int, count: U2) -> U4:
    """Count the hits of eight sequences; return those after the first `per_pulse`, as `cast_pulses` does."""
    room = batch.scratch.shape[1]
    n = ZERO
    for q in range(PACKET * count.shape[1]):
        count[first + q % PACKET, q // PACKET] = batch.have[q]
        n += batch.have[q] - per_pulse
    hits = np.empty((3, n), np.uint32)
    n = ZERO
    range_m = hits[0].view(np.float32)
    cosine = hits[2].view(np.float32)
    for i in range(PACKET):
        for j in range(count.shape[1]):
            begin = (PACKET * j + i) * room
            for s in range(per_pulse, batch.have[PACKET * j + i]):
                range_m[n] = batch.hits.range_m[begin + s]
                hits[1, n] = batch.hits.surface[begin + s]
                cosine[n] = batch.hits.cos_incidence[begin + s]
                n += 1
    return hits
