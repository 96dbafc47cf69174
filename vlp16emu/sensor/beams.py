"""Sensor models: beams, firing times and codes, from the tables of `protocol/models`, which have the sources.

On a Puck each beam crosses the height of the optical centre 41.9 mm from the spin axis: on the VLP-16 within
the rounding of the manual's table, on the Puck Hi-Res, whose corrections the manual gives in equal steps,
within 0.4 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos
from vlp16emu.models import model_table
from vlp16emu.random import Purpose, normal
from vlp16emu.types import F8, I8, SensorModel


@dataclass(frozen=True, slots=True)
class BeamTable:
    """Directions and firing times of L lasers in wire order."""

    elevation_deg: F8  # (L,) elevation above the horizon, from the data sheet
    azimuth_offset_deg: F8  # (L,) azimuth of the beam minus that of the rotor, from the data sheet
    vertical_offset_m: F8  # (L,) height at which the beam's line meets the spin axis, the zero of ranges
    lens_radius_m: float  # distance from the spin axis at which the light leaves
    sequence_ns: int  # period of firing sequences
    firing_ns: I8  # (L,) times of the pulses since the begin of their firing sequence
    per_reading: int  # firing sequences from one azimuth reading to the next
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
    lens_radius_m: float,
    sequence_ns: int,
    firing_ns: I8,
    *,
    azimuth_offset_deg: F8 | None = None,
    per_reading: int = 2,
) -> BeamTable:
    """Return the table of a unit without angle errors, from columns of `BeamTable`."""
    elevation = np.array(elevation_deg, np.float64)
    none_deg = np.zeros(len(elevation))
    offset_deg = none_deg if azimuth_offset_deg is None else azimuth_offset_deg
    return BeamTable(
        elevation,
        offset_deg,
        vertical_offset_m,
        lens_radius_m,
        sequence_ns,
        firing_ns,
        per_reading,
        elevation_error_deg=none_deg,
        azimuth_error_deg=none_deg,
    )


BLOCK_RECORDS = 32  # records of a data block of all models (63-9243 Rev D, section 9.3.2, p. 56)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A sensor model: its beams, and the codes of its packets."""

    name: SensorModel
    title: str
    product: int  # second factory byte
    read_as: SensorModel  # model that packets with this product byte are taken for
    flags: tuple[int, ...]  # flags of the blocks of one firing sequence
    distance_lsb_m: float
    minimum_lsb: int  # smallest nonzero distance code
    stamp_after_ns: int  # time of a packet's stamp after its first pulse
    period_us: tuple[int, int] | None
    """Shortest and longest period of packets of single return on real units; None if it is the manual's."""
    has_known_frame: bool  # whether the headers of its frames are known
    rpm: tuple[int, int]  # lowest and highest speed
    beams: BeamTable

    @property
    def lasers(self) -> int:
        """Number of lasers."""
        return len(self.beams.elevation_deg)

    @classmethod
    def of(cls, name: SensorModel) -> "Model":
        """Return a model from its table."""
        table = model_table(name)
        packet, firing, beams = (table[key] for key in ("packet", "firing", "beams"))
        slots = np.array(firing["slots"], np.int64)
        firing_ns = np.repeat(slots * firing["slot_ns"], firing["lasers_per_slot"])
        lasers = len(firing_ns)
        return cls(
            name=name,
            title=table["title"],
            product=packet["product"],
            read_as=SensorModel(packet.get("read_as", name)),
            flags=tuple(packet["flags"]),
            distance_lsb_m=packet["distance_mm"] / 1000,
            minimum_lsb=packet["minimum_code"],
            stamp_after_ns=packet["stamp_after_first_ns"],
            period_us=tuple(packet["period_us"]) if "period_us" in packet else None,
            has_known_frame=table["frame"]["is_known"],
            rpm=tuple(table["motor"]["rpm"]),
            beams=table_of(
                beams["elevation_deg"],
                np.array(beams["vertical_correction_mm"], np.float64) * 1e-3,
                beams["lens_radius_mm"] * 1e-3,
                firing["sequence_ns"],
                firing_ns,
                azimuth_offset_deg=np.resize(np.array(beams["azimuth_offset_deg"], np.float64), lasers),
                per_reading=max(BLOCK_RECORDS // lasers, 1),
            ),
        )


MODELS = {name: Model.of(name) for name in SensorModel}
BEAM_TABLES = {name: model.beams for name, model in MODELS.items()}

_VLP_16 = BEAM_TABLES[SensorModel.VLP_16]
SEQUENCE_NS = _VLP_16.sequence_ns  # of a VLP-16, like the next two
LASER_NS = int(_VLP_16.firing_ns[1])  # time between the pulses of consecutive lasers
LENS_RADIUS_M = _VLP_16.lens_radius_m


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
