"""The `[weather]` table: what is in the air."""

from typing import Annotated

from pydantic import Field

from vlp16emu.scenario.section import Section

__all__ = ["Weather"]


class Weather(Section):
    """Clear air unless something is given."""

    visibility_m: Annotated[float, Field(ge=10, le=100_000)] | None = None
    """Meteorological visibility; fog below 1000 m, haze below 10 km."""
    rain_mm_h: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Rate of rain: 2.5 light, 10 heavy, 50 violent."""
