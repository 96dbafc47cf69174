"""How things that the user describes throw light back: as a white wall does in part, or as a reflector."""

import math
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from vlp16emu.settings import Fraction, Section

__all__ = ["Finish", "PartFinish"]

_KEYS = frozenset({"reflectance", "retroreflection_cd_lx_m2"})


class PartFinish(Section):
    """Finish of a part, which is that of the whole unless one of these keys is given."""

    either_or: ClassVar[frozenset[str]] = _KEYS

    reflectance: Fraction | None = None
    """Lambertian, at 903 nm."""
    retroreflection_cd_lx_m2: Annotated[float, Field(ge=1, le=1000)] | None = None
    """Coefficient of retroreflection, instead of `reflectance`: least values of ASTM D4956 for new white sheeting are 70
    of type I, 250 of type III and 700 of type VIII. Assumptions: at 903 nm it is as in visible light, and it falls with the
    cosine of incidence."""

    @model_validator(mode="after")
    def _told_once(self) -> Self:
        """Refuse a finish that is told twice."""
        if self.retroreflection_cd_lx_m2 is not None and "reflectance" in self.model_fields_set:
            raise ValueError("reflectance or retroreflection_cd_lx_m2 in it, not both")
        return self

    @property
    def brightness(self) -> float | None:
        """How bright it is at right angles, of a white Lambertian surface; None where nothing is told."""
        if self.retroreflection_cd_lx_m2 is None:
            return self.reflectance
        return math.pi * self.retroreflection_cd_lx_m2  # a white Lambertian surface has 1 / pi


class Finish(PartFinish):
    """Finish of a thing."""

    reflectance: Fraction = 0.5
    """Lambertian, at 903 nm."""

    @property
    def brightness(self) -> float:
        """How bright it is at right angles, of a white Lambertian surface: above 1 a retroreflector."""
        told = super().brightness
        return self.reflectance if told is None else told
