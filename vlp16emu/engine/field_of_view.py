"""Data blocks in the field of view that is set on a sensor."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets import azimuth_cdeg
from vlp16emu.sensor.head import Head
from vlp16emu.types import F8, I8

_CELL = 128  # firing sequences that are counted together, 7 ms
_CODE_DEG = 0.02  # more than an azimuth code, and the rounding of angles
_BACK_DEG = 4.3  # farthest that a standing rotor is turned back within a cell by one wobble


@dataclass(frozen=True, slots=True)
class FieldOfView:
    """The sector that a sensor sends; what has one azimuth reading is sent as a whole or not at all."""

    head: Head
    first_deg: int
    last_deg: int  # included

    def inside(self, sequence: I8) -> NDArray[np.bool_]:
        """Return whether what is read at firing sequences (n,) is sent, (n,)."""
        code = azimuth_cdeg(self.head.read(sequence))
        after_first = code >= 100 * self.first_deg
        before_end = code < 100 * (self.last_deg + 1)
        if self.first_deg < self.last_deg + 1:
            return after_first & before_end
        return after_first | before_end

    def count(self, first: int, stop: int) -> int:
        """Count the azimuth readings from firing sequence `first` until before `stop` that are sent.

        Readings have errors that are drawn for each firing sequence, so the count has no closed form; but
        only blocks near the borders are read, of a revolution about two.
        """
        bounds = np.append(np.arange(first, stop, _CELL), stop)
        angle_deg = self._angle_deg(bounds)
        turned_deg = np.diff(angle_deg) % 360.0
        # Where a rotor begins to turn its angle may jump.
        jumps = self.head.rotor.turns_ns / self.head.beams.sequence_ns
        jumps = jumps[np.searchsorted(jumps, first) : np.searchsorted(jumps, stop)]
        turned_deg[np.searchsorted(bounds, jumps, side="right") - 1] = 360.0
        is_in, is_out = self._far_from_borders(angle_deg[:-1], turned_deg)
        cells = bounds[:-1][~(is_in | is_out)]
        step = self.head.beams.per_reading
        blocks = (cells[:, None] + np.arange(0, _CELL, step)).reshape(-1)
        blocks = blocks[blocks < stop]
        is_block_in, is_block_out = self._far_from_borders(self._angle_deg(blocks), 0.0)
        at_border = self.inside(blocks[~(is_block_in | is_block_out)])
        in_cells = np.diff(bounds)[is_in].sum() // step
        return int(in_cells + np.count_nonzero(is_block_in) + np.count_nonzero(at_border))

    def _angle_deg(self, sequence: I8) -> F8:
        return self.head.rotor.angle_deg(sequence * self.head.beams.sequence_ns)

    def _far_from_borders(
        self, angle_deg: F8, turned_deg: F8 | float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return masks of readings surely inside, and surely outside, as a rotor turns from angles (n,)."""
        rotor = self.head.rotor
        width_deg = (self.last_deg - self.first_deg) % 360 + 1
        margin_deg = _CODE_DEG + rotor.encoder.limit_deg + _BACK_DEG * len(rotor.wobbles)
        before_deg = (angle_deg - self.first_deg) % 360.0
        after_deg = before_deg + turned_deg
        is_in = (before_deg > margin_deg) & (after_deg < width_deg - margin_deg)
        is_out = (before_deg > width_deg + margin_deg) & (after_deg < 360.0 - margin_deg)
        return is_in, is_out
