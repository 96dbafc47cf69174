"""A few pulses of a run held against their converged answer while it goes on.

Of each block of firing sequences, eight consecutive ones of two lasers are drawn: 0.05 % of a VLP-16's pulses.
The hits of the run itself are judged, so nothing is posed or cast twice but the answers. Which pulses are drawn
follows from the seed and the block, so neither threads nor order matter, and nothing of the run is touched.
"""

import threading
from typing import Self

import numpy as np

from vlp16emu.engine import Job, Unit
from vlp16emu.engine.windows import Batching
from vlp16emu.extras.accuracy.compare import MISTAKES, Tally, compare
from vlp16emu.extras.accuracy.converged import answer_beam, apart_m, detections_of, some_firings, some_hits
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.caster import Geometry
from vlp16emu.run.report import AuditFinding
from vlp16emu.scenario import Scenario
from vlp16emu.types import Firings, Hits

_SEQUENCES, _LASERS = 8, 2
_RAYS, _TIMES = 512, 4
"""Sub-rays of an answer: so many, and so many times those of a pulse. With 512, what is left is a fifth of the error
of pulses of 64, and 1/20 of that of one ray."""
_SAMPLED = ("fixed", "adaptive")


class Audit:
    """Looks at the blocks of a run, from any number of threads; nothing to look at where a pulse is one ray by the scene's own choice."""

    def __init__(self, apart_m: float, *, exact: bool) -> None:
        self._apart_m = apart_m
        self.exact = exact
        self._lock = threading.Lock()
        self.tally = Tally()
        """What was found so far, of all units."""

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """Make the audit of a run."""
        return cls(apart_m(scenario.detector), exact=scenario.beam.model not in _SAMPLED)

    @property
    def finding(self) -> AuditFinding:
        """What was found so far."""
        tally = self.tally
        lost, invented, other = (getattr(tally, name) / tally.returns if tally.returns else None for name in MISTAKES)
        low_m, high_m = tally.range_rmse_interval_m or (None, None)
        return AuditFinding(self.exact, tally.pulses, tally.range_rmse_m, low_m, high_m, lost, invented, other)

    def __call__(self, job: Job, firings: Firings, hits: Hits, geometry: Geometry) -> None:
        """Look at blocks, whole or in parts: what their pulses met, in the scene that they were cast against."""
        if self.exact:
            return
        unit = job.unit
        block, index = Batching(firings.t_ns.shape[1], unit.head.beams.sequence_ns).block, firings.index
        for begin in range(index // block * block, index + len(firings.t_ns), block):
            self._look(unit, firings, hits, geometry, begin, block)

    def _look(self, unit: Unit, firings: Firings, hits: Hits, geometry: Geometry, begin: int, sequences: int) -> None:
        """Look at the place of the block that begins with sequence `begin`, where it is among those that were cast."""
        lasers = firings.t_ns.shape[1]
        draw = generator(unit.seed, Purpose.AUDIT, unit.number, begin)
        first = begin + _SEQUENCES * int(draw.integers(sequences // _SEQUENCES)) - firings.index
        if not 0 <= first < len(firings.t_ns):
            return
        chosen = np.sort(draw.choice(lasers, min(_LASERS, lasers), replace=False))
        rows = slice(first, first + _SEQUENCES)
        part, exact = some_firings(firings, rows, chosen), unit.detector.without_chance()
        rays = max(_RAYS, _TIMES * unit.beam.rays)
        answer = geometry.cast(
            part, unit.head.beams.near_m[chosen], unit.section.max_range_m, answer_beam(unit.beam, rays, unit.seed)
        )
        compared = compare(
            detections_of(part, answer, geometry.surfaces, exact),
            detections_of(part, some_hits(hits, rows, chosen), geometry.surfaces, exact),
            self._apart_m,
        )
        with self._lock:
            self.tally.add(compared)
