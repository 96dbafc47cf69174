"""The `[detector]` table: how the receiver tells echoes."""

from typing import Annotated

from pydantic import Field

from vlp16emu.settings import Section

__all__ = ["Detector"]


class Detector(Section):
    """The receiver, as far as it is the same in all units."""

    pulse_ns: Annotated[float, Field(ge=1, le=20)] = 6.0
    """Full width of a pulse at half maximum; not in the data sheet (assumption, 5 ns in other simulators)."""
    resolution_m: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Echoes nearer to each other are one; 1 m for the VLS-128, and a VLP-16 showed 1.19 m at least."""
    range_at_10_percent_m: Annotated[float, Field(ge=1, le=500)] = 40.0
    """Range at which a perpendicular target of 10 % that fills the beam is detected every second time. Assumption: a
    white wall is then detected from 126 m, a leaf of 50 % from 89 m; the data sheet's 100 m come without a
    reflectivity."""
    threshold_snr: Annotated[float, Field(ge=3, le=20)] = 6.0
    """Signal over noise at the detection threshold. Assumption: noise alone passes it once in some 1e9 samples."""
