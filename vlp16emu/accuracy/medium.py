"""Worlds with a medium beyond some range, met by the same pulses as the explicit world."""

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vlp16emu.accuracy.compare import Counts, Echoes, counted
from vlp16emu.accuracy.converged import GROUP, Group, answer_beam, draw_groups
from vlp16emu.accuracy.curve import Kind
from vlp16emu.accuracy.distributions import Distributions, distributions_of
from vlp16emu.accuracy.settings import LevelOfDetail, beam_settings, levels_of_detail
from vlp16emu.engine import Unit, assemble, window_of
from vlp16emu.engine.windows import Batching, workers
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import Scenario
from vlp16emu.types import Firings, HeightField, Returns
from vlp16emu.units import S_NS, seconds_to_ns
from vlp16emu.world import Hall
from vlp16emu.world.make import ground_of
from vlp16emu.world.plants.flora import flora

RAYS = 16
"""Sub-rays of a pulse."""
_AGAIN = 8
"""Every eighth group is cast once more, a revolution later."""
_ELSEWHERE_M = 0.1
"""First returns so far apart are different ones."""
_STRONGEST, _LAST, _SECOND = 0, 1, 2  # columns of Returns


@dataclass(frozen=True, slots=True)
class Look:
    """One way to see a world: by a unit without noise, with so much light."""

    unit: Unit
    beam: Footprint
    height_m: HeightField
    """Of the ground."""

    def aimed(self, group: Group) -> Firings:
        """Aim the sequences of a group."""
        return self.unit.head.aim(group.first, group.count, self.unit.motion.poses_at, beam_axis=True)

    def returns(self, geometry: Geometry, firings: Firings) -> tuple[Returns, float]:
        """Cast pulses and detect all echoes; with the run time of casting in microseconds per pulse."""
        began_s = time.thread_time()
        hits = geometry.cast(firings, self.unit.head.beams.near_m, self.unit.section.max_range_m, self.beam)
        us = 1e6 * (time.thread_time() - began_s) / firings.t_ns.size
        return detect(firings, hits, geometry.surfaces, self.unit.detector.without_chance(), truth=True), us

    def counted(self, geometry: Geometry, group: Group, *, again: bool) -> tuple[Counts, float]:
        """Count what a group shows, and measure the run time of casting it."""
        firings = self.aimed(group)
        returns, us = self.returns(geometry, firings)
        echoes = echoes_of(returns, self.height_m)
        changed = 0, 0
        if again:
            later, _ = self.returns(geometry, next_revolution(firings, self.unit))
            there_m = echoes_of(later, self.height_m).distance_m[:, 0]
            moved = np.abs(there_m - echoes.distance_m[:, 0]) > _ELSEWHERE_M
            changed = len(moved), int(moved.sum())
        return counted(echoes, firings.t_ns.shape[1], changed), us


def measure_medium(scenario: Scenario, *, pulses: int, done: Callable[[float], None]) -> Distributions | None:
    """Hold the world of a scene, cast leaf by leaf to some distances, against the explicit one; None of a hall.

    Parameters
    ----------
    pulses : looked at in each world, rounded up to whole groups
    done : receives the share of the work that is done
    """
    drawn, section = levels_of_detail(scenario), scenario.world
    if isinstance(section, Hall):
        return None
    worlds, us = dict[float, Counts](), list[float]()
    for number, level in enumerate(drawn):
        counts, times_us = _world(level, pulses, partial(_part_done, done, number, len(drawn)))
        worlds[level.near_m] = Counts(*(np.stack(of) for of in zip(*counts, strict=True)))
        us.append(float(np.median(times_us)))
    elevation_deg = assemble(scenario).head.beams.elevation_deg
    statistics, tests = distributions_of(
        worlds,
        seed=scenario.seed,
        lasers=[f"{number}, at {degrees:+.4g} deg" for number, degrees in enumerate(elevation_deg.tolist())],
        species=flora(section.species_file).names,
    )
    explicit = worlds[math.inf]
    return Distributions(
        names=tuple(one.name for one in drawn),
        in_use=tuple(one.in_use for one in drawn),
        pulses=int(explicit.pulses.sum()),
        groups=len(explicit.pulses),
        rays=RAYS,
        us_per_pulse=tuple(us),
        statistics=statistics,
        tests=tests,
    )


