"""Casters, and the choice between one of faces alone and one with a far medium."""

import math
from concurrent.futures import Executor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.doors import door
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.types import F8, Firings, Hits, Window, World


class Geometry(Protocol):
    """A window ready to be cast against."""

    @property
    def surfaces(self) -> NDArray[np.void]:
        """(m,) `SURFACE`, the window's table."""

    def cast(self, firings: Firings, near_m: F8, far_m: float, beam: Footprint = LINE, *, as_far: bool = False) -> Hits:
        """Cast the pulses of k sequences, k a multiple of 8; `as_far` casts what is near as the medium too, where there is one."""


class Caster(Protocol):
    """Opens windows of the world for casting."""

    def open(self, window: Window) -> Geometry:
        """Make a window ready for casting."""


def caster(world: World, workers: Executor) -> Caster:
    """Make the caster of a world: of faces alone, or with what the door "far" has.

    Raises
    ------
    EmbreeMissingError : where the library cannot be loaded
    """
    # Kernels bind to the library as soon as they are loaded, and a world that has nothing far needs none for it.
    if math.isinf(world.near_m):
        from vlp16emu.raycast.near import EmbreeCaster

        return EmbreeCaster(world, workers)
    far: Caster = door("far")(world, workers)
    return far
