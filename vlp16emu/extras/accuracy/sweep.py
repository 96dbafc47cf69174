"""Error against run time: settings of the beam and near_m, on pulses from the whole run.

The reference is the converged answer: the same pulses with many more sub-rays, detected without noise. Beyond
`near_m` single leaves differ from the leaves of the explicit world, so means over the same pulses are
compared there.
"""

import math
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Parts, Unit, assemble, beam_of, window_of
from vlp16emu.engine.windows import Batching, workers
from vlp16emu.errors import RunError
from vlp16emu.extras.accuracy.audit import (
    Detections,
    Errors,
    answer_beam,
    apart_m,
    compare,
    detections_of,
    errors_of,
)
from vlp16emu.extras.accuracy.intervals import Interval, intervals_of
from vlp16emu.forest.settings import Woods
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import Scenario
from vlp16emu.trees import Tree
from vlp16emu.types import F4, I8, Firings, Hits, PlantPart, Returns
from vlp16emu.units import seconds_to_ns

_WANTED_M = 0.5, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01
_ERRANT = "angle", "offset"  # beam errors of LiDAR-Forest (Lu et al.): for comparison, not for use


@dataclass(frozen=True, slots=True)
class Row:
    """Error and run time of one setting."""

    model: str  # model of the beam
    name: str  # setting in the form of `--set`
    in_use: bool  # True for the scene's own setting
    errors: Errors
    intervals: Mapping[str, Interval]  # 95 % interval of each of `errors`, by name
    us_per_pulse: float  # run time of casting and detecting on one core
    us_spread: float  # difference between the slowest and the fastest repetition
    rays_per_pulse: float


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over pulses."""

    value: float
    off: float  # difference from the explicit world
    half: float  # half of the 95 % interval of this difference

    @property
    def departs(self) -> bool:
        """True if the difference exceeds chance."""
        return abs(self.off) > self.half


@dataclass(frozen=True, slots=True)
class LevelOfDetail:
    """A world with single leaves up to some distance."""

    name: str  # as `--set` takes it
    in_use: bool
    us_per_pulse: float  # run time of casting and detecting on one core
    means: Mapping[str, Mean]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors of a scene by setting."""

    scene: str
    seed: int
    answer_rays: int  # sub-rays of the answer
    answer_rmse_m: float  # error of the answer itself, from two answers with different sub-rays
    rows: tuple[Row, ...]


def choices(rows: Sequence[Row]) -> dict[str, float]:
    """Return the settings that are the fastest for a mean error: the least such error, in metres, by name."""
    found = dict[str, float]()
    for wanted_m in _WANTED_M:
        good = [row for row in rows if row.errors.mean_error_m <= wanted_m and row.model not in _ERRANT]
        if good:
            found[min(good, key=lambda row: row.us_per_pulse).name] = wanted_m
    return found


GROUP = 8
"""Firing sequences of a group, which begins at a multiple of eight: an adaptive beam adapts within these
eight only."""
TIMED_SEQUENCES = 96
"""Firing sequences per window for run time: the overhead of a call is then below a tenth of a ray each."""
_MOST_SEGMENTS = 8  # greatest number of segments of a long walk: each needs a window of the world


def join_detections(parts: Sequence[Detections]) -> Detections:
    """Join the detections of several batches."""
    return Detections(*map(np.concatenate, zip(*parts, strict=True)))


