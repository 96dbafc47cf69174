"""Errors of settings on a sample of a run's pulses, and what each setting costs."""

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vlp16emu.accuracy.compare import Errors, Told, compare, errors_of
from vlp16emu.accuracy.converged import GROUP, Bench, Group, apart_m, draw_groups, joined
from vlp16emu.accuracy.curve import Accuracy, Kind, Rounding, Row
from vlp16emu.accuracy.precision import NOTHING_MET, rounding_of
from vlp16emu.accuracy.settings import PosesAt, holds, lights
from vlp16emu.chain import assemble, window_of
from vlp16emu.chain.windows import Cut
from vlp16emu.errors import RunError
from vlp16emu.raycast.caster import Scene, caster
from vlp16emu.scenario import Scenario
from vlp16emu.units import S_NS, seconds_to_ns

__all__ = ["measure_accuracy"]

_RAYS, _TIMES = 4096, 4
"""Sub-rays of an answer: so many, and so many times those of a pulse of the scene."""
_REPEATS = 5
_TIMED_SEQUENCES = 96
"""On which run time is measured in each window: then calls cost below a tenth of a ray each."""
_POSED = 4
"""Every fourth group tells errors of poses and of the answer itself, for answers cost."""


class _Ladder:
    """All settings on one bench, looked at window by window."""

    def __init__(self, bench: Bench, scenario: Scenario) -> None:
        self._bench, self._apart_m = bench, apart_m(scenario.detector)
        self._lights, self._holds = lights(scenario, bench.unit.seed), holds(bench.unit)
        self._wide = next(light.beam for light in self._lights if light.kind is Kind.FIXED)
        self._told = defaultdict[str, list[Told]](list)
        self._us, self._rays = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)

    def look(self, scene: Scene, groups: Sequence[Group], workers: ThreadPoolExecutor) -> None:
        """Tell the groups of one window in all ways."""
        bench, poses_at = self._bench, self._bench.unit.motion.poses_at
        answers = list(workers.map(lambda group: self._answer(scene, group, poses_at), groups))
        self._told["answer"] += answers
        for light in self._lights:
            told = self._told[light.name]
            for group in groups:
                told.append(bench.told(scene, bench.aimed(group, poses_at), light.beam))
        self._told["answer of some"] += answers[::_POSED]
        some = groups[::_POSED]
        self._told["another answer"] += workers.map(
            lambda group: self._answer(scene, group, poses_at, 1), some
        )
        for hold in self._holds:
            held = hold.poses_at
            self._told[hold.name] += workers.map(
                lambda group, held=held: self._answer(scene, group, held), some
            )

    def _answer(self, scene: Scene, group: Group, poses_at: PosesAt, number: int = 0) -> Told:
        """Tell the answer for a group."""
        return self._bench.answer(scene, self._bench.aimed(group, poses_at), self._wide, number)

    def time(self, scene: Scene, block: Group) -> None:
        """Measure run time of all settings, in turn, so that whatever else goes on meets them alike."""
        bench = self._bench
        few = Group(block.first, min(_TIMED_SEQUENCES, block.count))
        firings = bench.aimed(few, bench.unit.motion.poses_at)
        for repeat in range(_REPEATS + 1):
            timed = {light.name: bench.timed(scene, firings, light.beam) for light in self._lights}
            timed |= {hold.name: (bench.timed_aim(block, hold.poses_at), bench.rays) for hold in self._holds}
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
            rows=tuple(self._row(light.kind, light.name, "answer", light.in_use) for light in self._lights),
            poses=tuple(
                self._row(Kind.POSE, hold.name, "answer of some", hold.in_use) for hold in self._holds
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
        """Hold what was told in one way against an answer."""
        compared = compare(joined(self._told[answer]), joined(self._told[name]), self._apart_m)
        return errors_of(compared, self._apart_m)


def measure_accuracy(
    scenario: Scenario, scene: str, *, pulses: int, done: Callable[[float], None]
) -> Accuracy:
    """Measure errors and run time of the settings of a scene, for the first of its units.

    Parameters
    ----------
    scene : what it is called
    pulses : looked at, rounded up to whole groups
    done : told the simulated seconds up to which the run was looked at

    Raises
    ------
    RunError
        where none of the pulses meets anything
    """
    parts = assemble(scenario)
    unit = parts.units[0]
    cut = Cut(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns)
    blocks = len(cut.blocks(0, seconds_to_ns(min(scenario.duration_s, unit.motion.run_time_s))))
    bench = Bench(unit, max(_RAYS, _TIMES * unit.beam.rays))
    ladder = _Ladder(bench, scenario)
    nearest_m, farthest_m = bench.limits_m
    rounding = NOTHING_MET
    with ThreadPoolExecutor(os.cpu_count() or 1, "accuracy") as workers:
        built = caster(parts.world, workers)
        for stretch, groups in draw_groups(cut, blocks, pulses, unit.seed, moves=parts.moves):
            window = window_of(parts, scenario.start_ns, cut, stretch)
            opened = built.open(window)  # only now is the one before let go: shapes of both are built once
            ladder.look(opened, groups, workers)
            ladder.time(opened, Group(groups[0].first // cut.block * cut.block, cut.block))
            firings = bench.aimed(groups[0], unit.motion.poses_at)
            if not rounding.rays:
                faces_m = min(farthest_m, parts.world.near_m)  # beyond there are no faces to be met again
                rounding = rounding_of(opened, window, parts.world.shape, firings, nearest_m, faces_m)
            done((groups[-1].first + GROUP) * cut.sequence_ns / S_NS)
    summed = ladder.summed(scene, scenario.seed, rounding)
    if not (seen := summed.rows[0].errors).returns:
        raise RunError(f"{scene}: none of {seen.pulses} pulses has a return; nothing can be wrong")
    return summed
