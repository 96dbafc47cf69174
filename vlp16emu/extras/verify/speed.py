"""Rules of the rotor's speed, revolution by revolution."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.verify.frames import Findings, Level, Rule
from vlp16emu.sensor.settings import RPM_STEP
from vlp16emu.types import F8, I8

_HELD_RPM = 4.0
"""Error of the mean speed of a revolution: speed control, 3 rpm in sibling manuals, and two readings."""
_LONGEST_CHANGE = 1000  # revolutions of one change of speed


class SpeedRules:
    """Rule of the held speed: a revolution at another speed is an error.

    It is a note between two held speeds, and in a capture whose rotor holds another one all along.
    """

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._unsteady: list[tuple[int, float]] = []
        """Packet numbers and speeds, rpm, of the latest revolutions between two speeds."""
        self._held_rpm: float | None = None  # the speed before them

    def check(self, packets: I8, rpm: F8, is_whole: NDArray[np.bool_]) -> None:
        """Check whole revolutions (n,) by the numbers of their first packets; others are left out."""
        for packet, speed_rpm in zip(packets[is_whole].tolist(), rpm[is_whole].tolist(), strict=True):
            held_rpm = RPM_STEP * round(speed_rpm / RPM_STEP)
            if abs(speed_rpm - held_rpm) > _HELD_RPM:
                self._unsteady.append((packet, speed_rpm))
                if len(self._unsteady) >= _LONGEST_CHANGE:
                    self._report(None)
            else:
                self._report(held_rpm)
                self._held_rpm = held_rpm

    def finish(self) -> None:
        """Judge the last revolutions."""
        self._report(None)

    def _report(self, held_rpm: float | None) -> None:
        """Report the collected revolutions, which a held speed follows, or None."""
        if not self._unsteady:
            return
        speeds_rpm = [speed_rpm for _, speed_rpm in self._unsteady]
        is_other = None not in (held_rpm, self._held_rpm) and held_rpm != self._held_rpm
        is_change = is_other or max(speeds_rpm) - min(speeds_rpm) > RPM_STEP / 2
        # A capture that has one speed all along was set to it.
        is_set = self._held_rpm is None and held_rpm is None
        is_set &= max(speeds_rpm) - min(speeds_rpm) <= 2.0 * _HELD_RPM
        level = Level.NOTE if is_change or is_set else Level.ERROR
        for packet, speed_rpm in self._unsteady:
            found = f"a revolution at {speed_rpm:.1f} rpm"
            expected = f"a multiple of {RPM_STEP} rpm within {_HELD_RPM:g}, held"
            self._findings.add(Rule.SPEED, packet, found, expected, level)
        self._unsteady = []