def _part_done(done: Callable[[float], None], number: int, of: int, share: float) -> None:
    done((number + share) / of)


def _world(
    level: LevelOfDetail, pulses: int, done: Callable[[float], None]
) -> tuple[list[Counts], list[float]]:
    """Count what all groups of a run show in one world, and measure the run time of casting."""
    scenario, parts = level.scenario, assemble(level.scenario)
    unit = parts.units[0]
    look = Look(unit, _beam(scenario, unit), ground_of(scenario.world, scenario.world_seed).height_m)
    batching = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns)
    run_ns = seconds_to_ns(min(scenario.duration_s, unit.motion.run_time_s))
    counts, us = list[Counts](), list[float]()
    with workers(os.cpu_count() or 1, "medium") as pool:
        built = caster(parts.world, pool)
        for segment, groups in draw_groups(
            batching, len(batching.blocks(0, run_ns)), pulses, unit.seed, moves=parts.moves
        ):
            geometry = built.open(window_of(parts, scenario.start_ns, batching, segment))
            again = [number % _AGAIN == 0 for number in range(len(groups))]
            for one, time_us in pool.map(
                lambda group, again, geometry=geometry: look.counted(geometry, group, again=again),
                groups,
                again,
            ):
                counts.append(one)
                us.append(time_us)
            done((groups[-1].first + GROUP) * batching.sequence_ns / run_ns)
    return counts, us


def _beam(scenario: Scenario, unit: Unit) -> Footprint:
    wide = next(setting.beam for setting in beam_settings(scenario, unit.seed) if setting.kind is Kind.FIXED)
    return answer_beam(wide, RAYS, unit.seed)


def next_revolution(firings: Firings, unit: Unit) -> Firings:
    """Fire the same pulses once more a revolution later, when other random numbers apply and all else stands still."""
    later = round(60.0 / unit.section.rpm * S_NS / unit.head.beams.sequence_ns)
    return replace(firings, index=firings.index + later)


def echoes_of(returns: Returns, height_m: HeightField) -> Echoes:
    """Give what a sensor in dual return reports: the strongest and the last, or the second strongest if those are one."""
    distance_m = returns.distance_m.reshape(-1, 3).astype(np.float64)
    assert returns.surface is not None
    assert returns.surfaces is not None
    alone = distance_m[:, _STRONGEST] == distance_m[:, _LAST]
    other = np.where(alone, _SECOND, _LAST)
    columns = np.stack([np.zeros_like(other), other], axis=1)
    rows = np.arange(len(other))[:, None]
    near_m = distance_m[rows, columns]
    near_m = np.where(near_m > 0, near_m, np.inf)
    columns = np.take_along_axis(columns, np.argsort(near_m, axis=1, kind="stable"), axis=1)
    distance_m = distance_m[rows, columns]
    there = distance_m > 0
    surface = np.where(there, returns.surface.reshape(-1, 3)[rows, columns], 0)
    facts = returns.surfaces[surface]
    firings = returns.firings
    place_m = firings.origin_m.reshape(-1, 3) + distance_m[:, :1] * firings.direction.reshape(-1, 3)
    x_m, y_m, z_m = np.ascontiguousarray(place_m.T)
    return Echoes(
        laser=np.tile(np.arange(firings.t_ns.shape[1]), len(firings.t_ns)),
        distance_m=distance_m,
        reflectivity=np.where(there, returns.reflectivity.reshape(-1, 3)[rows, columns], 0).astype(np.uint8),
        part=np.where(there, facts["part"], 0).astype(np.uint8),
        species=np.where(there, facts["species"], 0).astype(np.uint16),
        height_m=z_m - height_m(x_m, y_m),
    )
