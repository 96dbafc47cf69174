"""Which caster a world gets: one of faces, or one that knows what is far as a medium."""

import math
from concurrent.futures import Executor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.doors import door
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.types import Firings, Hits, Window, World


class Geometry(Protocol):
    """A window ready to be cast against."""

    @property
    def surfaces(self) -> NDArray[np.void]:
        """(m,) `SURFACE`, the window's table."""

    def cast(
        self,
        firings: Firings,
        near_m: NDArray[np.float64],
        far_m: float,
        beam: Footprint = LINE,
        *,
        as_far: bool = False,
    ) -> Hits:
        """Cast the pulses of k sequences, k a multiple of 8; `as_far` casts what is near as the medium too, where there is one."""


class Caster(Protocol):
    """Opens windows of the world for casting."""

    def open(self, window: Window) -> Geometry:
        """Make a window ready for casting."""


def caster(world: World, workers: Executor) -> Caster:
    """Make the caster of a world.

    Parameters
    ----------
    world : grows the meshes of shapes, and describes what is far
    workers : where shapes are grown and built side by side

    Raises
    ------
    EmbreeMissingError
        where the library cannot be loaded
    """
    # Kernels bind to the library as soon as they are loaded, and a world that has nothing far needs none for it.
    if math.isinf(world.near_m):
        from vlp16emu.raycast.near import EmbreeCaster

        return EmbreeCaster(world, workers)
    far: Caster = door("far")(world, workers)
    return far
