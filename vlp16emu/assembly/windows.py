"""From the world and the ways of the sensors through it to its windows."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vlp16emu.assembly.parts import Parts
from vlp16emu.pipeline import Cut, Windows
from vlp16emu.raycast import Scene, caster

__all__ = ["windows_of"]


def windows_of(parts: Parts, start_ns: int, cut: Cut, threads: int) -> Windows[Scene]:
    """Make the windows of a run, the same for all units; one serves all stretches where nothing moves.

    Parameters
    ----------
    start_ns : UTC of the first pulse
    cut : of the run
    threads : workers, which each unit may have
    """
    built = caster(parts.world.shape, ThreadPoolExecutor(threads, "build"))

    def open_stretch(stretch: int) -> Scene:
        """Open what is within reach of a stretch of the walk."""
        edges_ns = start_ns + cut.edges_ns(stretch)
        tracks_m = [unit.motion.poses_at(edges_ns).world_p_body_m for unit in parts.units]
        return built.open(parts.world.window(np.concatenate(tracks_m)))

    return Windows(open_stretch, cut, moves=any(unit.motion.moves for unit in parts.units), threads=threads)
