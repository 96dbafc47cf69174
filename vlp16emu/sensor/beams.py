"""Beam tables: elevations, offsets and firing times of lasers in wire order.

Source: VLP-16 User Manual 63-9243 Rev D, table 9-1 (elevation and vertical correction). Each beam
crosses the height of the optical centre 41.9 mm from the spin axis: on the VLP-16 within the rounding of the
table, on the Puck Hi-Res, whose corrections the manual gives in equal steps, within 0.4 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos
from vlp16emu.random import Purpose, normal
from vlp16emu.types import F8, SensorModel

LASER_NS = 2_304  # time between the pulses of consecutive lasers (63-9243 Rev D, section 8.1)
SEQUENCE_NS = 55_296
"""Period of firing sequences: 16 pulses and 18.432 us of recharge (63-9243 Rev D, section 8.1)."""

LENS_RADIUS_M = 0.0419
"""Distance from the spin axis at which all beams cross the horizontal plane: -correction / tan(elevation)."""


@dataclass(frozen=True, slots=True)
class BeamTable:
    """Directions and firing times of L lasers in wire order."""

    elevation_deg: F8  # (L,) elevation above the horizon, from the data sheet
    vertical_offset_m: F8  # (L,) height at which the beam's line meets the spin axis, the zero of ranges
    lens_radius_m: float  # distance from the spin axis at which the light leaves
    sequence_ns: int  # period of firing sequences
    laser_ns: int  # time between the pulses of consecutive lasers
    elevation_error_deg: F8  # (L,) constant elevation errors of this unit
    azimuth_error_deg: F8  # (L,) constant azimuth errors of this unit

    @property
    def near_m(self) -> F8:
        """(L,) range at which the light leaves the lens."""
        return np.asarray(self.lens_radius_m / cos(np.radians(self.elevation_deg)))

    @property
    def ring(self) -> NDArray[np.uint16]:
        """(L,) 0 .. L - 1 by elevation, lowest first."""
        return np.argsort(np.argsort(self.elevation_deg, kind="stable"), kind="stable").astype(np.uint16)


def table_of(
    elevation_deg: Sequence[float],
    vertical_offset_m: F8,
    lens_radius_m: float = LENS_RADIUS_M,
    sequence_ns: int = SEQUENCE_NS,
    laser_ns: int = LASER_NS,
) -> BeamTable:
    """Return the table of a unit without angle errors, from columns of `BeamTable`."""
    elevation = np.array(elevation_deg, np.float64)
    errors_deg = np.zeros(len(elevation_deg))
    return BeamTable(
        elevation, vertical_offset_m, lens_radius_m, sequence_ns, laser_ns, errors_deg, errors_deg
    )


_VLP_16 = table_of(
    (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15),
    np.array((11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2))
    * 1e-3,
)
# Offsets of ids 0..6 follow from ids 15..9 by antisymmetry.
_PUCK_HI_RES = table_of(
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
    np.array((7.4, -0.9, 6.5, -1.8, 5.5, -2.7, 4.6, -3.7, 3.7, -4.6, 2.7, -5.5, 1.8, -6.5, 0.9, -7.4)) * 1e-3,
)

BEAM_TABLES = {
    SensorModel.VLP_16: _VLP_16,
    SensorModel.PUCK_LITE: _VLP_16,
    SensorModel.PUCK_HI_RES: _PUCK_HI_RES,
}


def with_angle_errors(
    table: BeamTable, *, elevation_error_deg: float, azimuth_error_deg: float, seed: int
) -> BeamTable:
    """Return the table of one unit with constant angle errors of its lasers, which no packet reports.

    Parameters
    ----------
    elevation_error_deg, azimuth_error_deg : one sigma of normal errors; 0 for none
    """
    lasers = len(table.elevation_deg)
    return replace(
        table,
        elevation_error_deg=elevation_error_deg * normal(seed, Purpose.ANGLE_BIAS, 0, lasers, lane=0),
        azimuth_error_deg=azimuth_error_deg * normal(seed, Purpose.ANGLE_BIAS, 0, lasers, lane=1),
    )
