"""What all sections of a scenario have in common."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["Angle", "Fraction", "NonNegative", "Positive", "Section"]


class Section(BaseModel):
    """A frozen table of the scenario file; an unknown key or a wrong type is an error."""

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )


Angle = Annotated[float, Field(ge=-180, le=180)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
