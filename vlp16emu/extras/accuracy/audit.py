"""A few pulses of a run compared with their converged answer while it goes on.

Of each block of firing sequences, eight consecutive ones of two lasers are drawn: 0.05 % of a VLP-16's pulses.
The hits of the run itself are judged, so that only the answers are cast. Which pulses are drawn follows from the
seed and the block, so neither threads nor order matter, and nothing of the run is touched.
"""

import threading
from dataclasses import dataclass
from typing import Self

import numpy as np

from vlp16emu.engine import Job, Unit
from vlp16emu.engine.windows import Batching
from vlp16emu.extras.accuracy.compare import MISTAKES, Tally, compare
from vlp16emu.extras.accuracy.sample import answer_beam, apart_m, detections_of
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.caster import Geometry
from vlp16emu.scenario import Scenario
from vlp16emu.types import I8, Firings, Hits

_SEQUENCES, _LASERS = 8, 2
_RAYS, _TIMES = 512, 4
"""Sub-rays of an answer: at least the first, and the second times those of a pulse. With 512, what is left is a fifth of
the error of pulses of 64, and 1/20 of that of one ray."""
_SAMPLED = ("fixed", "adaptive")


@dataclass(frozen=True, slots=True)
class AuditFinding:
    """Error of a run, estimated from pulses that are cast again; shares are of returns, None if not known."""

    exact: bool
    """A pulse is one ray, by the scene's own choice."""
    pulses: int
    """Pulses cast again."""
    range_rmse_m: float | None
    range_rmse_low_m: float | None
    """Lower end of the 95 % confidence interval of the error."""
    range_rmse_high_m: float | None
    lost: float | None
    invented: float | None
    other_echo: float | None
    """Share whose strongest return is another echo."""


class Audit:
    """Audit of a run, called from any number of threads; without effect if the scene itself chose one ray per pulse."""

    def __init__(self, apart_m: float, *, exact: bool) -> None:
        self._apart_m = apart_m
        self.exact = exact
        self._lock = threading.Lock()
        self.tally = Tally()
        """Errors so far, of all units."""

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Make the audit of a run."""
        return cls(apart_m(scenario.detector), exact=scenario.beam.model not in _SAMPLED)

    @property
    def finding(self) -> AuditFinding:
        """Result so far."""
        tally = self.tally
        lost, invented, other = (getattr(tally, name) / tally.returns if tally.returns else None for name in MISTAKES)
        low_m, high_m = tally.range_rmse_interval_m or (None, None)
        return AuditFinding(self.exact, tally.pulses, tally.range_rmse_m, low_m, high_m, lost, invented, other)

    def __call__(self, job: Job, firings: Firings, hits: Hits, geometry: Geometry) -> None:
        """Audit the pulses of whole or partial blocks, in the geometry that they were cast against."""
        if self.exact:
            return
        unit = job.unit
        block, index = Batching(firings.t_ns.shape[1], unit.head.beams.sequence_ns).block, firings.index
        for begin in range(index // block * block, index + len(firings.t_ns), block):
            self._look(unit, firings, hits, geometry, begin, block)

    def _look(self, unit: Unit, firings: Firings, hits: Hits, geometry: Geometry, begin: int, sequences: int) -> None:
        """Audit the drawn pulses of the block that begins with sequence `begin`, if they are among those that were cast."""
        lasers = firings.t_ns.shape[1]
        draw = generator(unit.seed, Purpose.AUDIT, unit.number, begin)
        first = begin + _SEQUENCES * int(draw.integers(sequences // _SEQUENCES)) - firings.index
        if not 0 <= first < len(firings.t_ns):
            return
        chosen = np.sort(draw.choice(lasers, min(_LASERS, lasers), replace=False))
        rows = slice(first, first + _SEQUENCES)
        part, exact = _some_firings(firings, rows, chosen), unit.detector.without_chance()
        beam = answer_beam(unit.beam, max(_RAYS, _TIMES * unit.beam.rays), unit.seed)
        answer = geometry.cast(part, unit.head.beams.near_m[chosen], unit.section.max_range_m, beam)
        found = _some_hits(hits, rows, chosen)
        detected, judged = (detections_of(part, of, geometry.surfaces, exact) for of in (answer, found))
        compared = compare(detected, judged, self._apart_m)
        with self._lock:
            self.tally.add(compared)


def _some_firings(firings: Firings, rows: slice, lasers: I8) -> Firings:
    """Return some lasers of some consecutive sequences."""
    arrays = {name: getattr(firings, name)[rows] for name in ("clock_ns", "reading_deg")}
    for name in ("t_ns", "azimuth_deg", "origin_m", "direction", "beam_axis"):
        of = getattr(firings, name)
        arrays[name] = None if of is None else np.ascontiguousarray(of[rows][:, lasers])
    return Firings(index=firings.index + rows.start, **arrays)


def _some_hits(hits: Hits, rows: slice, lasers: I8) -> Hits:
    """Return the hits of some lasers of some consecutive sequences."""
    own, before = hits.count[rows], int(hits.count[: rows.start].sum())
    stop = before + np.cumsum(own, dtype=np.int64).reshape(own.shape)
    count = np.ascontiguousarray(own[:, lasers])
    last = stop[:, lasers].reshape(-1)
    first = last - count.reshape(-1)
    rays = np.concatenate([np.arange(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True)])
    return Hits(count, hits.range_m[rays], hits.surface[rays], hits.cos_incidence[rays])
