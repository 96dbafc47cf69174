"""Pulses of one sensor, told in several ways and timed."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.assembly import Unit
from vlp16emu.fidelity.answer import answer_beam, told
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
        """Aim the sequences of a group."""
        return self.unit.head.aim(group.first, group.count, poses_at, across=True)

    def told(self, scene: Scene, firings: Firings, beam: Footprint) -> Told:
        """Cast pulses, and tell what an exact receiver makes of them."""
        hits = scene.cast(firings, *self.limits_m, beam)
        return told(firings, hits, scene.surfaces, self.unit.detector.without_chance())

    def answer(self, scene: Scene, firings: Firings, beam: Footprint, number: int = 0) -> Told:
        """Tell the answer for some pulses.

        Parameters
        ----------
        beam : says how wide light is
        number : tells answers with different sub-rays apart
        """
        return self.told(scene, firings, answer_beam(beam, self.rays, self.unit.seed, number))

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
