"""Gusts over a stand, and the response of trees that bend in them.

Both are sums of spectral lines, for any time. A gust is a sum of cosines of time with the energies of
Kaimal's spectrum. It is carried downwind with the mean speed (Taylor's frozen turbulence). Each line also has
a random wave number across the wind, drawn from a Cauchy distribution, which gives Davenport's exponential
coherence across the wind. A damped oscillator responds to a cosine with a cosine, so its state at any time is
also a sum and no time steps are needed.

A tree bends as a cantilever of its own taper under the drag on its crown, in one mode: the curve of the
static deflection (`vlp16emu.forest.plants.bending`). All of it moves level, by the curve at its height;
branches and leaves ride on the stem. So the foot stays, and level sections keep their area. The sides of a
crown neither rise nor fall. Saplings and everything under the trees stay still. Beyond `world.near_m` stems
bend likewise; leaves there are drawn anew for each voxel of 0.5 m and stay where they are, as a crown's own
movement, mostly below a voxel, only chooses other gaps of the same law.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, power, sin, tan
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.foliage.tiles import TiledWindow
from vlp16emu.forest.plants.allometry import taper_radius_m
from vlp16emu.forest.plants.bending import SHARES, STEPS, bent
from vlp16emu.forest.plants.species import Flora, tapers
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.settings import Season, Wind
from vlp16emu.forest.stand.forest import ForestWorld
from vlp16emu.forest.stand.stand import REGENERATION
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.random import generator
from vlp16emu.types import F8, I8, Sway, Window

Stand = NDArray[np.void]
ALONG, ACROSS = 0, 1  # components of the gusts' speed: along the mean wind, and horizontally to its left
_LINES = 256
_SLOWEST = 0.003  # reduced frequency (f L / U) below which one line represents the rest: 1.2 % of the energy
_FASTEST_HZ = 5.0  # frequency above which one line represents the rest: no tree follows it
_DEVIATION = 1.0, 0.8
"""Standard deviations of the components along and across the wind, relative to the first."""
_LENGTH = (1.0, 2.7 / 8.1)  # their length scales, likewise (IEC 61400-1 ed. 3, table B.1)
_DECAY = 10.0
"""Decay of the coherence exp(-decay * frequency * distance / speed) across the wind; 8 to 16 have been
measured (Davenport, Q J R Meteorol Soc 87, 1961; Simiu and Scanlan, Wind Effects on Structures)."""
KNOT_NS = 100_000_000
"""Time between knots, with linear motion in between. A tree that sways with amplitude A at f is then off by
up to A (2 pi f KNOT_NS)^2 / 8, 0.3 % of A at 0.25 Hz, 1.2 % at 0.5 Hz, and with faster gusts up to 2.2 times
as much. The cost of opening a window grows with the number of knots."""
_AIR_KG_M3 = 1.2
_FRICTION_SHARE = 0.3
"""Friction velocity over mean speed at the top of a canopy (Raupach, Finnigan and Brunet, Boundary-Layer
Meteorol 78, 1996, table 1: 1 / 3.3)."""
_SHELTERED = 0.2  # drag on a tree of a lower storey over the drag on an equal tree of the canopy; assumption
_BARE = 0.4  # drag on a crown without leaves over the drag with leaves; assumption
_IN_LEAF = 0.8
"""Frequency of a broadleaved tree in leaf over a conifer's of its size. Leaves lower it (Jackson et al.,
J R Soc Interface 16, 20190116, 2019); the amount is an assumption."""
_GREEN_WOOD_KG_M3 = 900.0  # density of stems with bark and sap; assumption, fresh logs have 700 to 1100
_CROWN_MASS = 0.3
"""Mass of branches and leaves over the stem's (IPCC Good Practice Guidance 2003, table 3A.1.10: biomass
expansion factors of 1.3 for conifers, 1.4 for broadleaved trees)."""
_THINNEST = 0.1
"""Least diameter over the DBH with which a stem bends, so that its tip is no hook: twigs and needles stiffen
the leader; assumption."""
_ROOM = 0.5
"""Limit of a top's movement over the crown's width: crowns clash with their neighbours, which takes half of
the energy of swaying trees (Milne, Tree Physiol 9, 1991); the amount is an assumption."""
_HIGHEST_BASE = (
    0.95  # greatest height of a crown's base over the tree's for its drag, for trees without crown
)
_ASIDE_M = 3.0
"""Distance beyond `world.near_m` and the crown's width at whose feet no face of a tree is met: what a sensor
strays from its track, and what stems lean and bend."""


class Lines(NamedTuple):
    """Spectral lines of one component of the gusts."""

    omega_rad_s: F8  # (n,).
    speed_m_s: F8  # (n,) amplitude
    phase_rad: F8  # (n,) at the origin of the world when the run begins
    aside_rad_m: F8  # (n,) phase gradient to the left of the wind


class Trees(NamedTuple):
    """Oscillators."""

    omega_rad_s: F8  # (m,) undamped natural frequencies
    damping_ratio: float  # share of critical damping
    downwind_m: F8  # (m,) positions along the wind
    aside_m: F8  # (m,) positions to the left of it


def gust_lines(section: Wind, seed: int, component: int) -> Lines:
    """Lines of a component; the squares of their amplitudes add up to twice the variance of the spectrum.

    Kaimal's spectrum with integral length L at mean speed U: f S / sigma^2 = 4 n / (1 + 6 n)^(5/3), n = f L /
    U (IEC 61400-1 ed. 3, equation B.14; Kaimal et al., Q J R Meteorol Soc 98, 1972); the share of its energy
    up to n is 1 - (1 + 6 n)^(-2/3).
    """
    rng = generator(seed, Growth.WIND, component)
    per_n_hz = section.speed_m_s / (section.gust_length_m * _LENGTH[component])
    slowest_hz = _SLOWEST * per_n_hz
    fastest_hz = max(_FASTEST_HZ, 10.0 * per_n_hz)
    edges_hz = slowest_hz * power(fastest_hz / slowest_hz, np.arange(_LINES) / (_LINES - 1))
    share = 1.0 - power(1.0 + 6.0 * edges_hz / per_n_hz, -2.0 / 3.0)
    energy = np.diff(np.concatenate([[0.0], share[:-1], [1.0]]))
    # Unevenly spaced, so that the sum is not periodic.
    between = np.append(0.0, rng.uniform(size=_LINES - 1))
    hz = edges_hz * power(np.append(1.0, edges_hz[:-1] / edges_hz[1:]), between)
    sigma_m_s = section.turbulence_intensity * _DEVIATION[component] * section.speed_m_s
    waves = tan(np.pi * (rng.uniform(size=_LINES) - 0.5))
    return Lines(
        2.0 * np.pi * hz,
        sigma_m_s * np.sqrt(2.0 * energy),
        rng.uniform(0.0, 2.0 * np.pi, _LINES),
        _DECAY * hz / section.speed_m_s * waves,
    )


def swings(lines: Lines, speed_m_s: float, trees: Trees, t_s: F8) -> F8:
    """Response (k, m) of oscillators to gusts, in m/s, at times (k,) since the run began.

    Each is the steady-state solution y of y'' + 2 z w y' + w^2 y = w^2 u with the gusts u at its position.
    """
    turned = lines.omega_rad_s[:, None] * t_s
    out = np.zeros((len(trees.omega_rad_s), len(t_s)))
    _follow(lines, 1.0 / speed_m_s, trees, cos(turned), sin(turned), out)
    return out.T


@array_kernel
def _follow(lines: Lines, s_per_m: float, trees: Trees, cosine: F8, sine: F8, out: F8) -> None:
    """Fill (m, k), line after line, so that each value is independent of other trees and times."""
    for tree in range(len(out)):
        motion = out[tree]
        for line in range(len(lines.omega_rad_s)):
            omega = lines.omega_rad_s[line]
            ratio = omega / trees.omega_rad_s[tree]
            still = 1.0 - ratio * ratio
            lag = 2.0 * trees.damping_ratio * ratio
            phase = (
                lines.phase_rad[line]
                - omega * s_per_m * trees.downwind_m[tree]
                + lines.aside_rad_m[line] * trees.aside_m[tree]
            )
            # The gust's cosine over the complex number still + i lag.
            x, y = cos(phase), sin(phase)
            scale = lines.speed_m_s[line] / (still * still + lag * lag)
            a = scale * (still * x + lag * y)
            b = scale * (still * y - lag * x)
            for k in range(len(motion)):
                motion[k] += a * cosine[line, k] - b * sine[line, k]


class Mechanics(NamedTuple):
    """How n trees bend."""

    frequency_hz: F8  # (n,) undamped natural frequencies
    top_m_per_pa: F8  # (n,) static movement of the top per shear stress on the canopy
    curve: F8  # (n, STEPS + 1) movement over the top's, as from `bent`


def mechanics(trees: Stand, plants: Flora, season: Season) -> Mechanics:
    """Return how trees (n,) bend.

    Frequency: 0.0766 + 3.1219 DBH / height^2, in cm and m (Moore and Maguire, Trees 18, 195-203, 2004; 602
    conifers), lower in leaf. Drag: the canopy absorbs the wind's shear stress, each tree over the ground
    under its crown (the roughness method of Gardiner, Peltola and Kellomaki, Ecol Modell 129, 2000); along
    the crown it falls linearly to 0 at the tip, as the width of a cone, and so does the crown's mass.
    Stiffness: the value that gives the masses of stem and crown, moved along the curve, that frequency.
    """
    foliage = {species.number: species.foliage for species in plants.trees.values()}
    kinds = np.array(
        [getattr(foliage[number], "kind", "dead") for number in trees["species"].tolist()], "<U8"
    )
    in_leaf = (kinds == "leaf") & (season == "leaf_on")
    bare = (kinds != "shoot") & ~in_leaf
    dbh_m = trees["dbh_m"]
    height_m = trees["height_m"]
    frequency_hz = (0.0766 + 3.1219 * 100.0 * dbh_m / np.square(height_m)) * np.where(in_leaf, _IN_LEAF, 1.0)
    at_m = height_m[:, None] * SHARES
    radius_m = taper_radius_m(tapers(trees, table=plants.trees), dbh_m, height_m, at_m)
    in_crown = at_m >= np.minimum(trees["crown_base_m"], _HIGHEST_BASE * height_m)[:, None]
    load = np.where(in_crown, 1.0 - SHARES, 0.0)
    load /= load.sum(axis=1)[:, None]
    curve = bent(np.maximum(radius_m, _THINNEST / 2 * dbh_m[:, None]), load)
    stem_kg = _GREEN_WOOD_KG_M3 * np.pi * np.square(radius_m) * (height_m / STEPS)[:, None]
    crown_kg = _CROWN_MASS * stem_kg.sum(axis=1)
    mode_kg = ((stem_kg + crown_kg[:, None] * load) * np.square(curve)).sum(axis=1)
    drag_m2 = np.pi / 4 * np.square(trees["crown_width_m"]) * np.where(bare, _BARE, 1.0)
    drag_m2 *= np.where(trees["storey"] > 0, _SHELTERED, 1.0)
    force_m2 = drag_m2 * (load * curve).sum(axis=1)
    return Mechanics(frequency_hz, force_m2 / (mode_kg * np.square(2.0 * np.pi * frequency_hz)), curve)


class TreeSway:
    """Moves the trees of windows; the motion of a tree at a time is the same in every window.

    The wind's speed must exceed 0; the run's first pulse is at `start_ns`.
    """

    def __init__(self, section: Wind, *, forest: ForestWorld, start_ns: int) -> None:
        self._section = section
        self._forest = forest
        self._start_ns = start_ns
        towards = math.radians(section.towards_deg)
        east, north = cos(towards), sin(towards)
        self._axes = np.array([[east, north], [-north, east]])
        self._lines = [gust_lines(section, forest.seed, component) for component in (ALONG, ACROSS)]

    def mechanics(self, trees: Stand) -> Mechanics:
        """Return how trees (m,) of the forest bend."""
        return mechanics(trees, self._forest.plants, self._forest.section.season)

    def top_m(self, trees: Stand, t_ns: I8) -> F8:
        """Return the movement (k, m, 2) of the tops of trees (m,), east and north, at UTC times (k,).

        Drag grows with the square of the speed; the mean and the term linear in the gusts are kept.
        Neighbours hold a crown that moves far.
        """
        frequency_hz, top_m_per_pa, _ = self.mechanics(trees)
        along_m, across_m = (trees["x_m"] * east + trees["y_m"] * north for east, north in self._axes)
        oscillators = Trees(2.0 * math.pi * frequency_hz, self._section.damping_ratio, along_m, across_m)
        mean_m_s = self._section.speed_m_s
        t_s = np.asarray((t_ns - self._start_ns) * 1e-9, np.float64)
        along, across = (swings(lines, mean_m_s, oscillators, t_s) for lines in self._lines)
        per_speed2 = _AIR_KG_M3 * _FRICTION_SHARE * _FRICTION_SHARE * top_m_per_pa
        downwind = per_speed2 * mean_m_s * (mean_m_s + 2.0 * along)
        aside = per_speed2 * mean_m_s * across
        limit_m = _ROOM * trees["crown_width_m"]
        held = 1.0 / np.sqrt(1.0 + (downwind * downwind + aside * aside) / (limit_m * limit_m))
        east, north = (held * (downwind * a + aside * b) for a, b in self._axes.T)
        return np.stack([east, north], axis=-1)

    def with_sway(self, window: Window, track_m: F8, start_ns: int, stop_ns: int) -> Window:
        """Return the window around positions (n, 3) with the sway of its trees over a span, UTC."""
        assert isinstance(window, TiledWindow)  # forests have no others
        trees = self._forest.trees(track_m)
        trees = trees[trees["storey"] != REGENERATION]
        trees = trees[np.argsort(trees["id"], kind="stable")]
        foot_m = np.column_stack([trees["x_m"], trees["y_m"]])
        reach_m = self._forest.near_m + _ASIDE_M + trees["crown_width_m"]
        near = distance_m(foot_m, track_m[:, :2]) <= reach_m
        window = self._forest.with_loose_stems(window, trees["id"][near])
        instance = window.surfaces["instance"][window.first_surface]
        placement = np.flatnonzero(np.isin(instance, trees["id"]))
        rows = np.searchsorted(trees["id"], instance[placement])
        # Knots are at the same times in all windows.
        first, last = (start_ns - self._start_ns) // KNOT_NS, -((self._start_ns - stop_ns) // KNOT_NS)
        t_ns = self._start_ns + KNOT_NS * np.arange(first, last + 1)
        sway = Sway(
            int(t_ns[0]),
            KNOT_NS,
            placement,
            trees["z_m"][rows].copy(),
            trees["height_m"][rows].astype(np.float64),
            self.mechanics(trees).curve[rows],
            self.top_m(trees, t_ns)[:, rows],
        )
        return replace(window, sway=sway)
