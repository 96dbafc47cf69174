"""Rules about what comes through the window: each laser has returns, and no sector turns dark."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets.layout import LASERS
from vlp16emu.validator.records import DataChunk
from vlp16emu.validator.rules import Findings, Rule

_BY_ELEVATION = np.array([*range(0, LASERS, 2), *range(1, LASERS, 2)])
"""Lasers from the lowest to the highest. Source: 63-9243 Rev D, table 9-1, p. 53."""
_SHORTEST = 300
"""Firing sequences: fewer may all look into the sky."""
_SEEN = 0.1
"""Share of pulses with a return from which on a laser sees something."""
_SECTORS = 36
_SECTOR_RETURNS = 300
"""Fewer returns say too little about a sector."""
_SECTOR_BLOCKS = 20
"""The same of its blocks, which a whole revolution has of each."""
_DARKER = 0.35
"""Light of a sector as a share of that before; behind dirt that lets 0.5 through it is 0.25, as light passes twice."""
_STEADY = 0.25
"""By how much the sectors change in the middle while one turns dark."""


class OpticsRules:
    """Checks chunk by chunk what lasers and sectors return, beside their neighbours and beside the chunk before."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._share: NDArray[np.float64] | None = None
        self._light: NDArray[np.float64] | None = None
        self._dead = frozenset[int]()

    def check(self, chunk: DataChunk) -> None:
        """Check one chunk."""
        records = chunk.payload["blocks"]["records"]
        if len(chunk.number) * records.shape[1] * records.shape[2] < _SHORTEST:
            return
        packet, is_return = int(chunk.number[0]), records["distance_lsb"] > 0
        self._check_lasers(packet, is_return.mean(axis=(0, 1, 2)))
        self._check_sectors(packet, chunk, is_return)

    def _check_lasers(self, packet: int, share: NDArray[np.float64]) -> None:
        """Report lasers without a single return, whose neighbours have many; at the edge, which had them before."""
        of = share[_BY_ELEVATION]
        before = np.zeros(LASERS) if self._share is None else self._share[_BY_ELEVATION]
        sees = of >= _SEEN
        dead = np.zeros(LASERS, np.bool_)
        dead[1:-1] = (of[1:-1] == 0) & sees[:-2] & sees[2:]
        for edge, inner in ((0, 1), (-1, -2)):
            dead[edge] = of[edge] == 0 and before[edge] >= _SEEN and of[inner] >= 0.5 * before[inner] > 0
        found = frozenset(_BY_ELEVATION[dead].tolist()) | {laser for laser in self._dead if share[laser] == 0}
        for laser in sorted(found - self._dead):
            self._findings.add(
                Rule.LASER, packet, f"laser {laser} without returns", "some, as those beside it"
            )
        self._share, self._dead = share, found

    def _check_sectors(self, packet: int, chunk: DataChunk, is_return: NDArray[np.bool_]) -> None:
        """Report sectors that turn dark from one chunk to the next, while the others stay as they are."""
        sector = chunk.payload["blocks"]["azimuth_cdeg"].astype(np.int64) * _SECTORS // 36_000 % _SECTORS
        returns = np.bincount(sector.ravel(), is_return.sum(axis=(2, 3)).ravel(), _SECTORS)
        blocks = np.bincount(sector.ravel(), minlength=_SECTORS)
        reflectivity = np.where(is_return, chunk.payload["blocks"]["records"]["reflectivity"], 0)
        light = np.bincount(sector.ravel(), reflectivity.sum(axis=(2, 3), dtype=np.int64).ravel(), _SECTORS)
        known = blocks >= _SECTOR_BLOCKS
        mean = np.divide(light, blocks, out=np.zeros(_SECTORS), where=known)
        # Of a sector that was too dark to be judged nothing is known the next time.
        before, self._light = self._light, np.where(returns >= _SECTOR_RETURNS, mean, 0.0)
        if before is None:
            return
        judged = known & (before > 0)
        ratio = np.divide(mean, before, out=np.ones(_SECTORS), where=judged)
        if not judged.any() or abs(float(np.median(ratio[judged])) - 1.0) > _STEADY:
            return
        dark = np.flatnonzero(ratio < _DARKER)
        for run in np.split(dark, np.flatnonzero(np.diff(dark) > 1) + 1) if len(dark) else ():
            begin, end = run[0] * 360 // _SECTORS, (run[-1] + 1) * 360 // _SECTORS
            found = (
                f"{ratio[run].mean():.2f} of the light from {begin} to {end} deg, as behind a dirty window"
            )
            self._findings.add(Rule.WINDOW, packet, found, "about as much as before")
