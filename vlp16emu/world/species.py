"""The species table and the allometry that hangs on it.

Diameters are in cm and heights in m inside the published equations, as their authors wrote them.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["BREAST_HEIGHT_M", "Foliage", "Habit", "Species", "species_table", "taper_radius_m", "tapers"]

Array = NDArray[np.float64]

BREAST_HEIGHT_M = 1.3
"""Where the diameter at breast height is measured, above the ground at the stem's axis."""

_TRUNCATION_CM = 6.9
"""Left truncation of the diameter distributions (Nagel and Biging 1995)."""

_LARGEST_DBH_RATIO = 1.6
"""Largest over quadratic mean diameter of a stand; assumption."""

_TAPER_EXPONENTS = (1, 2, 3, 5, 8, 13, 21, 34)
"""Of the taper polynomial in 1 - z / h (Laasasenaho 1982)."""


@dataclass(frozen=True, slots=True)
class Foliage:
    """One leaf, or one shoot of needles."""

    kind: Literal["leaf", "shoot"]
    """A kite-shaped blade, or two crossed rectangles."""
    length_m: float
    width_m: float
    inclination: Sequence[float]
    """mu and nu of the beta distribution of leaf inclination; none for shoots, which follow their twig."""
    clumping: float
    """One-sided leaf area over the area that is modelled."""
    spread_m: float
    """How far from its twig a leaf sits at most."""


@dataclass(frozen=True, slots=True)
class Habit:
    """How a crown branches. Pairs are [crown base, crown top], straight between them."""

    base_fraction: float
    """Crown radius at the crown base over the largest."""
    widest_at: float
    """Relative height in the crown where it is widest."""
    top_power: float
    """Above that the radius falls as 1 - s^top_power: 1 is a cone, 2 a paraboloid's half-width."""
    whorl_spacing_m: float
    branches_per_whorl: int
    """1 makes a spiral."""
    rise_deg: Sequence[float]
    """Elevation of a first-order branch where it leaves the stem."""
    droop_deg: Sequence[float]
    """How much its elevation falls towards the tip, in proportion to the way along it."""
    upturn_deg: Sequence[float]
    """How much it rises again, with the cube of the way along it."""
    twig_start: float
    """Share of a first-order branch that is bare."""
    twigs_per_m: float
    twig_angle_deg: float
    """Between a second-order branch and the one that bears it."""
    twig_roll_spread_deg: float
    """Half-range about the horizontal on either side: 90 is all around, small is a comb."""
    twig_length_share: float
    """Length of a second-order branch over that of its bearer."""
    twig_length_m: Sequence[float]
    """Least and greatest length."""
    twig_droop_deg: float


@dataclass(frozen=True, slots=True)
class Species:
    """One row of the species table. Sources stand in `species.toml`, value by value."""

    name: str
    number: int
    """In labels; never changes."""
    scientific_name: str
    height_curve: Sequence[float]
    height_spread: float
    crown_width: Sequence[float]
    crown_base: Sequence[float]
    diameters: Sequence[float]
    taper: Sequence[float]
    leaf_area_index: float
    bark_reflectance: float
    leaf_reflectance: float
    foliage: Foliage
    crown: Habit

    def dbh_quantile_cm(self, probability: Array, mean_dbh_cm: float) -> Array:
        """Quantiles of the left-truncated Weibull distribution of a stand's diameters, before scaling.

        Parameters
        ----------
        probability : (n,) in [0, 1)
        mean_dbh_cm : quadratic mean diameter that the distribution is meant for

        Source: Nagel and Biging (1995).
        """
        a0, a1, c0, c1, c2 = self.diameters
        scale = a0 + a1 * mean_dbh_cm
        shape = c0 + c1 * mean_dbh_cm + c2 * _LARGEST_DBH_RATIO * mean_dbh_cm
        floor = (_TRUNCATION_CM / scale) ** shape
        quantile: Array = scale * (floor - np.log1p(-probability)) ** (1 / shape)
        return quantile

    def height_m(self, dbh_cm: Array, mean_dbh_cm: float, mean_height_m: float) -> Array:
        """Height by the uniform height curve through (mean_dbh_cm, mean_height_m), Nagel (1999)."""
        a, b = self.height_curve
        exponent = a * (1 - mean_dbh_cm / dbh_cm) + b * (1 / mean_dbh_cm - 1 / dbh_cm)
        height: Array = BREAST_HEIGHT_M + (mean_height_m - BREAST_HEIGHT_M) * np.exp(exponent)
        return height

    def crown_width_m(self, dbh_cm: Array) -> Array:
        """Crown width, Doebbeler et al. (2002)."""
        c0, c1 = self.crown_width
        return c0 + c1 * dbh_cm

    def crown_base_m(self, dbh_cm: Array, height_m: Array, top_height_m: float) -> Array:
        """Height of the lowest living branch; `top_height_m` is that of the stand's thickest trees."""
        q0, q1, q2, q3 = self.crown_base
        exponent = np.abs(q0 + q1 * height_m / dbh_cm + q2 * dbh_cm + q3 * np.log(top_height_m))
        base: Array = height_m * -np.expm1(-exponent)
        return base


@cache
def species_table() -> dict[str, Species]:
    """All species by name, in the order of the table."""
    text = resources.files("vlp16emu.world").joinpath("species.toml").read_text(encoding="utf-8")
    return {name: _species(name, row) for name, row in tomllib.loads(text).items()}


def _species(name: str, row: dict[str, Any]) -> Species:
    """One table of the file."""
    foliage, crown = Foliage(**row.pop("foliage")), Habit(**row.pop("crown"))
    return Species(name=name, foliage=foliage, crown=crown, **row)


def tapers(numbers: NDArray[np.uint16]) -> Array:
    """Taper coefficients by species number, (n, 8)."""
    rows = {species.number: species.taper for species in species_table().values()}
    return np.array([rows[int(number)] for number in numbers]).reshape(-1, 8)


def taper_radius_m(taper: Array, dbh_m: Array, height_m: Array, above_ground_m: Array) -> Array:
    """Stem radius over bark, scaled so that it is half the DBH at breast height.

    Parameters
    ----------
    taper : (n, 8) coefficients of the species of each stem
    dbh_m, height_m : (n,)
    above_ground_m : (n, r) heights; below ground the radius stays that at the ground

    Returns
    -------
    (n, r) metres, 0 at the tip

    Source: Laasasenaho (1982).
    """
    relative = np.clip(1 - above_ground_m / height_m[:, None], 0.0, 1.0)
    breast = 1 - BREAST_HEIGHT_M / height_m
    shape = sum(taper[:, i, None] * relative**e for i, e in enumerate(_TAPER_EXPONENTS))
    at_breast = sum(taper[:, i] * breast**e for i, e in enumerate(_TAPER_EXPONENTS))
    radius: Array = (dbh_m / 2 / at_breast)[:, None] * shape
    return radius
