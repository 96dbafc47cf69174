"""Errors and run time of settings of the beam and of held poses, on a sample of a run's pulses."""

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, NamedTuple

import numpy as np

from vlp16emu.engine import Unit, assemble, beam_of
from vlp16emu.engine.windows import Batching, workers
from vlp16emu.errors import RunError
from vlp16emu.extras.accuracy.compare import Detections, Errors, compare, errors_of
from vlp16emu.extras.accuracy.curve import Accuracy, Kind, Row
from vlp16emu.extras.accuracy.sample import TIMED_SEQUENCES, Bench, PosesAt, apart_m, joined, opened_windows
from vlp16emu.packets import SEQUENCES_PER_PACKET
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.caster import Geometry
from vlp16emu.scenario import Scenario
from vlp16emu.types import I8, Poses, ReturnMode

Model = Literal["adaptive", "fixed", "none", "angle", "offset"]

_COUNTS = (4, 8, 16, 32, 64, 128)
_TIMES_TARGET = (0.25, 0.5, 1.0, 2.0, 4.0)  # targets of adaptive beams, over that of the scene
_RAYS, _TIMES = 4096, 4  # sub-rays of an answer: at least the first, and the second times those of a pulse of the scene
_REPEATS = 5
_POSED = 4  # every fourth group measures errors of poses and of the answer itself, as answers are costly


class BeamSetting(NamedTuple):
    """A setting of the beam."""

    kind: Kind
    name: str  # as `--set` takes it
    in_use: bool
    beam: Footprint


class PoseRate(NamedTuple):
    """A rate at which pulses get new poses."""

    name: str
    in_use: bool
    poses_at: PosesAt


def beam_settings(scenario: Scenario, seed: int) -> list[BeamSetting]:
    """List one ray, the paper's beam errors, fixed counts and adaptive targets, the scene's own among them."""
    section = scenario.beam
    counts = sorted({*_COUNTS, section.rays} if section.model == "fixed" else _COUNTS)
    targets_m = sorted({min(times * section.target_m, 1.0) for times in _TIMES_TARGET}, reverse=True)

    def setting(kind: Kind, model: Model, **own: float) -> BeamSetting:
        changed = section.model_copy(update={"model": model, **own})
        name = " ".join([f"beam.model={model}", *(f"beam.{key}={value:.4g}" for key, value in own.items())])
        beam = beam_of(scenario.model_copy(update={"beam": changed}), seed)
        return BeamSetting(kind, name, changed == section, beam)

    return [
        setting(Kind.ONE_RAY, "none"),
        setting(Kind.BEAM_ERROR, "angle"),
        setting(Kind.BEAM_ERROR, "offset"),
        *(setting(Kind.FIXED, "fixed", rays=count) for count in counts),
        *(setting(Kind.ADAPTIVE, "adaptive", target_m=target_m) for target_m in targets_m),
    ]


def pose_rates(unit: Unit) -> list[PoseRate]:
    """List a pose per pulse, per firing sequence and per packet; nothing if the sensor stands still."""
    if not unit.motion.moves:
        return []
    sequence_ns, start_ns = unit.head.beams.sequence_ns, unit.head.start_ns
    packet_ns = SEQUENCES_PER_PACKET[ReturnMode(unit.section.return_mode)] * sequence_ns
    poses_at, holds_ns = unit.motion.poses_at, {"firing sequence": sequence_ns, "packet": packet_ns}
    held = [PoseRate(f"pose per {what}", False, _held(poses_at, start_ns, ns)) for what, ns in holds_ns.items()]
    return [PoseRate("pose per pulse", in_use=True, poses_at=poses_at), *held]