def draw_groups(
    batching: Batching, blocks: int, pulses: int, seed: int, *, moves: bool
) -> Iterator[tuple[int, list[range]]]:
    """Draw groups of firing sequences from the first blocks of a run, with at least `pulses` pulses.

    Yields the number of a segment, whose groups share a window, and these groups in order of time. If nothing
    moves, there is segment 0 alone.
    """
    draw = generator(seed, Purpose.AUDIT, -1)
    per_block = batching.block // GROUP
    segment = batching.segment if moves else blocks
    segments = -(-blocks // segment)
    chosen = _one_of_each(draw, segments, min(_MOST_SEGMENTS, segments))
    groups = -(-pulses // (GROUP * batching.lasers * len(chosen)))
    for number in chosen.tolist():
        first, stop = number * segment * per_block, min((number + 1) * segment, blocks) * per_block
        places = first + _one_of_each(draw, stop - first, min(groups, stop - first))
        yield number, [range(place, place + GROUP) for place in (GROUP * places).tolist()]


def _one_of_each(draw: np.random.Generator, things: int, strata: int) -> I8:
    """Draw one of the numbers below `things` from each of some strata of nearly equal size."""
    edges = np.arange(strata + 1) * things // strata
    return draw.integers(edges[:-1], edges[1:])


def opened_windows(
    scenario: Scenario, parts: Parts, pulses: int, pool: Executor
) -> Iterator[tuple[Geometry, list[range], float]]:
    """Open the windows of a sample of pulses of a run's first unit, one after the other; `pool` grows shapes.

    Yields a window, the groups in it, and the share of the run at their end.
    """
    unit = parts.units[0]
    batching = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns)
    run_ns = seconds_to_ns(min(scenario.duration_s, unit.motion.run_time_s))
    built = caster(parts.world, pool)
    blocks = len(batching.blocks(0, run_ns))
    for segment, groups in draw_groups(batching, blocks, pulses, unit.seed, moves=parts.moves):
        geometry = built.open(window_of(parts, scenario.start_ns, batching, segment))
        yield geometry, groups, min(groups[-1].stop * batching.sequence_ns / run_ns, 1.0)


@dataclass(frozen=True, slots=True)
class Bench:
    """Ray casts and detections of the pulses of a unit."""

    unit: Unit
    rays: int  # sub-rays of an answer

    def aim(self, group: range) -> Firings:
        """Aim the sequences of a group."""
        return self.unit.head.aim(group.start, len(group), self.unit.motion.poses_at, beam_axis=True)

    def cast(self, geometry: Geometry, firings: Firings, beam: Footprint) -> Hits:
        """Cast pulses between the unit's limits of range."""
        return geometry.cast(firings, self.unit.head.beams.near_m, self.unit.section.max_range_m, beam)

    def detections(self, geometry: Geometry, firings: Firings, beam: Footprint) -> Detections:
        """Cast pulses, and detect them without noise."""
        hits = self.cast(geometry, firings, beam)
        return detections_of(firings, hits, geometry.surfaces, self.unit.detector.without_chance())

    def answer(self, geometry: Geometry, firings: Firings, beam: Footprint, number: int = 0) -> Detections:
        """Return the answer for some pulses; `number` distinguishes answers with different sub-rays."""
        return self.detections(geometry, firings, answer_beam(beam, self.rays, self.unit.seed, number))

    def time_casting(self, geometry: Geometry, firings: Firings, beam: Footprint) -> tuple[float, float]:
        """Cast and detect as a run does; return microseconds per pulse on one core, and rays per pulse."""
        began_s = time.thread_time()
        hits = self.cast(geometry, firings, beam)
        detect(firings, hits, geometry.surfaces, self.unit.detector, truth=False)
        return 1e6 * (time.thread_time() - began_s) / firings.t_ns.size, float(hits.count.mean())


_COUNTS = (4, 8, 16, 32, 64, 128)
_TIMES_TARGET = (0.25, 0.5, 1.0, 2.0, 4.0)  # targets of adaptive beams, relative to the scene's target
# sub-rays of an answer: at least the first, and the second times the sub-rays of a pulse
_RAYS = 4096
_TIMES = 4
_REPEATS = 5
_ANSWERED_TWICE = 4
"""Every fourth group also gives the error of the answer itself, because answers are expensive."""


class BeamSetting(NamedTuple):
    """A setting of the beam."""

    model: str
    name: str  # as `--set` takes it
    in_use: bool
    beam: Footprint


def beam_settings(scenario: Scenario, seed: int) -> list[BeamSetting]:
    """List the settings to be compared, the scene's own among them.

    They are one ray, the beam errors of LiDAR-Forest, fixed counts and adaptive targets.
    """
    section = scenario.beam
    counts = sorted({*_COUNTS, section.rays} if section.model == "fixed" else _COUNTS)
    targets_m = sorted({min(times * section.target_m, 1.0) for times in _TIMES_TARGET}, reverse=True)
    ladder: list[Tree] = [
        *({"model": model} for model in ("none", *_ERRANT)),
        *({"model": "fixed", "rays": count} for count in counts),
        *({"model": "adaptive", "target_m": target_m} for target_m in targets_m),
    ]
    settings = list[BeamSetting]()
    for keys in ladder:
        changed = section.model_copy(update=keys)
        beam = beam_of(scenario.model_copy(update={"beam": changed}), seed, scenario.sensor.min_range_m)
        words = {key: value if isinstance(value, str) else f"{value:.4g}" for key, value in keys.items()}
        name = " ".join(f"beam.{key}={word}" for key, word in words.items())
        settings.append(BeamSetting(keys["model"], name, changed == section, beam))
    return settings


class _SettingsBench:
    """All settings on one bench, measured window by window."""

    def __init__(self, bench: Bench, scenario: Scenario) -> None:
        self._bench = bench
        self._apart_m = apart_m(scenario.detector)
        self._beams = beam_settings(scenario, bench.unit.seed)
        self._wide = next(setting.beam for setting in self._beams if setting.model == "fixed")
        self._detections = defaultdict[str, list[Detections]](list)
        self._us = defaultdict[str, list[float]](list)
        self._rays = defaultdict[str, list[float]](list)

    def detect_groups(self, geometry: Geometry, groups: Sequence[range], pool: ThreadPoolExecutor) -> None:
        """Detect the groups of one window with all settings."""
        bench = self._bench
        pulses = [self._bench.aim(group) for group in groups]

        def answers(pulses: Sequence[Firings], number: int) -> list[Detections]:
            """Return the answers for groups of pulses, with the sub-rays of answer `number`."""
            return list(pool.map(lambda firings: bench.answer(geometry, firings, self._wide, number), pulses))

        self._detections["answer"] += (found := answers(pulses, 0))
        self._detections["answer of some"] += found[::_ANSWERED_TWICE]
        self._detections["another answer"] += answers(pulses[::_ANSWERED_TWICE], 1)
        for setting in self._beams:
            self._detections[setting.name] += [
                bench.detections(geometry, firings, setting.beam) for firings in pulses
            ]

    def time(self, geometry: Geometry, block: range) -> None:
        """Measure the run time of all settings in turn, so that other load affects all of them."""
        bench = self._bench
        firings = bench.aim(block[:TIMED_SEQUENCES])
        for repeat in range(_REPEATS + 1):
            times = {
                setting.name: bench.time_casting(geometry, firings, setting.beam) for setting in self._beams
            }
            if repeat:  # the first repetition compiles and warms up
                for name, (us, rays) in times.items():
                    self._us[name].append(us)
                    self._rays[name].append(rays)

    def summary(self, scene: str, seed: int) -> Accuracy:
        """Return all errors and run times.

        The difference of two answers is the error of one times the root of two.
        """
        answer = self._errors("another answer", "answer of some")
        return Accuracy(
            scene=scene,
            seed=seed,
            answer_rays=self._bench.rays,
            answer_rmse_m=answer.range_rmse_m / float(np.sqrt(2.0)),
            rows=tuple(map(self._row, self._beams)),
        )

    def _row(self, setting: BeamSetting) -> Row:
        name = setting.name
        us = np.array(self._us[setting.name]).reshape(-1, _REPEATS).mean(axis=0)
        pairs = zip(self._detections["answer"], self._detections[name], strict=True)
        groups = [compare(answer, detected, self._apart_m) for answer, detected in pairs]
        return Row(
            model=setting.model,
            name=name,
            in_use=setting.in_use,
            errors=self._errors(name, "answer"),
            intervals=intervals_of(groups, self._apart_m),
            us_per_pulse=float(np.median(us)),
            us_spread=float(np.ptp(us)),
            rays_per_pulse=float(np.mean(self._rays[name])),
        )

    def _errors(self, name: str, answer: str) -> Errors:
        compared = compare(
            join_detections(self._detections[answer]), join_detections(self._detections[name]), self._apart_m
        )
        return errors_of(compared, self._apart_m)


def measure_accuracy(
    scenario: Scenario, scene: str, *, pulses: int, done: Callable[[float], None] = lambda _: None
) -> Accuracy:
    """Measure errors and run time of the beams of the scene named `scene`, with its first unit.

    RunError if no pulse has a return.

    Parameters
    ----------
    pulses : number of pulses, rounded up to whole groups
    done : called with the completed share of the work
    """
    parts = assemble(scenario)
    unit = parts.units[0]
    block = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns).block
    settings = _SettingsBench(Bench(unit, max(_RAYS, _TIMES * unit.beam.rays)), scenario)
    with workers(os.cpu_count() or 1, "accuracy") as pool:
        for geometry, groups, share in opened_windows(scenario, parts, pulses, pool):
            settings.detect_groups(geometry, groups, pool)
            settings.time(geometry, range(begin := groups[0].start // block * block, begin + block))
            done(share)
    accuracy = settings.summary(scene, scenario.seed)
    if not (seen := accuracy.rows[0].errors).returns:
        raise RunError(f"{scene}: none of {seen.pulses} pulses has a return; nothing can be wrong")
    return accuracy


_NEAR_M = (10.0, 15.0, 20.0, 30.0, math.inf)
_NORMAL_95 = 1.96
_STRONGEST = 0  # columns of Returns
_LAST = 1
_SECOND = 2


def measure_foliage(
    scenario: Scenario, *, pulses: int, done: Callable[[float], None] = lambda _: None
) -> tuple[LevelOfDetail, ...]:
    """Measure means and run time of a scene's world with single leaves up to several distances.

    The explicit world is last. A hall has no rows. Parameters as in `measure_accuracy`; each world gets
    `pulses` pulses.
    """
    if not isinstance(world := scenario.world, Woods):
        return ()
    levels = sorted({*_NEAR_M, world.near_m})
    us = list[float]()
    groups = list[list[dict[str, float]]]()
    for number, near_m in enumerate(levels):
        means = list[dict[str, float]]()
        times_us = list[float]()
        for returns, time_us, share in returns_of(scenario, near_m, pulses):
            means.append(_means(returns, scenario.sensor.max_range_m))
            times_us.append(time_us)
            done((number + share) / len(levels))
        groups.append(means)
        us.append(float(np.median(times_us)))
    return tuple(
        LevelOfDetail(
            f"world.near_m={near_m:g}", near_m == world.near_m, time_us, departures(means, groups[-1])
        )
        for near_m, time_us, means in zip(levels, us, groups, strict=True)
    )


def returns_of(scenario: Scenario, near_m: float, pulses: int) -> Iterator[tuple[Returns, float, float]]:
    """Cast pulses of the first unit against a scene's world, and detect them without noise.

    The world has single leaves up to `near_m`. Yields returns of a group, microseconds per pulse in its
    window on one core, and the completed share of the run.
    """
    world = scenario.world.model_copy(update={"near_m": near_m})
    parts = assemble(scenario.model_copy(update={"world": world}))
    unit = parts.units[0]
    bench = Bench(unit, unit.beam.rays)
    detector = unit.detector.without_chance()

    def returns(geometry: Geometry, group: range) -> Returns:
        """Return the returns of a group."""
        firings = bench.aim(group)
        hits = bench.cast(geometry, firings, unit.beam)
        return detect(firings, hits, geometry.surfaces, detector, truth=True)

    with workers(os.cpu_count() or 1, "foliage") as pool:
        for geometry, groups, share in opened_windows(scenario, parts, pulses, pool):
            found = list(pool.map(partial(returns, geometry), groups))
            firings = bench.aim(range(start := groups[0].start, start + TIMED_SEQUENCES))
            us = min(bench.time_casting(geometry, firings, unit.beam)[0] for _ in range(_REPEATS))
            yield from ((group_returns, us, share) for group_returns in found)


def is_two(distance_m: F4) -> NDArray[np.bool_]:
    """Return a mask (...,) of pulses that have two returns in dual return, from their distances (..., 3)."""
    is_apart = distance_m[..., _STRONGEST] != distance_m[..., _LAST]
    return np.asarray(is_apart | (distance_m[..., _SECOND] > 0))


def _means(returns: Returns, reach_m: float) -> dict[str, float]:
    """Return means over the pulses of a group; a pulse without a return has the range `reach_m`."""
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


def departures(groups: list[dict[str, float]], explicit: list[dict[str, float]]) -> dict[str, Mean]:
    """Compare means of groups of equal size with means of the explicit world."""
    compared = dict[str, Mean]()
    for name in explicit[0]:
        values = np.array([means[name] for means in groups])
        off = values - np.array([means[name] for means in explicit])
        half = math.nan
        if len(off) > 1:  # pulses of a group see the same trees: only groups are independent
            half = _NORMAL_95 * float(off.std(ddof=1)) / math.sqrt(len(off))
        compared[name] = Mean(float(values.mean()), float(off.mean()), half)
    return compared
