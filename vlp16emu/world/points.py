"""Where stems stand: a hard-core point pattern that fills the plane tile by tile.

Matern's second process: candidates fall like rain (Poisson), each with a random priority, and a
candidate survives if none of higher priority lies within the hard-core distance. Whether it survives
depends on its surroundings only, so a tile needs no more than its neighbours' candidates: no edge,
no order of growing. Source: Matern (1960), Spatial variation; Chiu, Stoyan, Kendall, Mecke,
Stochastic Geometry and its Applications, 3rd ed., section 5.4.
"""

import math

import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, generator
from vlp16emu.world.tiles import TILE_M

__all__ = ["HardCore"]

Array = NDArray[np.float64]

_SPACING_SHARE = 0.4
"""Hard-core distance over 1 / sqrt(density); assumption, gives a Clark-Evans index near 1.25."""

_LARGEST_DISTANCE_M = 5.0
"""Trees farther apart than this do not keep each other away; assumption."""


class HardCore:
    """Points of a given density, none nearer to another than a hard-core distance.

    Parameters
    ----------
    seed : of the scenario
    per_ha : mean number of points per hectare after thinning
    """

    def __init__(self, *, seed: int, per_ha: float) -> None:
        density = per_ha / 10_000
        self.distance_m = min(_SPACING_SHARE / math.sqrt(density), _LARGEST_DISTANCE_M) if density else 0.0
        area = math.pi * self.distance_m**2
        # Density after thinning is (1 - exp(-intensity * area)) / area; solved for the intensity.
        intensity = -math.log1p(-density * area) / area if density else 0.0
        self._per_tile = intensity * TILE_M**2
        self._seed = seed

    def candidates(self, ix: int, iy: int) -> Array:
        """Candidates of one tile: (n, 3) with x and y in m, and a priority in [0, 1), low is high."""
        rng = generator(self._seed, Purpose.STAND, ix, iy)
        candidates = rng.random((rng.poisson(self._per_tile), 3))
        candidates[:, :2] = (candidates[:, :2] + (ix, iy)) * TILE_M
        return candidates

    def survive(self, ix: int, iy: int) -> NDArray[np.bool_]:
        """Which candidates of a tile become points: (n,)."""
        own = self.candidates(ix, iy)
        around = [self.candidates(ix + i, iy + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        rivals = np.concatenate(around)
        dx, dy = (own[:, None, axis] - rivals[:, axis] for axis in (0, 1))
        beaten = (dx * dx + dy * dy < self.distance_m**2) & (rivals[:, 2] < own[:, None, 2])
        alone: NDArray[np.bool_] = np.logical_not(beaten.any(axis=1))
        return alone
