"""Published equations of tree form, by their names in the species table.

Units inside the equations are the authors': cm and m, or inches and feet.
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from vlp16emu.elementary import exp, expm1, log, log1p, power
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.settings import ExpectationError, Section
from vlp16emu.types import F8

Coefficients = tuple[float, ...]

BREAST_HEIGHT_M = 1.3  # height of the diameter at breast height above the ground at the stem's axis
US_BREAST_HEIGHT_M = 1.37  # the same in North America: 4.5 ft
_INCH_CM = 2.54
_FOOT_M = 0.3048
_TRUNCATION_CM = 6.9  # left truncation of the diameter distributions (Nagel and Biging 1995)
_LARGEST_DBH_RATIO = 1.6  # largest over quadratic mean diameter of a stand; assumption
_STUMP_SHARE = 0.01  # stump height over tree height, as in Vonderach and Kaendler (2021)
_CROWN_BASE_DBH_CM = 120.0
"""Greatest DBH in the square of the crown ratio equation, which would bring the crown of a thicker tree down
to the ground; assumption."""
_COMPONENT_TERMS = 8  # coefficients of one component of `components` biomass


def truncated_weibull_cm(coefficients: Coefficients, probability: F8, mean_dbh_cm: float) -> F8:
    """Quantiles of a stand's diameters before scaling to their quadratic mean.

    Left-truncated Weibull, Nagel and Biging (1995).
    """
    a0, a1, c0, c1, c2 = coefficients
    scale = a0 + a1 * mean_dbh_cm
    shape = c0 + c1 * mean_dbh_cm + c2 * _LARGEST_DBH_RATIO * mean_dbh_cm
    floor = power(_TRUNCATION_CM / scale, shape)
    return scale * power(floor - log1p(-probability), 1 / shape)


def _uniform_height_m(coefficients: Coefficients, dbh_cm: F8, mean_dbh_cm: float, mean_height_m: float) -> F8:
    """Uniform height curve through (mean_dbh_cm, mean_height_m), Nagel (1999); coefficients a, b."""
    a, b = coefficients
    exponent = a * (1 - mean_dbh_cm / dbh_cm) + b * (1 / mean_dbh_cm - 1 / dbh_cm)
    return BREAST_HEIGHT_M + (mean_height_m - BREAST_HEIGHT_M) * exp(exponent)


def _curtis_arney_height_m(
    coefficients: Coefficients, dbh_cm: F8, mean_dbh_cm: float, mean_height_m: float
) -> F8:
    """Curtis-Arney curve of heights, stretched to the mean tree.

    Source: Forest Vegetation Simulator, `htdbh`; P2, P3 and P4 are for inches and feet.

    Below 3 inches, where the equation is not valid, a straight line leads to breast height.
    """
    p2, p3, p4 = coefficients
    dbh_in = np.append(dbh_cm, mean_dbh_cm) / _INCH_CM
    above_breast_ft = p2 * exp(-p3 * power(np.maximum(dbh_in, 3.0), p4)) * np.minimum(dbh_in / 3.0, 1.0)
    return BREAST_HEIGHT_M + (mean_height_m - BREAST_HEIGHT_M) * (above_breast_ft[:-1] / above_breast_ft[-1])


def _bechtold_crown_width_m(coefficients: Coefficients, dbh_cm: F8) -> F8:
    """Crown width of forest-grown trees, Bechtold (2003), in inches and feet.

    Its parameters are a1, a2, a3, a4; the crown ratio is in percent. It is proportional to diameter below 5
    inches and constant above 50 inches, as in the Forest Vegetation Simulator.
    """
    a1, a2, a3, a4, crown_ratio_percent = coefficients
    dbh_in = np.clip(dbh_cm / _INCH_CM, 5.0, 50.0)
    width_ft = a1 + a2 * dbh_in + a3 * np.square(dbh_in) + a4 * crown_ratio_percent
    return width_ft * np.minimum(dbh_cm / _INCH_CM / 5.0, 1.0) * _FOOT_M


def _logistic_crown_base(
    coefficients: Coefficients, dbh_cm: F8, height_m: F8, larger_m2_per_ha: F8, ccf_percent: F8
) -> F8:
    """Logit of the crown base's relative height, Hasenauer and Monserud (1996); a, b1, b2, b3, c1, c2."""
    a, b1, b2, b3, c1, c2 = coefficients
    measured_cm = np.minimum(dbh_cm, _CROWN_BASE_DBH_CM)
    size = a + b1 * 100 * height_m / dbh_cm + b2 * height_m + b3 * np.square(measured_cm)
    return size + c1 * larger_m2_per_ha + c2 * log(np.maximum(ccf_percent, 1.0))


