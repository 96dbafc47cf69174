"""The caster of a world: Embree where it can be driven, else the plain `embreex` class."""

import logging
from concurrent.futures import Executor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.raycast.embree import EmbreeMissingError, library
from vlp16emu.raycast.slow import PlainCaster
from vlp16emu.types import Firings, Hits, Window, World

_log = logging.getLogger(__name__)


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
    """Make the fast caster, or the plain `embreex` class where the library cannot be driven.

    Parameters
    ----------
    world : describes what is far, and grows the meshes of shapes
    workers : where shapes are grown and built side by side
    """
    try:
        library()
    except EmbreeMissingError as error:
        _log.warning("falling back to the plain embreex class, slower and without instances: %s", error)
        return PlainCaster(world.shape)
    from vlp16emu.raycast.near import EmbreeCaster  # its kernel binds to the library

    return EmbreeCaster(world, workers)
