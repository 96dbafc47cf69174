"""Clocks of other epochs: GPS time with its leap seconds, and the clock of a trajectory from its span."""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from vlp16emu.types import I8
from vlp16emu.units import S_NS


def _ns(year: int, month: int, day: int) -> int:
    return int(datetime(year, month, day, tzinfo=UTC).timestamp()) * S_NS


GPS_EPOCH_NS = _ns(1980, 1, 6)
_LEAPS_NS = np.sort(
    [_ns(year, 7, 1) for year in (1981, 1982, 1983, 1985, 1992, 1993, 1994, 1997, 2012, 2015)]
    + [_ns(year, 1, 1) for year in (1988, 1990, 1991, 1996, 1999, 2006, 2009, 2017)]
)
"""Instants after the leap seconds since GPS time began (IERS Bulletin C; the last one was 2016-12-31)."""
ADJUSTMENT_S = 1_000_000_000
"""Subtracted from GPS time in LAS (specification 1.4 - R15, section 2.4, global encoding bit 0)."""
_TAI_GPS_S = 19  # TAI minus GPS time, by definition of the latter (IS-GPS-200, section 3.3.4)


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Offset of a clock from UTC."""

    offset_ns: int  # clock minus UTC
    clock: str  # name of the clock, or how the offset was found


def leap_seconds(t_ns: I8) -> I8:
    """Return GPS time minus UTC (n,), in seconds, at UTC instants (n,), ns since 1970."""
    return np.asarray(np.searchsorted(_LEAPS_NS, t_ns, side="right"))


def clock_offset(poses_ns: tuple[int, int], utc_ns: tuple[int, int]) -> ClockOffset:
    """Return the offset of a trajectory's clock, from its first and last stamp.

    The clock is that of UTC, GPS time and TAI with which the trajectory covers the longest part of a run, the
    first of equal ones. If none covers a part, both are taken to begin together, as with stamps from zero.

    Parameters
    ----------
    poses_ns : first and last stamp of the trajectory
    utc_ns : first and last instant of the run, ns since 1970
    """
    leaps_ns = int(leap_seconds(np.array(utc_ns[:1]))[0]) * S_NS
    clocks = (
        ClockOffset(0, "UTC"),
        ClockOffset(leaps_ns - GPS_EPOCH_NS, "GPS time"),
        ClockOffset(leaps_ns - GPS_EPOCH_NS - ADJUSTMENT_S * S_NS, "adjusted GPS time"),
        ClockOffset(leaps_ns, "GPS time since 1970"),
        ClockOffset(leaps_ns + _TAI_GPS_S * S_NS, "TAI since 1970"),
    )

    def overlap_ns(clock: ClockOffset) -> int:
        """Return for how long poses and packets overlap with a clock's offset."""
        first_ns, last_ns = (stamp_ns - clock.offset_ns for stamp_ns in poses_ns)
        return min(last_ns, utc_ns[1]) - max(first_ns, utc_ns[0])

    best = max(clocks, key=overlap_ns)
    if overlap_ns(best) >= 0:
        return best
    return ClockOffset(poses_ns[0] - utc_ns[0], "both begin together")
