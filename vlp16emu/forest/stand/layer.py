"""Things of one kind, scattered over the ground tile by tile."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vlp16emu.forest.plants.flora import Flora
from vlp16emu.forest.plants.settings import Season
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.stand.floor_shapes import GROUND_KINDS, FloorKind
from vlp16emu.forest.stand.placed import PlacedThings, Site
from vlp16emu.forest.stand.points import PointPattern
from vlp16emu.random import generator


@dataclass(frozen=True, slots=True)
class LayerKind:
    """How the things of a section of a scene are made."""

    name: str  # key of the section
    purpose: Growth  # what draws them
    draws: tuple[int, ...]  # how many numbers each thing draws, together
    lay: Callable[..., PlacedThings]  # from the layer, the site, places (n, 2) and those numbers (n, draws) to things
    shape: FloorKind | None = None  # of what covers the ground
    spread: float = 1.0  # its width over its height, which for a tuft is that of its shape already; assumption
    reach_m: float = math.inf
    """How far from the path it is: farther off the beam is wider than such a plant; assumption."""

    @property
    def is_ground(self) -> bool:
        """Whether it is part of the ground: without numbers, and too low to be seen from afar."""
        return self.shape in GROUND_KINDS


@dataclass(frozen=True, slots=True)
class Layer:
    """Things of one kind that grow or lie on the ground."""

    section: Any  # what the user wrote
    kind: LayerKind
    species: Sequence[Any]  # of the plants that they are or were
    season: Season
    plants: Flora
    pattern: PointPattern  # their places, before those on the path and in trunks are left out

    def place(self, site: Site) -> PlacedThings:
        """Things of a tile, a function of the site alone."""
        near = site.distance_m < self.kind.reach_m
        xy_m = self.pattern.points(site.ix, site.iy) if near else np.zeros((0, 2))
        rng = generator(site.seed, self.kind.purpose, site.ix, site.iy, 1)
        return self.kind.lay(self, site, xy_m, *(rng.random((len(xy_m), count)) for count in self.kind.draws))
