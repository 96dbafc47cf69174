"""Running figures of the packets of a capture, whose size does not grow with its length."""

from collections import Counter

import numpy as np

from vlp16emu.packets.decode import JUMP_NS, scan_steps
from vlp16emu.packets.layout import AZIMUTH_CODES, Layout
from vlp16emu.types import F8, I8, U2
from vlp16emu.units import US_NS


class Scans:
    """Numbers of azimuth readings of the revolutions of a capture, read some at a time."""

    def __init__(self) -> None:
        self.count = 0  # revolutions that have begun
        self._lengths = Counter[int]()  # of those between the first one and the last one
        self._azimuth_deg = np.zeros(0)  # the latest one; `_t_ns` alike
        self._t_ns = np.zeros(0, np.int64)
        self._length = 0  # readings of the last revolution so far
        self._turns = self._jumps = self._scan = 0  # as in `scan_starts`, up to the latest reading
        self._most_turns = np.zeros(0, np.int64)

    def take(self, azimuth_deg: F8, t_ns: I8) -> None:
        """Take the next azimuths (n,) of blocks, with their times (n,)."""
        turns, jumps = scan_steps(
            np.concatenate([self._azimuth_deg, azimuth_deg]), np.concatenate([self._t_ns, t_ns])
        )
        self._azimuth_deg = azimuth_deg[-1:]
        self._t_ns = t_ns[-1:]
        total = np.concatenate([self._most_turns, self._turns + np.cumsum(turns)])
        most_turns = np.maximum.accumulate(total)[len(self._most_turns) :]
        scan = most_turns + self._jumps + np.cumsum(jumps)
        is_start = np.diff(scan, prepend=self._scan) != 0
        if self.count == 0:
            is_start = np.append(True, is_start)  # the very first reading
        if len(turns):
            self._turns += int(turns.sum())
            self._jumps += int(jumps.sum())
            self._most_turns = most_turns[-1:]
            self._scan = int(scan[-1])
        self._note(np.flatnonzero(is_start), len(azimuth_deg))

    def _note(self, starts: I8, readings: int) -> None:
        """Note the revolutions that start at some of the next readings."""
        lengths = np.diff(starts, prepend=-self._length, append=readings).tolist()
        self._length = lengths.pop()
        # The first of them ends the revolution before, which is not whole if it is the first of the capture.
        whole = lengths[max(2 - self.count, 0) :]
        self._lengths.update(whole)
        self.count += len(starts)

    @property
    def lengths(self) -> I8:
        """Numbers of readings (n,) of the revolutions between the first one and the last one."""
        return np.repeat(
            np.array([*self._lengths.keys()], np.int64), np.array([*self._lengths.values()], np.int64)
        )


class Duration:
    """Time from the first packet to the last, by the sensor's clock; by the host's where that jumps."""

    def __init__(self) -> None:
        self.total_ns = 0
        self._last_ns = np.zeros((2, 0), np.int64)

    def take(self, sensor_ns: I8, host_ns: I8) -> I8:
        """Take the times (n,) of the next packets; return the steps of the sensor's clock to each of them.

        The very first packet has no step.
        """
        step_ns, host_step_ns = np.diff(
            np.concatenate([self._last_ns, np.stack([sensor_ns, host_ns])], axis=1), axis=1
        )
        self._last_ns = np.array([sensor_ns[-1:], host_ns[-1:]])
        is_jump = (step_ns < 0) | (np.abs(host_step_ns) < np.abs(step_ns))  # the host's clock may be set too
        is_jump &= np.abs(step_ns - host_step_ns) > JUMP_NS
        self.total_ns += int(np.where(is_jump, host_step_ns, step_ns).sum())
        return np.asarray(step_ns)


class ModeTurns:
    """Rotation of a unit over the packets of one return mode.

    It follows from the azimuths of their blocks and, where units of a model differ, from the steps of their
    stamps.
    """

    def __init__(self, of_mode: Layout) -> None:
        self._layout = of_mode
        self._turned_cdeg = 0  # angle of the even steps
        self._steps = 0  # number of even steps
        self._last_cdeg = np.zeros(0, np.int64)
        self._often = np.zeros(AZIMUTH_CODES, np.int64)  # of packets with one reading: how often each step is
        self._regular_us = 0  # sum of the regular steps of the stamps
        self._regular = 0  # their number

    def take(self, azimuth_cdeg: U2, step_ns: I8) -> None:
        """Take the azimuths (n, 12) of packets, and the steps (n or n - 1,) of their stamps."""
        own_cdeg: I8 = self._layout.by_reading(azimuth_cdeg)[:, :, 0, 0].astype(np.int64)
        regular_us = self._layout.regular_us(step_ns // US_NS)
        self._regular_us += int(regular_us.sum())
        self._regular += len(regular_us)
        if self._layout.readings == 1:
            line_cdeg = np.concatenate([self._last_cdeg, own_cdeg[:, 0]])
            self._last_cdeg = line_cdeg[-1:]
            self._often += np.bincount(np.diff(line_cdeg) % AZIMUTH_CODES, minlength=AZIMUTH_CODES)
            return
        step_cdeg: I8 = np.diff(own_cdeg) % AZIMUTH_CODES
        # A step far wider than its neighbours is the edge of the field of view.
        even = step_cdeg <= 2 * np.median(step_cdeg, axis=1, keepdims=True)
        self._turned_cdeg += int(step_cdeg[even].sum())
        self._steps += int(even.sum())

    @property
    def turned_cdeg(self) -> int:
        """Angle turned in the even steps."""
        often = self._even_often
        return self._turned_cdeg + int((often * np.arange(len(often))).sum())

    @property
    def turning_ns(self) -> int:
        """Time of the even steps."""
        period_ns = self._layout.mean_period_ns(self._regular_us, self._regular)
        return (self._steps + int(self._even_often.sum())) * period_ns // self._layout.readings

    @property
    def _even_often(self) -> I8:
        """How often each even step between packets of one reading is."""
        below = np.cumsum(self._often)
        middle = (below[-1] - 1) // 2 + 1, below[-1] // 2 + 1
        twice_median = int(np.searchsorted(below, middle).sum()) if below[-1] else 0
        return self._often[: twice_median + 1]
