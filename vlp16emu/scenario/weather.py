"""The `[weather]` table: what is in the air."""

from typing import Annotated

from pydantic import Field

from vlp16emu.settings import Section

__all__ = ["Weather"]


class Weather(Section):
    """Clear air unless something is given."""

    visibility_m: Annotated[float, Field(ge=10, le=100_000)] | None = None
    """Meteorological visibility; fog below 1000 m, haze below 10 km."""
    rain_mm_h: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Rate of rain: 2.5 light, 10 heavy, 50 violent."""

    @property
    def summary(self) -> str | None:
        """What is in the air in one line; None where it is clear."""
        told = []
        if self.visibility_m is not None:
            told.append(f"visibility {self.visibility_m:g} m")
        if self.rain_mm_h:
            told.append(f"rain of {self.rain_mm_h:g} mm/h")
        return ", ".join(told) or None
