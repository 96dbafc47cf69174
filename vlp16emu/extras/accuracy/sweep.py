"""Errors of settings on a sample of a run's pulses, and what each setting costs."""

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vlp16emu.engine import assemble
from vlp16emu.engine.windows import Batching, workers
from vlp16emu.errors import RunError
from vlp16emu.extras.accuracy.compare import Detections, Errors, compare, errors_of
from vlp16emu.extras.accuracy.converged import apart_m, joined
from vlp16emu.extras.accuracy.curve import Accuracy, Kind, Row
from vlp16emu.extras.accuracy.sample import TIMED_SEQUENCES, Bench, Group, opened_windows
from vlp16emu.extras.accuracy.settings import PosesAt, beam_settings, pose_rates
from vlp16emu.raycast.caster import Geometry
from vlp16emu.scenario import Scenario

_RAYS, _TIMES = 4096, 4
"""Sub-rays of an answer: so many, and so many times those of a pulse of the scene."""
_REPEATS = 5
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
        self._detections["another answer"] += pool.map(lambda group: self._answer(geometry, group, poses_at, 1), some)
        for rate in self._pose_rates:
            held = rate.poses_at
            self._detections[rate.name] += pool.map(lambda group, held=held: self._answer(geometry, group, held), some)

    def _answer(self, geometry: Geometry, group: Group, poses_at: PosesAt, number: int = 0) -> Detections:
        return self._bench.answer(geometry, self._bench.aimed(group, poses_at), self._wide, number)

    def time(self, geometry: Geometry, block: Group) -> None:
        """Measure run time of all settings, in turn, so that whatever else goes on meets them alike."""
        bench = self._bench
        few = Group(block.first, min(TIMED_SEQUENCES, block.count))
        firings = bench.aimed(few, bench.unit.motion.poses_at)
        for repeat in range(_REPEATS + 1):
            timed = {setting.name: bench.timed(geometry, firings, setting.beam) for setting in self._beams}
            timed |= {rate.name: (bench.timed_aim(block, rate.poses_at), bench.rays) for rate in self._pose_rates}
            if repeat:  # the first one compiled and warmed up
                for name, (us, rays) in timed.items():
                    self._us[name].append(us)
                    self._rays[name].append(rays)

    def summed(self, scene: str, seed: int) -> Accuracy:
        """Sum all up; two answers differ by the root of two times the error of one."""
        answer = self._errors("another answer", "answer of some")
        return Accuracy(
            scene=scene,
            seed=seed,
            answer_rays=self._bench.rays,
            answer_rmse_m=answer.range_rmse_m / float(np.sqrt(2.0)),
            rows=tuple(self._row(setting.kind, setting.name, "answer", setting.in_use) for setting in self._beams),
            poses=tuple(self._row(Kind.POSE, rate.name, "answer of some", rate.in_use) for rate in self._pose_rates),
        )

    def _row(self, kind: Kind, name: str, answer: str, in_use: bool) -> Row:
        us = np.array(self._us[name]).reshape(-1, _REPEATS).mean(axis=0)
        errors, rays = self._errors(name, answer), float(np.mean(self._rays[name]))
        return Row(kind, name, in_use, errors, float(np.median(us)), float(np.ptp(us)), rays)

    def _errors(self, name: str, answer: str) -> Errors:
        compared = compare(joined(self._detections[answer]), joined(self._detections[name]), self._apart_m)
        return errors_of(compared, self._apart_m)


def measure_accuracy(
    scenario: Scenario, scene: str, *, pulses: int, done: Callable[[float], None] = lambda _: None
) -> Accuracy:
    """Measure errors and run time of beams and poses of a scene, which is called `scene`, for the first of its units.

    Parameters
    ----------
    pulses : looked at, rounded up to whole groups; RunError where none meets anything
    done : called with the share of the work that is done
    """
    parts = assemble(scenario)
    unit = parts.units[0]
    block = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns).block
    ladder = _Ladder(Bench(unit, max(_RAYS, _TIMES * unit.beam.rays)), scenario)
    with workers(os.cpu_count() or 1, "accuracy") as pool:
        for geometry, groups, share in opened_windows(scenario, parts, pulses, pool):
            ladder.look(geometry, groups, pool)
            ladder.time(geometry, Group(groups[0].first // block * block, block))
            done(share)
    summed = ladder.summed(scene, scenario.seed)
    if not (seen := summed.rows[0].errors).returns:
        raise RunError(f"{scene}: none of {seen.pulses} pulses has a return; nothing can be wrong")
    return summed