def _component_biomass_kg(
    coefficients: Coefficients, dbh_cm: F8, height_m: F8, upper_cm: F8, base_m: F8
) -> F8:
    """Sum of components a + b d^c h^d u^e s^f k^g (d h)^h.

    Here u is the diameter at 0.3 h, s the stump, k the crown base. A negative component, such as coarse wood
    of saplings, counts as 0. Source: Vonderach et al. (2018), 10.1007/s13595-018-0728-4, coefficients of
    Vonderach and Kaendler (2021).
    """
    total = np.zeros_like(dbh_cm)
    for a, b, c, d, e, f, g, h in np.reshape(coefficients, (-1, _COMPONENT_TERMS)):
        size = power(dbh_cm, c) * power(height_m, d) * power(upper_cm, e) * power(base_m, g)
        size *= power(dbh_cm * height_m, h) * power(_STUMP_SHARE * height_m, f)
        total += np.maximum(a + b * size, 0.0)
    return total


class Equation(Section):
    """An equation by name, with its coefficients."""

    equations: ClassVar[Mapping[str, tuple[int, Any]]]
    """Number of coefficients, and function of the coefficients and the arguments, by equation."""

    model: str
    coefficients: Annotated[Coefficients, Field(strict=False)]

    @field_validator("coefficients")
    @classmethod
    def _check_count(cls, coefficients: Coefficients, info: ValidationInfo) -> Coefficients:
        model = info.data.get("model")  # absent if it is itself in error
        if model is not None and len(coefficients) != cls.equations[model][0]:
            raise ExpectationError(f"{cls.equations[model][0]} numbers for {model!r}")
        return coefficients

    def __call__(self, *values: Any) -> F8:
        """Value of the equation."""
        return self.equations[self.model][1](self.coefficients, *values)


class HeightCurve(Equation):
    """Tree height as a function of diameter in cm, through a stand's mean diameter and mean height."""

    equations: ClassVar = {"uniform": (2, _uniform_height_m), "curtis_arney": (3, _curtis_arney_height_m)}
    model: Literal["uniform", "curtis_arney"]


class CrownWidth(Equation):
    """Crown width of forest-grown trees as a function of diameter in cm."""

    equations: ClassVar = {
        # c0, c1 and c0, c1, c2, c3 of Doebbeler et al. (2002): a straight line, and a line with less width
        # for thin trees.
        "linear": (2, lambda c, dbh_cm: c[0] + c[1] * dbh_cm),
        "saturating": (4, lambda c, dbh_cm: (c[0] + c[1] * dbh_cm) * -expm1(-power(dbh_cm / c[2], c[3]))),
        "bechtold": (5, _bechtold_crown_width_m),
    }
    model: Literal["linear", "saturating", "bechtold"]


class CrownBase(Equation):
    """Logit of the relative height of the lowest living branch.

    Arguments are diameters in cm, heights, the basal area of larger trees in m2 per ha, and the crown
    competition factor in percent: the sum of the crown projections that all trees would have if open-grown,
    over the ground area.
    """

    equations: ClassVar = {
        "logistic": (6, _logistic_crown_base),
        # The crown ratio, if it is the same for all trees.
        "ratio": (1, lambda c, dbh_cm, *_: np.broadcast_to(log(1 / c[0] - 1), np.shape(dbh_cm))),
    }
    model: Literal["logistic", "ratio"]


