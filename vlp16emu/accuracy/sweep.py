"""Errors of settings on a sample of a run's pulses, and what each setting costs."""

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vlp16emu.accuracy.compare import Detections, Errors, compare, errors_of
from vlp16emu.accuracy.converged import GROUP, Bench, Group, apart_m, draw_groups, joined
from vlp16emu.accuracy.curve import Accuracy, Kind, Rounding, Row
from vlp16emu.accuracy.precision import NOTHING_MET, rounding_of
from vlp16emu.accuracy.settings import PosesAt, beam_settings, pose_rates
from vlp16emu.engine import assemble, window_of
from vlp16emu.engine.windows import Batching, workers
from vlp16emu.errors import RunError
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.scenario import Scenario
from vlp16emu.units import S_NS, seconds_to_ns

_RAYS, _TIMES = 4096, 4
"""Sub-rays of an answer: so many, and so many times those of a pulse of the scene."""
_REPEATS = 5
_TIMED_SEQUENCES = 96
"""On which run time is measured in each window: then calls cost below a tenth of a ray each."""
_POSED = 4
"""Every fourth group measures errors of poses and of the answer itself, for answers cost."""


class _Ladder:
    """All settings on one bench, looked at window by window."""

    def __init__(self, bench: Bench, scenario: Scenario) -> None:
        self._bench, self._apart_m = bench, apart_m(scenario.detector)
        self._beams, self._pose_rates = beam_settings(scenario, bench.unit.seed), pose_rates(bench.unit)
        self._wide = next(setting.beam for setting in self._beams if setting.kind is Kind.FIXED)
        self._detections = defaultdict[str, list[Detections]](list)
        self._us, self._rays = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)

    def look(self, geometry: Geometry, groups: Sequence[Group], pool: ThreadPoolExecutor) -> None:
        """Detect the groups of one window with all settings."""
        bench, poses_at = self._bench, self._bench.unit.motion.poses_at
        answers = list(pool.map(lambda group: self._answer(geometry, group, poses_at), groups))
        self._detections["answer"] += answers
        for setting in self._beams:
            found = self._detections[setting.name]
            for group in groups:
                found.append(bench.detections(geometry, bench.aimed(group, poses_at), setting.beam))
        self._detections["answer of some"] += answers[::_POSED]
        some = groups[::_POSED]
        self._detections["another answer"] += pool.map(
            lambda group: self._answer(geometry, group, poses_at, 1), some
        )
        for rate in self._pose_rates:
            held = rate.poses_at
            self._detections[rate.name] += pool.map(
                lambda group, held=held: self._answer(geometry, group, held), some
            )

    def _answer(self, geometry: Geometry, group: Group, poses_at: PosesAt, number: int = 0) -> Detections:
        return self._bench.answer(geometry, self._bench.aimed(group, poses_at), self._wide, number)

    def time(self, geometry: Geometry, block: Group) -> None:
        """Measure run time of all settings, in turn, so that whatever else goes on meets them alike."""
        bench = self._bench
        few = Group(block.first, min(_TIMED_SEQUENCES, block.count))
        firings = bench.aimed(few, bench.unit.motion.poses_at)
        for repeat in range(_REPEATS + 1):
            timed = {setting.name: bench.timed(geometry, firings, setting.beam) for setting in self._beams}
            timed |= {
                rate.name: (bench.timed_aim(block, rate.poses_at), bench.rays) for rate in self._pose_rates
            }
            if repeat:  # the first one compiled and warmed up
                for name, (us, rays) in timed.items():
                    self._us[name].append(us)
                    self._rays[name].append(rays)

    def summed(self, scene: str, seed: int, rounding: Rounding) -> Accuracy:
        """Sum all up; two answers differ by the root of two times the error of one."""
        answer = self._errors("another answer", "answer of some")
        return Accuracy(
            scene=scene,
            seed=seed,
            answer_rays=self._bench.rays,
            answer_rmse_m=answer.range_rmse_m / float(np.sqrt(2.0)),
            rows=tuple(
                self._row(setting.kind, setting.name, "answer", setting.in_use) for setting in self._beams
            ),
            poses=tuple(
                self._row(Kind.POSE, rate.name, "answer of some", rate.in_use) for rate in self._pose_rates
            ),
            rounding=rounding,
        )

    def _row(self, kind: Kind, name: str, answer: str, in_use: bool) -> Row:
        """Sum up one setting."""
        us = np.array(self._us[name]).reshape(-1, _REPEATS).mean(axis=0)
        return Row(
            kind=kind,
            name=name,
            in_use=in_use,
            errors=self._errors(name, answer),
            us_per_pulse=float(np.median(us)),
            us_spread=float(np.ptp(us)),
            rays_per_pulse=float(np.mean(self._rays[name])),
        )

    def _errors(self, name: str, answer: str) -> Errors:
        compared = compare(joined(self._detections[answer]), joined(self._detections[name]), self._apart_m)
        return errors_of(compared, self._apart_m)


def measure_accuracy(
    scenario: Scenario, scene: str, *, pulses: int, done: Callable[[float], None]
) -> Accuracy:
    """Measure errors and run time of the settings of a scene, for the first of its units.

    Parameters
    ----------
    scene : what it is called
    pulses : looked at, rounded up to whole groups
    done : called with the simulated seconds up to which the run was looked at

    Raises
    ------
    RunError
        where none of the pulses meets anything
    """
    parts = assemble(scenario)
    unit = parts.units[0]
    batching = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns)
    blocks = len(batching.blocks(0, seconds_to_ns(min(scenario.duration_s, unit.motion.run_time_s))))
    bench = Bench(unit, max(_RAYS, _TIMES * unit.beam.rays))
    ladder = _Ladder(bench, scenario)
    nearest_m, farthest_m = bench.limits_m
    rounding = NOTHING_MET
    with workers(os.cpu_count() or 1, "accuracy") as pool:
        built = caster(parts.world, pool)
        for segment, groups in draw_groups(batching, blocks, pulses, unit.seed, moves=parts.moves):
            window = window_of(parts, scenario.start_ns, batching, segment)
            opened = built.open(window)  # only now is the one before let go: shapes of both are built once
            ladder.look(opened, groups, pool)
            ladder.time(opened, Group(groups[0].first // batching.block * batching.block, batching.block))
            firings = bench.aimed(groups[0], unit.motion.poses_at)
            if not rounding.rays:
                faces_m = min(farthest_m, parts.world.near_m)  # beyond there are no faces to be met again
                rounding = rounding_of(opened, window, parts.world.shape, firings, nearest_m, faces_m)
            done((groups[-1].first + GROUP) * batching.sequence_ns / S_NS)
    summed = ladder.summed(scene, scenario.seed, rounding)
    if not (seen := summed.rows[0].errors).returns:
        raise RunError(f"{scene}: none of {seen.pulses} pulses has a return; nothing can be wrong")
    return summed
