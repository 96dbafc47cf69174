"""From the world and the ways of the sensors through it to its windows."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vlp16emu.assembly.parts import Parts
from vlp16emu.pipeline import Cut, Windows
from vlp16emu.raycast import Scene, caster
from vlp16emu.types import Window

__all__ = ["window_of", "windows_of"]


def window_of(parts: Parts, start_ns: int, cut: Cut, stretch: int) -> Window:
    """Give what is within reach of a stretch of the walk; the arguments are those of `windows_of`."""
    edges_ns = start_ns + cut.edges_ns(stretch)
    tracks_m = [unit.motion.poses_at(edges_ns).world_p_body_m for unit in parts.units]
    track_m = np.concatenate(tracks_m)
    window = parts.world.window(track_m)
    return parts.wind.blown(window, track_m, int(edges_ns[0]), int(edges_ns[-1])) if parts.wind else window


def windows_of(parts: Parts, start_ns: int, cut: Cut, threads: int) -> Windows[Scene]:
    """Make the windows of a run, the same for all units; one serves all stretches where nothing moves.

    Parameters
    ----------
    start_ns : UTC of the first pulse
    cut : of the run
    threads : workers, which each unit may have
    """
    built = caster(parts.world, ThreadPoolExecutor(threads, "build"))

    def open_stretch(stretch: int) -> Scene:
        """Open what is within reach of a stretch of the walk."""
        return built.open(window_of(parts, start_ns, cut, stretch))

    return Windows(open_stretch, cut, moves=parts.moves, threads=threads)
