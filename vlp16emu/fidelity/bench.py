"""Pulses of one sensor, told in several ways and timed."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.assembly import Unit
from vlp16emu.fidelity.answer import answer_beam, some_firings, some_hits, told
from vlp16emu.fidelity.sample import Group
from vlp16emu.fidelity.settings import PosesAt
from vlp16emu.raycast import Footprint, Scene
from vlp16emu.report.accuracy import Told
from vlp16emu.returns import detect
from vlp16emu.types import Firings

__all__ = ["Bench"]


@dataclass(frozen=True, slots=True)
class Bench:
    """Tells pulses of a unit."""

    unit: Unit
    rays: int
    """Sub-rays of an answer."""

    @property
    def limits_m(self) -> tuple[NDArray[np.float64], float]:
        """Where each laser's light begins, (L,), and where it is given up."""
        return self.unit.head.beams.near_m, self.unit.section.max_range_m

    def aimed(self, group: Group, poses_at: PosesAt) -> Firings:
        """Aim the sequences of a group, neighbours included."""
        return self.unit.head.aim(group.first, group.count, poses_at, across=True)

    def told(self, scene: Scene, firings: Firings, own: slice, beam: Footprint) -> Told:
        """Cast pulses, and tell what an exact receiver makes of some of the sequences."""
        hits = scene.cast(firings, *self.limits_m, beam)
        lasers, exact = np.arange(firings.t_ns.shape[1]), self.unit.detector.without_chance()
        part = some_firings(firings, own, lasers), some_hits(hits, own, lasers)
        return told(*part, scene.surfaces, exact)

    def answer(self, scene: Scene, firings: Firings, own: slice, beam: Footprint, number: int = 0) -> Told:
        """Tell the answer for some of the sequences.

        Parameters
        ----------
        beam : says how wide light is
        number : tells answers with different sub-rays apart
        """
        part = some_firings(firings, own, np.arange(firings.t_ns.shape[1]))
        light = answer_beam(beam, self.rays, self.unit.seed, number)
        return self.told(scene, part, slice(0, own.stop - own.start), light)

    def timed(self, scene: Scene, firings: Firings, beam: Footprint) -> tuple[float, float]:
        """Cast and detect as a run does: microseconds per pulse on one core, and rays per pulse."""
        began_s = time.thread_time()
        hits = scene.cast(firings, *self.limits_m, beam)
        detect(firings, hits, scene.surfaces, self.unit.detector, truth=False)
        return 1e6 * (time.thread_time() - began_s) / firings.t_ns.size, float(hits.count.mean())

    def timed_aim(self, block: Group, poses_at: PosesAt) -> float:
        """Pose and aim as a run does: microseconds per pulse on one core."""
        began_s = time.thread_time()
        firings = self.unit.head.aim(block.first, block.count, poses_at, across=self.unit.beam.has_width)
        return 1e6 * (time.thread_time() - began_s) / firings.t_ns.size