class Biomass(Equation):
    """Dry mass above ground.

    It follows from diameters in cm, heights, diameters at 0.3 of the height, and crown base heights.
    """

    equations: ClassVar = {
        # b0, b1: Jenkins et al. (2003), Forest Science 49(1), table 4; b0, b1, b2: the form of Smith et al.
        # (2014).
        "log_diameter": (2, lambda b, dbh_cm, *_: exp(b[0] + b[1] * log(dbh_cm))),
        "power": (3, lambda b, dbh_cm, height_m, *_: b[0] * power(dbh_cm, b[1]) * power(height_m, b[2])),
        "components": (6 * _COMPONENT_TERMS, _component_biomass_kg),
    }
    model: Literal["log_diameter", "power", "components"]


class Taper(Equation):
    """Taper of a stem."""

    equations: ClassVar = {"laasasenaho": (8, None), "brink": (3, None)}  # see `_form`
    model: Literal["laasasenaho", "brink"]
    flare: Annotated[tuple[float, float], Field(strict=False)] = (0.0, 1.0)
    """Butt swell: relative extra radius at the ground, and the height over which it falls by a factor of e
    over the height of the root flare."""
    top_share: Annotated[float, Field(ge=0.1, le=1)] = 1.0
    """Height of the stem over its unbroken height: 1, or less if the top has broken off."""

    @property
    def row(self) -> F8:
        """Row (13,) for `Species.taper_rows`; the last number, a tree's own, is 0."""
        row = np.zeros(13)
        row[:4] = self.model == "brink", self.top_share, *self.flare
        row[4 : 4 + len(self.coefficients)] = self.coefficients
        return row


@array_kernel
def _form(row: F8, height_m: float, above_ground_m: float) -> float:
    """Relative stem radius, to be scaled to the DBH; 0 at the tip of the unbroken stem."""
    unbroken_m = height_m / row[1]
    z = min(max(above_ground_m, 0.0), unbroken_m)
    if row[0] == 0:
        # Laasasenaho (1982): exponents 1, 2, 3, 5, 8, 13, 21, 34 of the relative distance from the tip.
        # Each exponent is the sum of the two before, so each power is the product of the two before.
        power_before = power_now = 1.0 - z / unbroken_m
        form = row[4] * power_now
        for i in range(5, 12):
            power_before, power_now = power_now, power_before * power_now
            form += row[i] * power_now
    else:
        # Brink's function as in Schmidt (2001), with a radius of 1 at breast height.
        i_share = row[4]
        p = row[5]
        q = row[6]
        top = 1.0 - exp(q * (1.3 - unbroken_m))
        butt = 1.0 - exp(p * (1.3 - unbroken_m))
        # Two terms, exactly 1 at breast height and 0 at the tip.
        form = i_share * ((1.0 - exp(q * (z - unbroken_m))) / top)
        form += (1.0 - i_share) * (1.0 - (1.0 - exp(p * (1.3 - z))) / butt)
    if row[2] > 0:
        form *= 1.0 + row[2] * exp(-z / row[3])
    return max(form, 0.0)


@array_kernel
def _radii(taper: F8, dbh_m: F8, height_m: F8, above_ground_m: F8) -> F8:
    out = np.empty_like(above_ground_m)
    for i in range(len(dbh_m)):
        breast = _form(taper[i], height_m[i], 1.3)
        own_taper = taper[i, 12]
        for j, z in enumerate(above_ground_m[i]):
            share = _form(taper[i], height_m[i], z) / breast
            if own_taper != 0 and share > 0:
                share *= exp(own_taper * log(share))
            out[i, j] = dbh_m[i] / 2 * share
    return out


def taper_radius_m(taper: F8, dbh_m: F8, height_m: F8, above_ground_m: F8) -> F8:
    """Radius (n, r) over bark of stems (n,) at heights (n, r), half the DBH at breast height.

    `taper` (n, 13) is the row of `Species.taper_rows` of each stem. Its last number t is the tree's own:
    the curve's ratio of the radius to the radius at breast height is raised to the power 1 + t, so a
    greater t tapers more. Below ground the radius is constant; at the tip it is 0 unless the top has broken
    off. Sources: Laasasenaho (1982), Schmidt (2001).
    """
    dbh_m = np.ascontiguousarray(dbh_m)
    height_m = np.ascontiguousarray(height_m)
    return _radii(taper, dbh_m, height_m, np.ascontiguousarray(above_ground_m))
