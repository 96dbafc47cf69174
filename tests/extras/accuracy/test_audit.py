"""The audit beside a run."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.engine import Engine
from vlp16emu.engine.windows import Batching
from vlp16emu.extras.accuracy import Audit
from vlp16emu.extras.accuracy.audit import Tally, apart_m, compare, errors_of
from vlp16emu.extras.accuracy.sweep import Bench, draw_groups, joined
from vlp16emu.scenario import load

BLOCK_S = 1920 * 55_296e-9


@pytest.fixture(scope="module")
def hall():
    """The hall by four sub-rays a pulse."""
    return load("static_bench", ["beam.model='fixed'", "beam.rays=4"])


def digest(packets):
    return hashlib.sha256(b"".join(packet.payload for packet in packets)).hexdigest()


def test_an_audit_changes_no_byte_and_depends_on_no_thread(hall):
    """With an audit, on one thread or three, the packets are those without; and the audits find the same."""
    audits = [Audit.of(hall), Audit.of(hall)]
    found = {
        digest(Engine.of(hall, threads=threads, taps=[audit] if audit else []).packets(0.0, 10 * BLOCK_S))
        for threads, audit in ((1, audits[0]), (3, audits[1]), (2, None))
    }
    assert len(found) == 1
    assert audits[0].tally == audits[1].tally
    assert audits[0].tally.pulses == 10 * 16


def test_where_a_pulse_is_one_ray_nothing_is_looked_at():
    """A scene that chose one ray per pulse has no audit answers, and its report calls it exact."""
    scenario = load("static_bench")
    audit = Audit.of(scenario)
    list(Engine.of(scenario, taps=[audit]).packets(0.0, 0.01))
    assert audit.exact
    assert audit.tally == Tally()
    assert (audit.tally.range_rmse_m, audit.tally.range_rmse_interval_m) == (None, None)


def test_audits_estimate_the_error_that_accuracy_measures(hall):
    """Ten audits with different seeds together find the RMSE that is found on pulses of accuracy's own."""
    audits, scenes = [Audit.of(hall) for _ in range(10)], []

    def look(job, firings, hits, scene):
        scenes.append(scene)
        for seed, audit in enumerate(audits):
            audit(replace(job, unit=replace(job.unit, seed=seed)), firings, hits, scene)

    emulator = Engine.of(hall, taps=[look])
    list(emulator.returns(0.0, 60 * BLOCK_S))
    unit = emulator.parts.units[0]
    bench, poses_at = Bench(unit, 128), unit.motion.poses_at
    ((_, groups),) = draw_groups(Batching(16, 55_296), 60, 16_384, 1, moves=False)
    aimed = [bench.aimed(group, poses_at) for group in groups]
    answer = joined([bench.answer(scenes[0], pulses, unit.beam) for pulses in aimed])
    returns = joined([bench.detections(scenes[0], pulses, unit.beam) for pulses in aimed])
    measured_m = errors_of(compare(answer, returns, apart_m(hall.detector)), apart_m(hall.detector)).range_rmse_m
    squares_um2, matched = (sum(getattr(audit.tally, of) for audit in audits) for of in ("squares_um2", "matched"))
    assert 1e-6 * np.sqrt(squares_um2 / matched) == pytest.approx(measured_m, rel=0.15)
    assert len({audit.tally.range_rmse_m for audit in audits}) == 10, "audits draw pulses of their own"
