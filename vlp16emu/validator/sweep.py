"""Rules about time and azimuth from packet to packet: what a steady rotor and a steady clock give."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets.layout import AZIMUTH_CODES, BLOCK_PERIOD_NS, BLOCKS_PER_PACKET
from vlp16emu.units import US_NS
from vlp16emu.validator.framing import JITTER_US, ClockWatch, wrap_hour_us
from vlp16emu.validator.records import DataChunk
from vlp16emu.validator.rotor import check_speed, frozen_packets
from vlp16emu.validator.rules import Findings, Rule

_STEP_TOLERANCE_CDEG = 6
"""Real units read azimuths with 0.5 cdeg of noise, which makes steps 0.8 cdeg wide; the widest seen is 4.5."""
_GAP_TOLERANCE_CDEG = 26
"""By which the azimuth left out may disagree with the time left out: 9 cdeg of once-per-revolution error, as
seen on real units, at either end, and the noise of two readings and a step."""
_GAP_TOLERANCE = 0.005
"""The same in proportion to the gap, for speed control: 3 rpm of 600."""
_CLOCK_PPM = 10
"""By which a clock that follows GPS may run faster or slower for a while."""
_RPM = (300, 1200)
"""Source: 63-9243 Rev D, section 8.3, p. 50."""
_RPM_TOLERANCE = 0.01
"""Speed control, 3 rpm in sibling manuals, and the once-per-revolution error of the encoder."""
_RPM_STEPS = 100
"""Fewer steps than these say too little about the speed."""
_CDEG_PER_STEP_AND_RPM = 6 * 100 * BLOCK_PERIOD_NS / 1e9


@dataclass(frozen=True, slots=True)
class _Steps:
    """Azimuth steps of a chunk; row i holds those inside packet i and, at its end, the one to packet i+1."""

    forward_cdeg: NDArray[np.int64]
    """(n, blocks) 0 .. 35999; the very last one leads nowhere and is 0."""
    usual_cdeg: NDArray[np.float64]
    """(n, 1) median inside the packet."""
    is_odd: NDArray[np.bool_]
    """(n, blocks) neither forward nor near the usual step."""


class SweepRules:
    """Checks time stamps and azimuths, chunk by chunk.

    The last packet of a chunk is judged with the next chunk, where its neighbour is known.
    """

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._clock = ClockWatch(findings)
        self.lost_packets = 0
        self.covered_us = 0.0
        """Time spanned by the packets and by those that were lost."""
        self.left_out_us = 0.0
        """Time during which the sensor sent nothing, by a limited field of view."""
        self._turned_cdeg = 0
        self._turned_steps = 0

    @property
    def rpm(self) -> float | None:
        """Mean speed over all even steps; None where there were none."""
        if self._turned_steps == 0:
            return None
        return self._turned_cdeg / self._turned_steps / _CDEG_PER_STEP_AND_RPM

    def check(self, chunk: DataChunk) -> None:
        """Check one chunk."""
        steps = _azimuth_steps(chunk)
        is_regular = self._check_time(chunk, steps)
        judged = len(chunk.number) if chunk.ends else len(chunk.number) - 1
        signed_cdeg = _signed(steps.forward_cdeg)
        is_still = frozen_packets(chunk, signed_cdeg, self._findings)
        steps.is_odd[is_still] = False
        check_speed(chunk, signed_cdeg, is_regular, self._findings)
        self._check_azimuth(chunk, steps, is_still, judged)
        self._measure_speed(chunk, steps, is_regular, judged)

    def _check_time(self, chunk: DataChunk, steps: _Steps) -> NDArray[np.bool_]:
        """Check n - 1 time steps; returns which are regular and excuses azimuths where time explains them."""
        period_ns = BLOCK_PERIOD_NS * steps.forward_cdeg.shape[1]
        timestamp_us: NDArray[np.int64] = chunk.payload["timestamp_us"].astype(np.int64)
        step_us = wrap_hour_us(timestamp_us[1:] - timestamp_us[:-1])
        shortest_us = period_ns // US_NS
        is_regular: NDArray[np.bool_] = (step_us == shortest_us) | (step_us == shortest_us + 1)
        periods = np.rint(step_us * US_NS / period_ns).astype(np.int64)
        off_us = np.abs(step_us - periods * period_ns / US_NS)
        is_whole = (periods > 1) & (off_us <= 1 + step_us * _CLOCK_PPM / 1e6)

        left_out_us, is_explained = _left_out(steps, step_us - period_ns / US_NS)
        odd_inside = steps.is_odd[: len(step_us), :-1].any(axis=1)
        is_gap = ~is_regular & is_explained & (odd_inside | ~is_whole)
        is_lost = ~is_regular & is_whole & ~is_gap
        is_broken = ~(is_regular | is_gap | is_lost)

        after = chunk.number[1:]
        usual = f"+{shortest_us} or +{shortest_us + 1} us"
        self._findings.add_where(
            Rule.LOST_PACKETS,
            is_lost,
            after,
            lambda i: f"{periods[i] - 1} data packets missing before it",
            "none",
        )
        self._findings.add_where(
            Rule.TIME_STEP, is_broken, after, lambda i: f"time stamp {step_us[i]:+d} us", usual
        )
        self._findings.add_where(
            Rule.AZIMUTH_GAP,
            is_gap,
            np.where(odd_inside, chunk.number[:-1], after),
            lambda i: f"{left_out_us[i] / 1e3:.1f} ms of the revolution left out",
            "the whole revolution",
        )
        steps.is_odd[:-1][is_gap] = False
        steps.is_odd[:-1, -1] &= is_regular
        self._watch_clock(chunk, np.append(is_gap & odd_inside, False), was_set=bool(is_broken.any()))
        self.lost_packets += int((periods[is_lost] - 1).sum())
        self.left_out_us += float(left_out_us[is_gap].sum())
        self.covered_us += float((periods[is_lost] - 1).sum() + len(step_us)) * period_ns / US_NS
        return is_regular

    def _watch_clock(self, chunk: DataChunk, takes_longer: NDArray[np.bool_], *, was_set: bool) -> None:
        """Compare time stamps with capture stamps by the chunk's median, which no burst can move.

        Parameters
        ----------
        takes_longer : (n,) packets within which a part of the revolution is left out
        """
        if was_set:
            self._clock.restart()
            return
        offset_us = chunk.stamp_ns // US_NS - chunk.payload["timestamp_us"].astype(np.int64)
        moved_us = wrap_hour_us(offset_us - offset_us[0])
        after_us = np.minimum.accumulate(moved_us[::-1])[::-1]
        late_us = moved_us - np.maximum(np.minimum.accumulate(moved_us), after_us)
        self._findings.add_where(
            Rule.LATENESS,
            (late_us > JITTER_US) & ~takes_longer,
            chunk.number,
            lambda i: f"{late_us[i] / 1e3:.1f} ms later than others",
            f"within {JITTER_US / 1e3:.0f} ms",
        )
        middle_us = int(offset_us[0]) + round(float(np.median(moved_us)))
        self._clock.check(int(chunk.number[0]), int(chunk.stamp_ns[0]), middle_us)

    def _check_azimuth(
        self, chunk: DataChunk, steps: _Steps, is_still: NDArray[np.bool_], judged: int
    ) -> None:
        """Check the steps of the first `judged` packets."""
        blocks = steps.forward_cdeg.shape[1]
        is_odd = steps.is_odd[:judged]
        if not chunk.dual:
            is_twin = (steps.forward_cdeg[:judged, 0] == 0) & ~is_still[:judged]
            found = "blocks 0 and 1 with one azimuth"
            self._findings.add_where(
                Rule.SINGLE_AS_DUAL, is_twin, chunk.number[:judged], lambda _: found, "two azimuths"
            )
            is_odd[:, 0] &= ~is_twin
        # A step belongs to the packet it leads to.
        packets = np.repeat(chunk.number[:judged, None], blocks, axis=1)
        packets[: len(chunk.number) - 1, -1] = chunk.number[1:]
        signed_cdeg = _signed(steps.forward_cdeg)

        def found_step(i: int) -> str:
            row, column = divmod(i, blocks)
            block = (column + 1) % blocks * (BLOCKS_PER_PACKET // blocks)
            return f"azimuth {signed_cdeg[row, column] / 100:+.2f} deg at block {block}"

        usual_cdeg = float(np.median(steps.usual_cdeg))
        expected = f"{usual_cdeg / 100:+.2f} deg within {_STEP_TOLERANCE_CDEG / 100:.2f}"
        self._findings.add_where(Rule.AZIMUTH_STEP, is_odd.ravel(), packets.ravel(), found_step, expected)

    def _measure_speed(
        self, chunk: DataChunk, steps: _Steps, is_regular: NDArray[np.bool_], judged: int
    ) -> None:
        """Take the mean of the even steps, and check it."""
        is_even = np.abs(_signed(steps.forward_cdeg) - steps.usual_cdeg) <= _STEP_TOLERANCE_CDEG
        is_even[:-1, -1] &= is_regular
        is_even[-1, -1] = False
        is_even[judged:] = False
        even_cdeg = steps.forward_cdeg[is_even]
        self._turned_cdeg += int(even_cdeg.sum())
        self._turned_steps += len(even_cdeg)
        if len(even_cdeg) < _RPM_STEPS:
            return
        rpm = float(even_cdeg.mean()) / _CDEG_PER_STEP_AND_RPM
        if not _RPM[0] * (1 - _RPM_TOLERANCE) <= rpm <= _RPM[1] * (1 + _RPM_TOLERANCE):
            packet = int(chunk.number[0])
            self._findings.add(Rule.RPM, packet, f"{rpm:.1f} rpm from here", f"{_RPM[0]} to {_RPM[1]}")


def _azimuth_steps(chunk: DataChunk) -> _Steps:
    """Take the steps between the azimuths of a chunk, without the second block of each dual pair."""
    azimuth_cdeg = chunk.payload["blocks"]["azimuth_cdeg"][:, :: 2 if chunk.dual else 1].astype(np.int64)
    forward_cdeg = np.append(np.diff(azimuth_cdeg.ravel()) % AZIMUTH_CODES, 0).reshape(azimuth_cdeg.shape)
    usual_cdeg = np.median(forward_cdeg[:, :-1], axis=1, keepdims=True)
    signed_cdeg = _signed(forward_cdeg)
    is_odd = (np.abs(signed_cdeg - usual_cdeg) > _STEP_TOLERANCE_CDEG) | (signed_cdeg <= 0)
    is_odd[-1, -1] = False
    return _Steps(forward_cdeg, usual_cdeg, is_odd)


def _signed(forward_cdeg: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.where(forward_cdeg > AZIMUTH_CODES // 2, forward_cdeg - AZIMUTH_CODES, forward_cdeg)


def _left_out(steps: _Steps, extra_us: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Time that odd azimuth steps of each packet stand for, and whether it explains the extra time.

    Parameters
    ----------
    extra_us : (n - 1,) time from packet to packet beyond a period
    """
    even_cdeg = steps.forward_cdeg[:, :-1][~steps.is_odd[:, :-1]]
    # A mean, because the median of whole numbers is too coarse to turn a gap into time.
    usual_cdeg = max(float(even_cdeg.mean()), 1.0) if len(even_cdeg) else 1.0
    rate_cdeg_us = usual_cdeg / (BLOCK_PERIOD_NS / US_NS)
    is_odd = steps.is_odd[:-1]
    left_out_us = np.where(is_odd, steps.forward_cdeg[:-1] - usual_cdeg, 0.0).sum(axis=1) / rate_cdeg_us
    tolerance_us = _GAP_TOLERANCE_CDEG / rate_cdeg_us + _GAP_TOLERANCE * left_out_us
    return left_out_us, is_odd.any(axis=1) & (np.abs(left_out_us - extra_us) <= tolerance_us)
