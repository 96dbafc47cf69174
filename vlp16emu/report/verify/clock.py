"""The rule that time stamps keep pace with the capture's own clock."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.report.verify.rules import Findings, Rule
from vlp16emu.units import HOUR_NS, MS_NS, US_NS

__all__ = ["HOUR_US", "ClockWatch", "wrap_hour_us"]

Microseconds = TypeVar("Microseconds", int, NDArray[np.int64])

HOUR_US = HOUR_NS // US_NS
_JITTER_US = 5 * MS_NS // US_NS
"""By how much a capturing host may be late with a stamp, bursts included; a quiet one stays below 0.1 ms."""
_DRIFT_PPM = 150
"""Sensors were seen 2 to 20 ppm off the clocks of hosts; a cheap oscillator may be 100 ppm off."""


def wrap_hour_us(difference_us: Microseconds) -> Microseconds:
    """Difference of two times past the hour, brought to half an hour around 0; number or (n,)."""
    half_us = HOUR_US // 2
    return (difference_us + half_us) % HOUR_US - half_us


class ClockWatch:
    """Follows the distance between capture stamp and time stamp of one stream."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._reference: tuple[int, int] | None = None

    def restart(self) -> None:
        """Forget the past, because the sensor's clock has been set."""
        self._reference = None

    def check(self, packet: int, stamp_ns: int, offset_us: int) -> None:
        """Compare with the first packet.

        Parameters
        ----------
        packet : frame number
        stamp_ns : capture stamp
        offset_us : capture stamp less time stamp
        """
        if self._reference is None:
            self._reference = stamp_ns, offset_us
            return
        since_ns = abs(stamp_ns - self._reference[0])
        moved_us = wrap_hour_us(offset_us - self._reference[1])
        if abs(moved_us) > _JITTER_US + since_ns / US_NS * _DRIFT_PPM / 1e6:
            found = f"time stamps {-moved_us / 1e3:+.1f} ms off the capture stamps"
            expected = f"within {_JITTER_US / 1e3:.0f} ms and {_DRIFT_PPM} ppm"
            self._findings.add(Rule.CLOCK_DRIFT, packet, found, expected)
            self._reference = stamp_ns, offset_us
