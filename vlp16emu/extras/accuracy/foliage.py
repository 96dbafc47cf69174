"""The world cast leaf by leaf to some distances, compared with the explicit one.

Beyond `near_m` single leaves differ from those of the explicit world, so means over the same pulses are compared, not pulses.
"""

import math
import os
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import assemble
from vlp16emu.engine.windows import workers
from vlp16emu.extras.accuracy.curve import LevelOfDetail, Mean
from vlp16emu.extras.accuracy.sample import TIMED_SEQUENCES, Bench, opened_windows
from vlp16emu.forest.settings import Woods
from vlp16emu.raycast.caster import Geometry
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import Scenario
from vlp16emu.types import F4, PlantPart, Returns

_NEAR_M = (10.0, 15.0, 20.0, 30.0, math.inf)
_NORMAL_95 = 1.96
_REPEATS = 5
_STRONGEST, _LAST, _SECOND = 0, 1, 2  # columns of Returns


def measure_foliage(
    scenario: Scenario, *, pulses: int, done: Callable[[float], None] = lambda _: None
) -> tuple[LevelOfDetail, ...]:
    """Measure means and run time of a scene's world cast leaf by leaf to some distances; nothing for a hall.

    Parameters are as in `measure_accuracy`; each world gets so many pulses.
    """
    if not isinstance(world := scenario.world, Woods):
        return ()
    levels = sorted({*_NEAR_M, world.near_m})
    us, groups = list[float](), list[list[dict[str, float]]]()
    for number, near_m in enumerate(levels):
        means, times_us = list[dict[str, float]](), list[float]()
        for returns, time_us, share in returns_of(scenario, near_m, pulses):
            means.append(_means(returns, scenario.sensor.max_range_m))
            times_us.append(time_us)
            done((number + share) / len(levels))
        groups.append(means)
        us.append(float(np.median(times_us)))
    return tuple(
        LevelOfDetail(f"world.near_m={near_m:g}", near_m == world.near_m, time_us, _held(means, groups[-1]))
        for near_m, time_us, means in zip(levels, us, groups, strict=True)
    )


def returns_of(scenario: Scenario, near_m: float, pulses: int) -> Iterator[tuple[Returns, float, float]]:
    """Cast groups of pulses of the first unit against a scene's world, leaf by leaf to `near_m`, and detect them without noise.

    Yields returns of a group, microseconds per pulse in its window on one core, and the share of the run that is done.
    """
    world = scenario.world.model_copy(update={"near_m": near_m})
    parts = assemble(scenario.model_copy(update={"world": world}))
    unit = parts.units[0]
    bench, detector, poses_at = Bench(unit, unit.beam.rays), unit.detector.without_chance(), unit.motion.poses_at

    def returns(geometry: Geometry, group: range) -> Returns:
        firings = bench.aimed(group, poses_at)
        hits = bench.cast(geometry, firings, unit.beam)
        return detect(firings, hits, geometry.surfaces, detector, truth=True)

    with workers(os.cpu_count() or 1, "foliage") as pool:
        for geometry, groups, share in opened_windows(scenario, parts, pulses, pool):
            found = list(pool.map(partial(returns, geometry), groups))
            timed = bench.aimed(range(start := groups[0].start, start + TIMED_SEQUENCES), poses_at)
            us = min(bench.timed(geometry, timed, unit.beam)[0] for _ in range(_REPEATS))
            yield from ((one, us, share) for one in found)


def is_two(distance_m: F4) -> NDArray[np.bool_]:
    """Return whether pulses have two returns in dual return, by their distances (..., 3)."""
    is_apart = distance_m[..., _STRONGEST] != distance_m[..., _LAST]
    two: NDArray[np.bool_] = is_apart | (distance_m[..., _SECOND] > 0)
    return two


def _means(returns: Returns, reach_m: float) -> dict[str, float]:
    """Return means over the pulses of a group, also over those without a return."""
    assert returns.surface is not None
    assert returns.surfaces is not None
    distance_m = returns.distance_m[..., _STRONGEST]
    is_seen = distance_m > 0
    surface = np.where(is_seen, returns.surface[..., _STRONGEST], 0)
    is_leaf = is_seen & (returns.surfaces["part"][surface] == PlantPart.LEAF)
    return {
        "with a return, %": 100 * float(is_seen.mean()),
        "with two, %": 100 * float(is_two(returns.distance_m).mean()),
        "of leaf, %": 100 * float(is_leaf.mean()),
        "range, m": float(np.where(is_seen, distance_m, reach_m).mean()),
        "reflectivity": float(np.where(is_seen, returns.reflectivity[..., _STRONGEST], 0).mean()),
    }


def _held(groups: list[dict[str, float]], explicit: list[dict[str, float]]) -> dict[str, Mean]:
    """Compare means of groups of equal size with those of the explicit world."""
    held = dict[str, Mean]()
    for name in explicit[0]:
        own, other = (np.array([means[name] for means in of]) for of in (groups, explicit))
        off = own - other  # pulses of a group see the same trees: groups are what is independent
        half = _NORMAL_95 * float(off.std(ddof=1)) / math.sqrt(len(off)) if len(off) > 1 else math.nan
        held[name] = Mean(float(own.mean()), float(off.mean()), half)
    return held
