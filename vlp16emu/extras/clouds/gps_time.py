"""GPS time of UTC instants."""

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from vlp16emu.units import S_NS


def _ns(year: int, month: int, day: int) -> int:
    return int(datetime(year, month, day, tzinfo=UTC).timestamp()) * S_NS


_EPOCH_NS = _ns(1980, 1, 6)
_LEAPS_NS = np.array(
    [_ns(year, 7, 1) for year in (1981, 1982, 1983, 1985, 1992, 1993, 1994, 1997, 2012, 2015)]
    + [_ns(year, 1, 1) for year in (1988, 1990, 1991, 1996, 1999, 2006, 2009, 2017)]
)
"""Instants after the leap seconds since GPS time began (IERS Bulletin C; none is announced after that of 2016-12-31)."""
_LEAPS_NS.sort()
_ADJUSTMENT_S = 1_000_000_000
"""LAS specification 1.4 - R15, section 2.4, global encoding bit 0."""


def adjusted_gps_s(t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Convert UTC instants (n,), ns since 1970 without leap seconds, to adjusted standard GPS time (n,) in s."""
    leaps = np.searchsorted(_LEAPS_NS, t_ns, side="right")
    # Whole seconds apart, as float64 keeps 60 ns of the sum and no more.
    whole, rest = np.divmod(t_ns - _EPOCH_NS, S_NS)
    return np.asarray((whole + leaps - _ADJUSTMENT_S) + rest / S_NS)
