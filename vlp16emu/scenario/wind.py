"""The `[wind]` table: what makes trees sway."""

from typing import Annotated

from pydantic import Field

from vlp16emu.settings import Section

__all__ = ["Wind"]


class Wind(Section):
    """Wind through a stand; without this table, and at a speed of 0, the air is still and costs nothing."""

    speed_m_s: Annotated[float, Field(ge=0, le=12)]
    """Mean, at the top of the canopy: there half of what it is in the open, by and large. Trees answer in proportion, also
    where real ones would break or lean on their neighbours: from some 8 m/s on thin trees of dense stands lean too far."""
    towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction in which it blows, counter-clockwise from east."""
    turbulence_intensity: Annotated[float, Field(ge=0, le=1)] = 0.55
    """Standard deviation of the speed along the wind over the mean; across it is 0.8 of that. At the top of canopies
    1.8 / 3.3 (both over the friction velocity; Raupach, Finnigan and Brunet, Boundary-Layer Meteorol 78, 1996)."""
    gust_length_m: Annotated[float, Field(ge=1, le=500)] = 20.0
    """Integral length of gusts along the wind: at the top of canopies about the height of the trees (the same)."""
    damping_ratio: Annotated[float, Field(ge=0.02, le=1)] = 0.1
    """Damping of the trees' swing as a share of critical damping: whole trees have 0.08 and more, stripped ones 0.01 to
    0.08 (Moore and Maguire, Trees 19, 2005)."""
