"""Where the lasers point: one table per sensor, in wire order (laser id 0..15).

Source: VLP-16 User Manual 63-9243 Rev D, table 9-1 (elevation and vertical correction). Each beam
crosses the height of the optical centre 41.9 mm from the spin axis: on the VLP-16 to the rounding of the
table, on the Puck Hi-Res, whose corrections the manual gives in equal steps, to 0.4 mm.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.types import SensorModel

__all__ = ["BEAM_TABLES", "LENS_RADIUS_M", "BeamTable"]

LENS_RADIUS_M = 0.0419
"""Distance from the spin axis at which all beams cross the horizontal plane: -correction / tan(elevation)."""


@dataclass(frozen=True, slots=True)
class BeamTable:
    """Directions of L lasers in wire order."""

    elevation_deg: NDArray[np.float64]
    """(L,) over the horizon."""
    vertical_offset_m: NDArray[np.float64]
    """(L,) height at which the beam's line meets the spin axis; ranges are reckoned from there."""

    @property
    def near_m(self) -> NDArray[np.float64]:
        """(L,) range at which the light leaves the lens."""
        return np.asarray(LENS_RADIUS_M / np.cos(np.radians(self.elevation_deg)))


def _table(elevation_deg: tuple[float, ...], vertical_offset_mm: tuple[float, ...]) -> BeamTable:
    return BeamTable(np.array(elevation_deg), np.array(vertical_offset_mm) * 1e-3)


_VLP_16 = _table(
    (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15),
    (11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2),
)
# Offsets of ids 0..6 follow from those of 15..9 by antisymmetry.
_PUCK_HI_RES = _table(
    (
        -10.0,
        0.667,
        -8.667,
        2.0,
        -7.333,
        3.333,
        -6.0,
        4.667,
        -4.667,
        6.0,
        -3.333,
        7.333,
        -2.0,
        8.667,
        -0.667,
        10.0,
    ),
    (7.4, -0.9, 6.5, -1.8, 5.5, -2.7, 4.6, -3.7, 3.7, -4.6, 2.7, -5.5, 1.8, -6.5, 0.9, -7.4),
)

BEAM_TABLES = {
    SensorModel.VLP_16: _VLP_16,
    SensorModel.PUCK_LITE: _VLP_16,
    SensorModel.PUCK_HI_RES: _PUCK_HI_RES,
}
