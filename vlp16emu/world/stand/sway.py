"""Trees in the wind: each a damped oscillator about its foot, driven by the gusts at its place.

A tree sways as one straight piece: it is sheared, every point moved level in proportion to its height over the
foot. So the foot stays, level sections keep their area, DBH that of the record, and a transform holds it all. A
real stem bends: by a straight lean breast height moves 1.3 m / height as far as the tip, by a cantilever under a
load at its tip about 3/2 (1.3 m / height)^2. Saplings and all that grows or lies under the trees stay still.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import Sway, Window
from vlp16emu.world.plants.allometry import taper_radius_m
from vlp16emu.world.plants.flora import Flora, tapers
from vlp16emu.world.stand.forest import ForestWorld
from vlp16emu.world.stand.gusts import ACROSS, ALONG, Trees, gust_lines, swings
from vlp16emu.world.stand.settings import Season, Wind
from vlp16emu.world.stand.stand import REGENERATION

__all__ = ["KNOT_NS", "Mechanics", "TreeSway", "mechanics"]

Array = NDArray[np.float64]
Stand = NDArray[np.void]

KNOT_NS = 100_000_000
"""Between two knots trees move straight on. A tree that swings with amplitude A at f is then off by up to
A (2 pi f KNOT_NS)^2 / 8, 0.3 % of A at 0.25 Hz, 1.2 % at 0.5 Hz; gusts quicker than it made that up to 2.2 times as much. What a window costs to open grows with the number of knots."""

_AIR_KG_M3 = 1.2
_FRICTION_SHARE = 0.3
"""Friction velocity over mean speed at the top of a canopy (Raupach, Finnigan and Brunet, Boundary-Layer Meteorol
78, 1996, table 1: 1 / 3.3)."""
_SHELTERED = 0.2
"""Drag on a tree of a lower storey over that on one of the canopy with such a crown; assumption."""
_BARE = 0.4
"""Drag on a crown without leaves over that with leaves; assumption."""

_IN_LEAF = 0.8
"""Frequency of a broadleaved tree in leaf over that of a conifer of its size. That leaves lower it: Jackson et al.,
J R Soc Interface 16, 20190116, 2019; by how much: assumption."""

_GREEN_WOOD_KG_M3 = 900.0
"""Of stems with bark and sap; assumption, fresh logs have 700 to 1100."""
_CROWN_MASS = 0.3
"""Branches and leaves over the stem (IPCC Good Practice Guidance 2003, table 3A.1.10: biomass expansion factors of
1.3 for conifers, 1.4 for broadleaved trees)."""
_SECTIONS = 16


@dataclass(frozen=True, slots=True)
class Mechanics:
    """How n trees answer the wind."""

    frequency_hz: Array
    """(n,) undamped, of the first swing."""
    lean_per_stress: Array
    """(n,) lean, as a tangent, for each Pa of the wind's shear stress on the canopy."""


def mechanics(trees: Stand, plants: Flora, season: Season) -> Mechanics:
    """Derive frequency and stiffness of trees from their size.

    Frequency: 0.0766 + 3.1219 DBH / height^2, in cm and m (Moore and Maguire, Trees 18, 195-203, 2004; 602
    conifers), lower in leaf. Drag: the canopy takes up the wind's shear stress, each tree on the ground under its
    crown and halfway up the crown (the roughness method of Gardiner, Peltola and Kellomaki, Ecol Modell 129,
    2000). Stiffness: what gives the mass of stem and crown that frequency about the foot.
    """
    foliage = {species.number: species.foliage for species in plants.trees.values()}
    kinds = [foliage[number] for number in trees["species"].tolist()]
    sheds = np.array([kind is not None and kind.kind == "leaf" for kind in kinds], np.bool_)
    in_leaf = sheds & (season == "leaf_on")
    bare = np.array([kind is None for kind in kinds], np.bool_) | (sheds & ~in_leaf)
    dbh_m, height_m, base_m = trees["dbh_m"], trees["height_m"], trees["crown_base_m"]
    frequency_hz = (0.0766 + 3.1219 * 100.0 * dbh_m / height_m**2) * np.where(in_leaf, _IN_LEAF, 1.0)
    middle_m = (base_m + height_m) / 2
    share = (np.arange(_SECTIONS) + 0.5) / _SECTIONS
    at_m = height_m[:, None] * share
    radius_m = taper_radius_m(tapers(trees["species"], table=plants.trees), dbh_m, height_m, at_m)
    pieces_kg = _GREEN_WOOD_KG_M3 * np.pi * radius_m**2 * (height_m / _SECTIONS)[:, None]
    inertia_kg_m2 = (pieces_kg * at_m**2).sum(axis=1) + _CROWN_MASS * pieces_kg.sum(axis=1) * middle_m**2
    drag_m2 = np.pi / 4 * trees["crown_width_m"] ** 2 * np.where(bare, _BARE, 1.0)
    drag_m2 *= np.where(trees["storey"] > 0, _SHELTERED, 1.0)
    return Mechanics(frequency_hz, drag_m2 * middle_m / (inertia_kg_m2 * (2.0 * np.pi * frequency_hz) ** 2))