def _held(poses_at: PosesAt, start_ns: int, hold_ns: int) -> PosesAt:
    """Return poses that hold for `hold_ns` their value at its beginning."""

    def held(t_ns: I8) -> Poses:
        begin_ns, whose = np.unique((t_ns - start_ns) // hold_ns * hold_ns + start_ns, return_inverse=True)
        poses = poses_at(begin_ns)
        return Poses(t_ns, poses.world_R_body[whose], poses.world_p_body_m[whose])

    return held


class _Ladder:
    """All settings on one bench, measured window by window."""

    def __init__(self, bench: Bench, scenario: Scenario) -> None:
        self._bench, self._apart_m = bench, apart_m(scenario.detector)
        self._beams, self._pose_rates = beam_settings(scenario, bench.unit.seed), pose_rates(bench.unit)
        self._wide = next(setting.beam for setting in self._beams if setting.kind is Kind.FIXED)
        self._detections = defaultdict[str, list[Detections]](list)
        self._us, self._rays = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)

    def look(self, geometry: Geometry, groups: Sequence[range], pool: ThreadPoolExecutor) -> None:
        """Detect the groups of one window with all settings."""
        bench, poses_at, some = self._bench, self._bench.unit.motion.poses_at, groups[::_POSED]

        def answers(groups: Sequence[range], poses_at: PosesAt = poses_at, number: int = 0) -> list[Detections]:
            aimed = [bench.aimed(group, poses_at) for group in groups]
            return list(pool.map(lambda firings: bench.answer(geometry, firings, self._wide, number), aimed))

        self._detections["answer"] += (found := answers(groups))
        self._detections["answer of some"] += found[::_POSED]
        self._detections["another answer"] += answers(some, number=1)
        for setting in self._beams:
            for group in groups:
                detections = bench.detections(geometry, bench.aimed(group, poses_at), setting.beam)
                self._detections[setting.name].append(detections)
        for rate in self._pose_rates:
            self._detections[rate.name] += answers(some, rate.poses_at)

    def time(self, geometry: Geometry, block: range) -> None:
        """Measure run time of all settings, in turn, so that other load meets them alike."""
        bench = self._bench
        firings = bench.aimed(block[:TIMED_SEQUENCES], bench.unit.motion.poses_at)
        for repeat in range(_REPEATS + 1):
            timed = {setting.name: bench.timed(geometry, firings, setting.beam) for setting in self._beams}
            timed |= {rate.name: (bench.timed_aim(block, rate.poses_at), bench.rays) for rate in self._pose_rates}
            if repeat:  # the first one compiled and warmed up
                for name, (us, rays) in timed.items():
                    self._us[name].append(us)
                    self._rays[name].append(rays)

    def summed(self, scene: str, seed: int) -> Accuracy:
        """Return all errors and run times; two answers differ by the root of two times the error of one."""
        answer = self._errors("another answer", "answer of some")
        return Accuracy(
            scene=scene,
            seed=seed,
            answer_rays=self._bench.rays,
            answer_rmse_m=answer.range_rmse_m / float(np.sqrt(2.0)),
            rows=distinct([self._row(one.kind, one.name, "answer", one.in_use) for one in self._beams]),
            poses=tuple(self._row(Kind.POSE, rate.name, "answer of some", rate.in_use) for rate in self._pose_rates),
        )

    def _row(self, kind: Kind, name: str, answer: str, in_use: bool) -> Row:
        us = np.array(self._us[name]).reshape(-1, _REPEATS).mean(axis=0)
        errors, rays = self._errors(name, answer), float(np.mean(self._rays[name]))
        return Row(kind, name, in_use, errors, float(np.median(us)), float(np.ptp(us)), rays)

    def _errors(self, name: str, answer: str) -> Errors:
        compared = compare(joined(self._detections[answer]), joined(self._detections[name]), self._apart_m)
        return errors_of(compared, self._apart_m)


def distinct(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Return rows without adaptive settings that cast the same rays as another: the one in use is kept, or the coarsest.

    A beam takes its first eight sub-rays at any target, so coarse targets are one and the same setting.
    """
    kept = dict[object, Row]()
    for row in rows:
        key = (row.errors, row.rays_per_pulse) if row.kind is Kind.ADAPTIVE else row.name
        if row.in_use or key not in kept:
            kept[key] = row
    return tuple(kept.values())


def measure_accuracy(
    scenario: Scenario, scene: str, *, pulses: int, done: Callable[[float], None] = lambda _: None
) -> Accuracy:
    """Measure errors and run time of beams and poses of a scene, which is called `scene`, with the first of its units.

    RunError if no pulse has a return.

    Parameters
    ----------
    pulses : number of pulses, rounded up to whole groups
    done : called with the share of the work that is done
    """
    parts = assemble(scenario)
    unit = parts.units[0]
    block = Batching(len(unit.head.beams.elevation_deg), unit.head.beams.sequence_ns).block
    ladder = _Ladder(Bench(unit, max(_RAYS, _TIMES * unit.beam.rays)), scenario)
    with workers(os.cpu_count() or 1, "accuracy") as pool:
        for geometry, groups, share in opened_windows(scenario, parts, pulses, pool):
            ladder.look(geometry, groups, pool)
            ladder.time(geometry, range(begin := groups[0].start // block * block, begin + block))
            done(share)
    summed = ladder.summed(scene, scenario.seed)
    if not (seen := summed.rows[0].errors).returns:
        raise RunError(f"{scene}: none of {seen.pulses} pulses has a return; nothing can be wrong")
    return summed
