"""Rules about data packets, checked in chunks as columns: their codes, their time, the rotor, lasers and window."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.verify.frames import HOUR_US, JITTER_US, ClockWatch, wrap_hour_us
from vlp16emu.extras.verify.rules import Findings, Level, Rule
from vlp16emu.packets.capture import Datagram
from vlp16emu.packets.decode import PRODUCT_BEFORE_RELEASE
from vlp16emu.packets.layout import (
    AZIMUTH_CODES,
    BLOCK_FLAG,
    BLOCK_PERIOD_NS,
    BLOCKS_PER_PACKET,
    DATA_PAYLOAD,
    FACTORY_BYTE,
    LASERS,
    MIN_DISTANCE_LSB,
    RETURN_MODE_BYTE,
)
from vlp16emu.types import ReturnMode
from vlp16emu.units import S_NS, US_NS

_UNEQUAL_REFLECTIVITY_SHARE = 0.05
"""Of the equal pairs of a packet; 603 packets of a real unit show 0.03 % overall and 1.1 % at most."""

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
_STILL_CDEG = 12
"""Two readings differ by less than this where the rotor stands; at 300 rpm a packet turns by 220."""
_SET_RPM = 60
"""Speeds that can be set are multiples of this (63-9243 Rev D, section 8.3)."""
_HELD_RPM = 4.0
"""By which the mean of a revolution may be off: speed control, 3 rpm in sibling manuals, and two readings."""

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

_Found = Callable[[int], str]
"""Says what stands in packet i of a chunk."""


class DataChunk:
    """Consecutive data packets of one return mode.

    Parameters
    ----------
    datagrams : at least one
    continues : the first packet was the last one of the chunk before, and stands here as its neighbour only
    ends : no chunk follows that begins with the last packet
    """

    def __init__(self, datagrams: Sequence[Datagram], *, continues: bool, ends: bool) -> None:
        self.continues, self.ends = continues, ends
        self.number, self.stamp_ns = np.array([(each.number, each.stamp_ns) for each in datagrams]).T
        """(n,) frame numbers and capture stamps."""
        payload = np.frombuffer(b"".join(each.payload for each in datagrams), DATA_PAYLOAD)
        blocks = payload["blocks"]
        self.dual = bool(payload["return_mode"][0] == RETURN_MODE_BYTE[ReturnMode.DUAL])
        self.timestamp_us = payload["timestamp_us"].astype(np.int64)
        """(n,)."""
        self.flag, self.azimuth_cdeg = blocks["flag"], blocks["azimuth_cdeg"].astype(np.int64)
        """(n, 12)."""
        records = blocks["records"]
        self.distance_lsb, self.reflectivity = (
            np.ascontiguousarray(records[name]) for name in ("distance_lsb", "reflectivity")
        )
        """(n, 12, 2, 16)."""


def check_factory(number: int, factory: bytes, before: bytes, findings: Findings) -> None:
    """Check return mode and product of a packet, two bytes that differ from those before; before the first there are none."""
    if factory[0] not in RETURN_MODE_BYTE.values():
        findings.add(Rule.FACTORY, number, f"return mode 0x{factory[0]:02x}", "0x37, 0x38 or 0x39")
    if factory[1] not in FACTORY_BYTE.values():
        # In the first packet it may be that of a unit from before release; a change to it is an error below.
        old = factory[1] == PRODUCT_BEFORE_RELEASE and before[1:] in (b"", factory[1:])
        level = Level.NOTE if old else Level.ERROR
        findings.add(Rule.FACTORY, number, f"product 0x{factory[1]:02x}", "0x22 or 0x24", level)
    if before:
        findings.add(Rule.FACTORY, number, f"bytes {factory.hex(' ')}", f"{before.hex(' ')} as before")


def check_codes(chunk: DataChunk, findings: Findings) -> None:
    """Check flags, ranges and codes of each packet, and the pairs of dual return."""

    def add(rule: Rule, broken: NDArray[np.bool_], found: _Found, expected: str, level: Level = Level.ERROR) -> None:
        broken[0] &= not chunk.continues
        findings.add_where(rule, broken, chunk.number, found, expected, level)

    flag, most_cdeg, stamp_us = chunk.flag, chunk.azimuth_cdeg.max(axis=1), chunk.timestamp_us
    bad_flag = flag != BLOCK_FLAG
    at = bad_flag.argmax(axis=1)
    forbidden = (chunk.distance_lsb > 0) & (chunk.distance_lsb < MIN_DISTANCE_LSB)
    count = forbidden.sum(axis=(1, 2, 3))

    def found_flag(i: int) -> str:
        return f"{int(flag[i, at[i]]).to_bytes(2, 'little').hex(' ')} at block {at[i]}"

    def found_azimuth(i: int) -> str:
        return f"azimuth {most_cdeg[i]} at block {chunk.azimuth_cdeg[i].argmax()}"

    def found_distances(i: int) -> str:
        return f"{count[i]} distances as short as {chunk.distance_lsb[i][forbidden[i]].min()} counts"

    codes = f"0 .. {AZIMUTH_CODES - 1}"
    add(Rule.FLAG, bad_flag.any(axis=1), found_flag, "ff ee")
    add(Rule.AZIMUTH_RANGE, most_cdeg > AZIMUTH_CODES, found_azimuth, codes)
    add(Rule.AZIMUTH_RANGE, most_cdeg == AZIMUTH_CODES, found_azimuth, codes, Level.NOTE)
    add(Rule.TIME_RANGE, stamp_us >= HOUR_US, lambda i: f"time stamp {stamp_us[i]} us", f"0 .. {HOUR_US - 1}")
    add(Rule.DISTANCE_CODE, count > 0, found_distances, f"0 or at least {MIN_DISTANCE_LSB}")
    if chunk.dual:
        _check_pairs(chunk, add)


def _check_pairs(chunk: DataChunk, add: Callable[[Rule, NDArray[np.bool_], _Found, str], None]) -> None:
    """Even and odd blocks of dual return. Source: 63-9243 Rev D, section 9.3.2, p. 57."""
    azimuth_cdeg, distance_lsb, reflectivity = chunk.azimuth_cdeg, chunk.distance_lsb, chunk.reflectivity
    twin_differs = azimuth_cdeg[:, ::2] != azimuth_cdeg[:, 1::2]
    last, other = distance_lsb[:, ::2], distance_lsb[:, 1::2]
    swapped = ((last < other) & (last > 0)).sum(axis=(1, 2, 3))
    equal = last == other
    unequal = (equal & (reflectivity[:, ::2] != reflectivity[:, 1::2])).sum(axis=(1, 2, 3))
    pairs, share = equal.sum(axis=(1, 2, 3)), _UNEQUAL_REFLECTIVITY_SHARE

    even = 2 * twin_differs.argmax(axis=1)

    def found_azimuths(i: int) -> str:
        twins = azimuth_cdeg[i, even[i] : even[i] + 2]
        return f"azimuths {twins[0]} and {twins[1]} at blocks {even[i]} and {even[i] + 1}"

    def found_unequal(i: int) -> str:
        return f"{unequal[i]} of {pairs[i]} pairs of equal distance with unequal reflectivity"

    add(Rule.DUAL_AZIMUTH, twin_differs.any(axis=1), found_azimuths, "equal ones")
    nearer, expected = "pairs with the last return nearer than the other", "the last return to be the farther one"
    add(Rule.DUAL_ORDER, swapped > 0, lambda i: f"{swapped[i]} {nearer}", expected)
    add(Rule.DUAL_REFLECTIVITY, unequal > share * pairs, found_unequal, f"at most {share:.0%}")


class _Steps:
    """Azimuth steps of a chunk; row i holds those inside packet i and, at its end, the one to packet i+1.

    The second block of each dual pair is left out.
    """

    def __init__(self, chunk: DataChunk) -> None:
        azimuth_cdeg = chunk.azimuth_cdeg[:, :: 2 if chunk.dual else 1]
        forward_cdeg = np.append(np.diff(azimuth_cdeg.ravel()) % AZIMUTH_CODES, 0)
        self.forward_cdeg: NDArray[np.int64] = forward_cdeg.reshape(azimuth_cdeg.shape)
        """(n, blocks) 0 .. 35999; the very last one leads nowhere and is 0."""
        self.signed_cdeg: NDArray[np.int64] = (
            (self.forward_cdeg + AZIMUTH_CODES // 2 - 1) % AZIMUTH_CODES - AZIMUTH_CODES // 2 + 1
        )
        self.usual_cdeg = np.median(self.forward_cdeg[:, :-1], axis=1, keepdims=True)
        """(n, 1) median inside the packet."""
        self.is_even = np.abs(self.signed_cdeg - self.usual_cdeg) <= _STEP_TOLERANCE_CDEG
        self.is_odd: NDArray[np.bool_] = ~self.is_even | (self.signed_cdeg <= 0)
        """(n, blocks) neither forward nor near the usual step, and not explained."""
        self.is_odd[-1, -1] = False


class SweepRules:
    """Checks time stamps and azimuths, chunk by chunk: what a steady rotor and a steady clock give.

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
        steps = _Steps(chunk)
        is_regular = self._check_time(chunk, steps)
        is_still = self._check_still(chunk, steps)
        steps.is_odd[is_still] = False
        self._check_speed(chunk, steps, is_regular)
        judged = len(chunk.number) if chunk.ends else len(chunk.number) - 1
        self._check_azimuth(chunk, steps, is_still, judged)
        self._measure_speed(chunk, steps, is_regular, judged)

    def _check_time(self, chunk: DataChunk, steps: _Steps) -> NDArray[np.bool_]:
        """Check n - 1 time steps; returns which are regular and excuses azimuths where time explains them."""
        period_ns = BLOCK_PERIOD_NS * steps.forward_cdeg.shape[1]
        step_us = wrap_hour_us(np.diff(chunk.timestamp_us))
        shortest_us = period_ns // US_NS
        is_regular: NDArray[np.bool_] = (step_us == shortest_us) | (step_us == shortest_us + 1)
        periods = np.rint(step_us * US_NS / period_ns).astype(np.int64)
        off_us = np.abs(step_us - periods * period_ns / US_NS)
        is_whole = (periods > 1) & (off_us <= 1 + step_us * _CLOCK_PPM / 1e6)

        left_out_us, is_explained = _left_out(steps, step_us - period_ns / US_NS)
        odd_inside = steps.is_odd[:-1, :-1].any(axis=1)
        is_gap = ~is_regular & is_explained & (odd_inside | ~is_whole)
        is_lost = ~is_regular & is_whole & ~is_gap
        is_broken = ~(is_regular | is_gap | is_lost)

        def found_gap(i: int) -> str:
            return f"{left_out_us[i] / 1e3:.1f} ms of the revolution left out"

        add, after = self._findings.add_where, chunk.number[1:]
        usual = f"+{shortest_us} or +{shortest_us + 1} us"
        add(Rule.LOST_PACKETS, is_lost, after, lambda i: f"{periods[i] - 1} data packets missing before it", "none")
        add(Rule.TIME_STEP, is_broken, after, lambda i: f"time stamp {step_us[i]:+d} us", usual)
        where = np.where(odd_inside, chunk.number[:-1], after)
        add(Rule.AZIMUTH_GAP, is_gap, where, found_gap, "the whole revolution")
        steps.is_odd[:-1][is_gap] = False
        steps.is_odd[:-1, -1] &= is_regular
        if is_broken.any():
            self._clock.restart()
        else:
            self._watch_clock(chunk, np.append(is_gap & odd_inside, False))
        missing = int((periods[is_lost] - 1).sum())
        self.lost_packets += missing
        self.left_out_us += float(left_out_us[is_gap].sum())
        self.covered_us += float(missing + len(step_us)) * period_ns / US_NS
        return is_regular

    def _watch_clock(self, chunk: DataChunk, takes_longer: NDArray[np.bool_]) -> None:
        """Compare time stamps with capture stamps by the chunk's median, which no burst can move.

        Packets (n,) that take longer are those within which a part of the revolution is left out.
        """
        offset_us = chunk.stamp_ns // US_NS - chunk.timestamp_us
        moved_us = wrap_hour_us(offset_us - offset_us[0])
        after_us = np.minimum.accumulate(moved_us[::-1])[::-1]
        late_us = moved_us - np.maximum(np.minimum.accumulate(moved_us), after_us)
        is_late = (late_us > JITTER_US) & ~takes_longer
        expected = f"within {JITTER_US / 1e3:.0f} ms"
        self._findings.add_where(
            Rule.LATENESS, is_late, chunk.number, lambda i: f"{late_us[i] / 1e3:.1f} ms later than others", expected
        )
        middle_us = int(offset_us[0]) + round(float(np.median(moved_us)))
        self._clock.check(int(chunk.number[0]), int(chunk.stamp_ns[0]), middle_us)

    def _check_still(self, chunk: DataChunk, steps: _Steps) -> NDArray[np.bool_]:
        """Find packets (n,) in which the rotor stands, and report them."""
        inside_cdeg = steps.signed_cdeg[:, :-1]
        still: NDArray[np.bool_] = np.abs(inside_cdeg).max(axis=1) <= _STILL_CDEG
        still &= np.abs(inside_cdeg.sum(axis=1)) <= _STILL_CDEG
        reported = still.copy()
        reported[0] &= not chunk.continues

        def found(i: int) -> str:
            return f"azimuth frozen at {chunk.azimuth_cdeg[i, 0] / 100:.2f} deg"

        self._findings.add_where(Rule.AZIMUTH_STEP, reported, chunk.number, found, "a rotor that turns")
        return still

    def _check_speed(self, chunk: DataChunk, steps: _Steps, is_regular: NDArray[np.bool_]) -> None:
        """Check the mean speed of each revolution, over which the error of the encoder goes out."""
        turned_cdeg = steps.signed_cdeg[:-1].sum(axis=1)
        middle_cdeg = float(np.median(turned_cdeg)) if len(turned_cdeg) else 0.0
        if middle_cdeg < 1.0:
            return
        packets = max(round(AZIMUTH_CODES / middle_cdeg), 1)
        rows = len(turned_cdeg) // packets * packets
        whole = is_regular[:rows].reshape(-1, packets).all(axis=1)
        revolution_cdeg = turned_cdeg[:rows].reshape(-1, packets).sum(axis=1)
        took_s = packets * steps.signed_cdeg.shape[1] * BLOCK_PERIOD_NS / S_NS
        rpm = revolution_cdeg / AZIMUTH_CODES / took_s * 60.0
        off_rpm = rpm - _SET_RPM * np.rint(rpm / _SET_RPM)
        is_off, number = whole & (np.abs(off_rpm) > _HELD_RPM), chunk.number[:rows:packets]
        expected = f"a multiple of {_SET_RPM} rpm within {_HELD_RPM:g}, held"
        self._findings.add_where(Rule.SPEED, is_off, number, lambda i: f"a revolution at {rpm[i]:.1f} rpm", expected)

    def _check_azimuth(self, chunk: DataChunk, steps: _Steps, is_still: NDArray[np.bool_], judged: int) -> None:
        """Check the steps of the first `judged` packets."""
        blocks = steps.forward_cdeg.shape[1]
        is_odd = steps.is_odd[:judged]
        if not chunk.dual:
            is_twin = (steps.forward_cdeg[:judged, 0] == 0) & ~is_still[:judged]
            found = "blocks 0 and 1 with one azimuth"
            self._findings.add_where(Rule.SINGLE_AS_DUAL, is_twin, chunk.number, lambda _: found, "two azimuths")
            is_odd[:, 0] &= ~is_twin
        # A step belongs to the packet it leads to.
        packets = np.repeat(chunk.number[:judged, None], blocks, axis=1)
        packets[: len(chunk.number) - 1, -1] = chunk.number[1:]

        def found_step(i: int) -> str:
            row, column = divmod(i, blocks)
            block = (column + 1) % blocks * (BLOCKS_PER_PACKET // blocks)
            return f"azimuth {steps.signed_cdeg[row, column] / 100:+.2f} deg at block {block}"

        usual_cdeg = float(np.median(steps.usual_cdeg))
        expected = f"{usual_cdeg / 100:+.2f} deg within {_STEP_TOLERANCE_CDEG / 100:.2f}"
        self._findings.add_where(Rule.AZIMUTH_STEP, is_odd.ravel(), packets.ravel(), found_step, expected)

    def _measure_speed(self, chunk: DataChunk, steps: _Steps, is_regular: NDArray[np.bool_], judged: int) -> None:
        """Take the mean of the even steps, and check it."""
        is_even = steps.is_even[:judged]
        is_even[: len(is_regular), -1] &= is_regular
        is_even[len(is_regular) :, -1] = False
        even_cdeg = steps.forward_cdeg[:judged][is_even]
        self._turned_cdeg += int(even_cdeg.sum())
        self._turned_steps += len(even_cdeg)
        if len(even_cdeg) < _RPM_STEPS:
            return
        rpm = float(even_cdeg.mean()) / _CDEG_PER_STEP_AND_RPM
        if not _RPM[0] * (1 - _RPM_TOLERANCE) <= rpm <= _RPM[1] * (1 + _RPM_TOLERANCE):
            found, expected = f"{rpm:.1f} rpm from here", f"{_RPM[0]} to {_RPM[1]}"
            self._findings.add(Rule.RPM, int(chunk.number[0]), found, expected)


def _left_out(steps: _Steps, extra_us: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Time that odd azimuth steps of each packet stand for, and whether it explains the extra time (n - 1,) beyond a period."""
    even_cdeg = steps.forward_cdeg[:, :-1][~steps.is_odd[:, :-1]]
    # A mean, because the median of whole numbers is too coarse to turn a gap into time.
    usual_cdeg = max(float(even_cdeg.mean()), 1.0) if len(even_cdeg) else 1.0
    rate_cdeg_us = usual_cdeg / (BLOCK_PERIOD_NS / US_NS)
    is_odd = steps.is_odd[:-1]
    left_out_us = np.where(is_odd, steps.forward_cdeg[:-1] - usual_cdeg, 0.0).sum(axis=1) / rate_cdeg_us
    tolerance_us = _GAP_TOLERANCE_CDEG / rate_cdeg_us + _GAP_TOLERANCE * left_out_us
    return left_out_us, is_odd.any(axis=1) & (np.abs(left_out_us - extra_us) <= tolerance_us)


class OpticsRules:
    """Checks what lasers and sectors of the window return, beside their neighbours and beside the chunk before."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._share = np.zeros(LASERS)
        self._light: NDArray[np.float64] | None = None
        self._dead = frozenset[int]()

    def check(self, chunk: DataChunk) -> None:
        """Check one chunk."""
        if chunk.distance_lsb[..., 0].size < _SHORTEST:
            return
        packet, is_return = int(chunk.number[0]), chunk.distance_lsb > 0
        self._check_lasers(packet, is_return.mean(axis=(0, 1, 2)))
        self._check_sectors(packet, chunk, is_return)

    def _check_lasers(self, packet: int, share: NDArray[np.float64]) -> None:
        """Report lasers without a single return, whose neighbours have many; at the edge, which had them before."""
        of, before = share[_BY_ELEVATION], self._share[_BY_ELEVATION]
        sees = of >= _SEEN
        dead = of == 0
        dead[1:-1] &= sees[:-2] & sees[2:]
        for edge, inner in ((0, 1), (-1, -2)):
            dead[edge] &= before[edge] >= _SEEN and of[inner] >= 0.5 * before[inner] > 0
        found = frozenset(_BY_ELEVATION[dead].tolist()) | {laser for laser in self._dead if share[laser] == 0}
        for laser in sorted(found - self._dead):
            self._findings.add(Rule.LASER, packet, f"laser {laser} without returns", "some, as those beside it")
        self._share, self._dead = share, found

    def _check_sectors(self, packet: int, chunk: DataChunk, is_return: NDArray[np.bool_]) -> None:
        """Report sectors that turn dark from one chunk to the next, while the others stay as they are."""
        sector = (chunk.azimuth_cdeg * _SECTORS // 36_000 % _SECTORS).ravel()
        returns = np.bincount(sector, is_return.sum(axis=(2, 3)).ravel(), _SECTORS)
        blocks = np.bincount(sector, minlength=_SECTORS)
        reflectivity = np.where(is_return, chunk.reflectivity, 0).sum(axis=(2, 3), dtype=np.int64)
        light = np.bincount(sector, reflectivity.ravel(), _SECTORS)
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
            found = f"{ratio[run].mean():.2f} of the light from {begin} to {end} deg, as behind a dirty window"
            self._findings.add(Rule.WINDOW, packet, found, "about as much as before")