class TreeSway:
    """Moves the trees of windows; the same tree at the same time in the same way, whatever window it is in.

    Parameters
    ----------
    section : what the user wrote; its speed is more than 0
    forest : of the trees, each with a shape of its own
    season : whether broadleaves bear leaves
    start_ns : UTC of the run's first pulse
    """

    def __init__(self, section: Wind, *, forest: ForestWorld, season: Season, start_ns: int) -> None:
        self._section, self._forest = section, forest
        self._season, self._start_ns = season, start_ns
        towards = math.radians(section.towards_deg)
        east, north = math.cos(towards), math.sin(towards)
        self._axes = np.array([[east, north], [-north, east]])
        self._lines = [gust_lines(section, forest.seed, component) for component in (ALONG, ACROSS)]

    def shear(self, trees: Stand, t_ns: NDArray[np.int64]) -> Array:
        """Lean of trees (m,) at UTC times (k,): (k, m, 2) metres east and north per metre over the foot.

        Drag grows with the square of the speed, of which the mean and what is linear in the gusts are kept.
        """
        own = mechanics(trees, self._forest.plants, self._season)
        along_m, across_m = (trees["x_m"] * east + trees["y_m"] * north for east, north in self._axes)
        swinging = Trees(2.0 * math.pi * own.frequency_hz, self._section.damping_ratio, along_m, across_m)
        mean = self._section.speed_m_s
        t_s = np.asarray((t_ns - self._start_ns) * 1e-9, np.float64)
        along, across = (swings(lines, mean, swinging, t_s) for lines in self._lines)
        per_speed2 = _AIR_KG_M3 * _FRICTION_SHARE**2 * own.lean_per_stress
        downwind = per_speed2 * mean * (mean + 2.0 * along)
        aside = per_speed2 * mean * across
        east, north = (downwind * a + aside * b for a, b in self._axes.T)
        return np.stack([east, north], axis=-1)

    def blown(self, window: Window, track_m: Array, start_ns: int, stop_ns: int) -> Window:
        """Give a window, that of positions (n, 3), the motion of its trees over a span of UTC."""
        trees = self._forest.trees(track_m)
        trees = trees[trees["storey"] != REGENERATION]
        trees = trees[np.argsort(trees["id"])]
        instance = window.surfaces["instance"][window.first_surface]
        placement = np.flatnonzero(np.isin(instance, trees["id"]))
        which = np.searchsorted(trees["id"], instance[placement])
        # Knots lie at the same times for all windows, whatever these are cut at.
        first, last = (start_ns - self._start_ns) // KNOT_NS, -((self._start_ns - stop_ns) // KNOT_NS)
        t_ns = self._start_ns + KNOT_NS * np.arange(first, last + 1)
        shear = self.shear(trees, t_ns)[:, which]
        return replace(window, sway=Sway(int(t_ns[0]), KNOT_NS, placement, trees["z_m"][which].copy(), shear))
