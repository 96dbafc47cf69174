"""Data and position packets as columns of a chunk, and their rules.

Source: 63-9243 Rev D, section 9.3, and captures of real units.
"""

import math
import re
from collections.abc import Sequence
from functools import lru_cache, reduce
from operator import xor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures.datagrams import Datagram
from vlp16emu.extras.verify.clocks import LEAP_SECOND, SILENCE_US, ClockWatch, GpsGains
from vlp16emu.extras.verify.frames import (
    HOUR_US,
    JITTER_US,
    SENTENCE_OFFSET,
    TABLES,
    Findings,
    Rule,
    is_rewritten,
)
from vlp16emu.extras.verify.speed import SpeedRules
from vlp16emu.packets import layout
from vlp16emu.packets.decode import is_before_release, is_dual, layouts_of
from vlp16emu.packets.layout import POSITION_PAYLOAD, layout_of
from vlp16emu.packets.table import PacketTable, wrap_hour
from vlp16emu.types import F8, I8, AnyArray, PpsState, ReturnMode, SensorModel
from vlp16emu.units import MS_NS, S_NS, US_NS

_UNEQUAL_REFLECTIVITY_SHARE = 0.05
"""Limit of the share of a packet's equal pairs; 603 packets of a real unit have 0.03 % overall and 1.1 % at
most."""

_STEP_TOLERANCE_CDEG = 6
"""Real units read azimuths with 0.5 cdeg of noise, so steps have 0.8 cdeg of noise; the greatest error seen
is 4.5 cdeg."""
_GAP_TOLERANCE_CDEG = 26
"""Difference between the azimuth and the time left out: 9 cdeg of once-per-revolution error, as on real
units, at either end, and the noise of two readings and a step."""
_GAP_TOLERANCE = 0.005  # additional difference in proportion to the gap, for speed control: 3 rpm in 600
_CLOCK_PPM = 10  # short-term rate error of a clock that follows GPS

_RPM_TOLERANCE = 0.01
"""Speed control, 3 rpm in sibling manuals, and the once-per-revolution error of the encoder."""
_RPM_STEPS = 100  # least number of steps to judge the speed
_CDEG_PER_NS_AND_RPM = 6 * 100 / 1e9
_STILL_CDEG = 12
"""Two readings differ by less than this if the rotor stands; at 300 rpm a packet turns by 220."""

_SHORTEST = 300  # firing sequences: fewer may all point into the sky
_SEEN = 0.1  # least share of pulses with a return for a laser that sees a surface
_SECTORS = 36
_SECTOR_RETURNS = 300  # least number of returns to judge a sector
_SECTOR_BLOCKS = 20  # least number of blocks; a whole revolution has more in each sector
_DARKER = 0.35
"""Light of a sector as a share of its earlier light; dirt that transmits 0.5 gives 0.25, as light passes it
twice."""
_STEADY = 0.25  # greatest median change of the sectors while one turns dark


class DataChunk:
    """Columns of n consecutive data packets of one return mode, and of the steps from packet to packet.

    Parameters
    ----------
    table : the packets, at least one
    before : factory bytes of the packet before the first; empty if there is none
    gains : times at which GPS was gained
    continues : True if the first packet was the last one of the chunk before, and is here only as a neighbour
    ends : True if no chunk follows that begins with the last packet
    """

    products = layout.PRODUCT_WORDS
    unequal_share = _UNEQUAL_REFLECTIVITY_SHARE
    tolerance_deg = _STEP_TOLERANCE_CDEG / 100
    jitter_ms = JITTER_US / 1e3

    def __init__(
        self, table: PacketTable, before: bytes, gains: GpsGains, *, continues: bool, ends: bool
    ) -> None:
        n = len(table)
        self.added = slice(1 if continues else 0, n)  # packets whose codes no earlier chunk has judged
        self.judged = slice(0, n if ends else n - 1)
        """Packets whose azimuths are judged; only the next chunk has the neighbour of the last packet."""
        blocks = table["blocks"]
        self.number = table["number"]
        self.stamp_ns = table["arrival_ns"]
        self.dual = bool(is_dual(table)[0])
        self._is_prototype = is_before_release(table)
        self.layout = layouts_of(table, SensorModel.VLP_16 if self._is_prototype else None)[self.dual]
        self.timestamp_us = table["timestamp_us"].astype(np.int64)
        self.flag = blocks["flag"]  # (n, 12)
        azimuth_cdeg = self.layout.by_reading(blocks["azimuth_cdeg"].astype(np.int64))[:, :, 0]
        self.azimuth_cdeg: I8 = azimuth_cdeg.reshape(n, -1)
        """(n, b) of the first block of each reading and copy, on a VLP-16 of all twelve blocks."""
        self.distance_lsb = self.layout.by_laser(blocks["records"]["distance_lsb"])
        """(n, b, firing sequences of a reading, L), on a VLP-16 (n, 12, 2, 16), like the next one."""
        self.reflectivity = self.layout.by_laser(blocks["records"]["reflectivity"])
        self.mode = table["return_mode"]
        self.product = table["factory"]
        self._read_factory(before)
        self._read_codes()
        if self.dual:
            self._read_pairs()
        self._read_steps()
        self._read_times(gains)
        self._read_revolutions()

    def _read_factory(self, before: bytes) -> None:
        """Find changes of return mode and product; findings of the chunk before are not repeated."""
        mode, product = before or (self.mode[0], self.product[0])
        self.mode_before = np.append(np.uint8(mode), self.mode[:-1])
        self.product_before = np.append(np.uint8(product), self.product[:-1])
        new_mode = self.mode != self.mode_before
        new_product = self.product != self.product_before
        is_new = new_mode | new_product
        modes = [*layout.RETURN_MODE_BYTE.values()]
        self.is_set = new_mode & ~new_product & np.isin(self.mode, modes) & np.isin(self.mode_before, modes)
        self.is_changed = is_new & ~self.is_set
        is_new[0] |= not before
        self.is_no_mode = is_new & ~np.isin(self.mode, modes)
        self.is_no_product = is_new & ~np.isin(self.product, [*layout.PRODUCTS])
        self.is_old_product = is_new & self._is_prototype & ~new_product

    def _read_codes(self) -> None:
        """Find codes outside their limits."""
        packet = np.arange(len(self.number))
        right_flag = np.array(self.layout.model.flags)[:, None]
        is_no_flag = (self.layout.by_reading(self.flag) != right_flag).reshape(len(packet), -1)
        self.azimuth = self.azimuth_cdeg.max(axis=1)
        self.is_no_flag = is_no_flag.any(axis=1)
        self.flag_block = is_no_flag.argmax(axis=1)
        self.flag_found = self.flag[packet, self.flag_block].byteswap()
        self.azimuth_block = self.azimuth_cdeg.argmax(axis=1)
        self.first_deg = self.azimuth_cdeg[:, 0] / 100
        self.is_past_turn = self.azimuth > layout.AZIMUTH_CODES
        self.is_full_turn = self.azimuth == layout.AZIMUTH_CODES
        self.is_past_hour = self.timestamp_us >= HOUR_US
        self.least = self.layout.model.minimum_lsb
        is_short = (self.distance_lsb > 0) & (self.distance_lsb < self.least)
        self.short = is_short.sum(axis=(1, 2, 3))
        self.has_short = self.short > 0
        self.shortest = np.where(is_short, self.distance_lsb, self.least).min(axis=(1, 2, 3))

    def _read_pairs(self) -> None:
        """Find pairs whose blocks disagree: even and odd ones (63-9243 Rev D, section 9.3.2, p. 57)."""
        packet = np.arange(len(self.number))
        is_apart = self.azimuth_cdeg[:, ::2] != self.azimuth_cdeg[:, 1::2]
        self.is_apart = is_apart.any(axis=1)
        pair = is_apart.argmax(axis=1)
        self.even = 2 * pair
        self.odd = 2 * pair + 1
        self.even_cdeg = self.azimuth_cdeg[packet, self.even]
        self.odd_cdeg = self.azimuth_cdeg[packet, self.odd]
        last = self.distance_lsb[:, ::2]
        other = self.distance_lsb[:, 1::2]
        self.swapped = ((last < other) & (last > 0)).sum(axis=(1, 2, 3))
        self.has_swapped = self.swapped > 0
        equal = last == other
        is_unequal = equal & (self.reflectivity[:, ::2] != self.reflectivity[:, 1::2])
        self.unequal = is_unequal.sum(axis=(1, 2, 3))
        self.pairs = equal.sum(axis=(1, 2, 3))
        self.has_unequal = self.unequal > _UNEQUAL_REFLECTIVITY_SHARE * self.pairs

    def _read_steps(self) -> None:
        """Find the azimuth steps inside packet i and, in the last column, the one to packet i + 1.

        The second block of each dual pair is left out.
        """
        azimuth_cdeg = self.azimuth_cdeg[:, :: 2 if self.dual else 1]
        forward_cdeg = np.append(np.diff(azimuth_cdeg.ravel()) % layout.AZIMUTH_CODES, 0)
        self.forward_cdeg: I8 = forward_cdeg.reshape(azimuth_cdeg.shape)
        """(n, blocks) 0 .. 35999; the very last one has no end and is 0."""
        half = layout.AZIMUTH_CODES // 2
        self.signed_cdeg: I8 = (self.forward_cdeg + half - 1) % layout.AZIMUTH_CODES - half + 1
        self._inside = slice(max(self.layout.readings - 1, 1))
        """Columns of the steps that belong to a packet alone, or of the step to the next one if it has one
        reading."""
        self.usual_cdeg = np.median(self.forward_cdeg[:, self._inside], axis=1, keepdims=True)
        if self.layout.readings == 1:
            self.usual_cdeg[:] = np.median(self.usual_cdeg)
        self.is_even = np.abs(self.signed_cdeg - self.usual_cdeg) <= _STEP_TOLERANCE_CDEG
        self.is_odd: NDArray[np.bool_] = ~self.is_even | (self.signed_cdeg <= 0)
        """(n, blocks) neither forward nor near the usual step; `_read_times` clears those that time
        explains."""
        self.is_odd[-1, -1] = False
        inside_cdeg = self.signed_cdeg[:, self._inside]
        self.is_still = np.abs(inside_cdeg).max(axis=1) <= _STILL_CDEG
        self.is_still &= np.abs(inside_cdeg.sum(axis=1)) <= _STILL_CDEG
        if self.layout.readings == 1:  # one slow step is as short as two readings of a rotor that stands
            self.is_still &= len(inside_cdeg) > 1 and abs(int(inside_cdeg.sum())) <= _STILL_CDEG
        blocks = azimuth_cdeg.shape[1]
        self.step_number = np.repeat(self.number[:, None], blocks, axis=1)
        self.step_number[:-1, -1] = self.number[1:]  # a step belongs to the packet at its end
        self.step_deg = self.signed_cdeg / 100
        self.usual_deg = float(np.median(self.usual_cdeg)) / 100
        end_block = np.roll(np.arange(0, layout.BLOCKS_PER_PACKET, layout.BLOCKS_PER_PACKET // blocks), -1)
        self.step_block = np.broadcast_to(end_block, self.step_deg.shape)

    def _read_times(self, gains: GpsGains) -> None:
        """Find which of the n - 1 steps of time are regular, and excuse azimuths that time explains."""
        self.after = self.number[1:]
        self.step_us: I8 = wrap_hour(np.diff(self.timestamp_us), HOUR_US)
        self.low_us, self.high_us = self.layout.steps_us
        self.period_ns = self.layout.measured_period_ns(self.step_us)
        self.reading_ns = self.period_ns // self.layout.readings
        is_regular = (self.step_us >= self.low_us) & (self.step_us <= self.high_us)
        self.is_regular: NDArray[np.bool_] = np.asarray(is_regular)
        periods = np.rint(self.step_us * US_NS / self.period_ns).astype(np.int64)
        self.missing = periods - 1
        off_us = np.abs(self.step_us - periods * self.period_ns / US_NS)
        apart_us = np.abs(self.step_us - np.diff(self.stamp_ns) // US_NS)
        # A step of the sensor's clock that the host does not see is no loss of packets.
        off_most_us = self.high_us - self.low_us + self.step_us * _CLOCK_PPM / 1e6
        is_whole = (periods > 1) & (off_us <= off_most_us) & (apart_us <= SILENCE_US)
        is_explained = self._explain(self.step_us - self.period_ns / US_NS)
        odd_inside = self.is_odd[:-1, :-1].any(axis=1)
        self.is_gap = ~self.is_regular & is_explained & (odd_inside | ~is_whole)
        self.is_clock_set = ~self.is_regular & ~self.is_gap & (apart_us > JITTER_US)
        self.is_clock_set &= gains.near(self.stamp_ns[1:])
        self.is_lost = ~self.is_regular & is_whole & ~self.is_gap & ~self.is_clock_set
        self.is_broken = ~(self.is_regular | self.is_gap | self.is_lost | self.is_clock_set)
        self.gap_number = np.where(odd_inside, self.number[:-1], self.after)
        gaps_cdeg = self.forward_cdeg[:-1][self.is_gap][self.is_odd[:-1][self.is_gap]]
        if len(gaps_cdeg):  # the last packet has no time step that would explain its gap
            off_cdeg = np.abs(self.forward_cdeg[-1][:, None] - gaps_cdeg).min(axis=1)
            self.is_odd[-1] &= off_cdeg > _GAP_TOLERANCE_CDEG
        self.is_odd[:-1][self.is_gap] = False
        self.is_odd[:-1, -1] &= self.is_regular
        self.is_odd[self.is_still] = False
        self.is_twin = (self.forward_cdeg[:, 0] == 0) & ~self.is_still & (not self.dual)
        self.is_odd[:, 0] &= ~self.is_twin
        self._find_late(contains_gap=np.append(self.is_gap & odd_inside, False))

    def _explain(self, extra_us: AnyArray) -> NDArray[np.bool_]:
        """Find where the odd azimuth steps of a packet account for the time (n - 1,) beyond a period."""
        even_cdeg = self.forward_cdeg[:, self._inside][~self.is_odd[:, self._inside]]
        # A mean, because the median of integers is too coarse to convert a gap to time.
        usual_cdeg = max(float(even_cdeg.mean()), 1.0) if len(even_cdeg) else 1.0
        rate_cdeg_us = usual_cdeg / (self.reading_ns / US_NS)
        is_odd = self.is_odd[:-1]
        gap_us = np.where(is_odd, self.forward_cdeg[:-1] - usual_cdeg, 0.0).sum(axis=1) / rate_cdeg_us
        tolerance_us = _GAP_TOLERANCE_CDEG / rate_cdeg_us + _GAP_TOLERANCE * gap_us
        self.gap_ms = gap_us / 1e3
        return np.asarray(is_odd.any(axis=1) & (np.abs(gap_us - extra_us) <= tolerance_us))

    def _find_late(self, contains_gap: NDArray[np.bool_]) -> None:
        """Compare time stamps with capture stamps.

        Packets (n,) that contain a gap of the revolution take longer, and are not late.
        """
        offset_us = self.stamp_ns // US_NS - self.timestamp_us
        moved_us = wrap_hour(offset_us - offset_us[0], HOUR_US)
        after_us = np.minimum.accumulate(moved_us[::-1])[::-1]
        late_us = moved_us - np.maximum(np.minimum.accumulate(moved_us), after_us)
        self.late_ms = late_us / 1e3
        is_sound = not (self.is_broken | self.is_clock_set).any()
        self.is_late = (late_us > JITTER_US) & ~contains_gap & is_sound
        self.offset_us = int(offset_us[0]) + round(float(np.median(moved_us)))
        """Clock offset of the whole chunk: a median, which a burst does not change."""

    def _read_revolutions(self) -> None:
        """Find the mean speed of each revolution, in which the error of the encoder cancels."""
        turned_cdeg = self.signed_cdeg[:-1].sum(axis=1)
        usual_cdeg = float(np.median(turned_cdeg)) if len(turned_cdeg) else 0.0
        packets = len(self.number)
        if usual_cdeg >= 1.0:
            packets = max(round(layout.AZIMUTH_CODES / usual_cdeg), 1)
        rows = len(turned_cdeg) // packets * packets
        is_whole = self.is_regular[:rows].reshape(-1, packets).all(axis=1)
        self.is_whole_revolution: NDArray[np.bool_] = np.asarray(is_whole)
        revolution_cdeg = turned_cdeg[:rows].reshape(-1, packets).sum(axis=1)
        self.rpm = revolution_cdeg / layout.AZIMUTH_CODES / (packets * self.period_ns / S_NS) * 60.0
        self.revolution_number = self.number[:rows:packets]
        is_even = self.is_even.copy()
        is_even[:-1, -1] &= self.is_regular
        is_even[-1, -1] = False
        self.even_steps_cdeg = self.forward_cdeg[self.judged][is_even[self.judged]]


class DataRules:
    """Rules of data packets, checked chunk by chunk, with the state that spans chunks."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._clock = ClockWatch(findings)
        self._optics = OpticsRules(findings)
        self._speed = SpeedRules(findings)
        self.lost_packets = 0
        self.covered_us = 0.0  # time spanned by the packets, lost ones included
        self.left_out_us = 0.0  # time without packets because of a limited field of view
        self.layout = layout_of(SensorModel.VLP_16, ReturnMode.STRONGEST)  # of the last chunk
        self._turned_cdeg = self._turned_ns = 0

    @property
    def rpm(self) -> float | None:
        """Mean speed over all even steps; None if there are none."""
        return self._turned_cdeg / (self._turned_ns * _CDEG_PER_NS_AND_RPM) if self._turned_ns else None

    def check(self, chunk: DataChunk) -> None:
        """Check one chunk.

        The last packet is judged with the next chunk, if there is one, which has its neighbour.
        """
        apply = self._findings.apply
        apply(TABLES["packets"] + TABLES["pairs"] * chunk.dual, chunk, chunk.added)
        apply(TABLES["steps"], chunk)
        apply(TABLES["azimuths"], chunk, chunk.judged)
        if (chunk.is_broken | chunk.is_clock_set).any():
            self._clock.restart()
        else:
            self._clock.check(int(chunk.number[0]), int(chunk.stamp_ns[0]), chunk.offset_us)
        lost = int(chunk.missing[chunk.is_lost].sum())
        self.lost_packets += lost
        self.left_out_us += float(chunk.gap_ms[chunk.is_gap].sum()) * 1e3
        self.covered_us += float(lost + len(chunk.step_us)) * chunk.period_ns / US_NS
        self._turned_cdeg += int(chunk.even_steps_cdeg.sum())
        self._turned_ns += len(chunk.even_steps_cdeg) * chunk.reading_ns
        self.layout = chunk.layout
        if len(chunk.even_steps_cdeg) >= _RPM_STEPS:
            rpm = float(chunk.even_steps_cdeg.mean()) / (chunk.reading_ns * _CDEG_PER_NS_AND_RPM)
            least_rpm, most_rpm = chunk.layout.model.rpm
            if not least_rpm * (1 - _RPM_TOLERANCE) <= rpm <= most_rpm * (1 + _RPM_TOLERANCE):
                found = f"{rpm:.1f} rpm from here"
                expected = f"{least_rpm} to {most_rpm}"
                self._findings.add(Rule.RPM, int(chunk.number[0]), found, expected)
        self._speed.check(chunk.revolution_number, chunk.rpm, chunk.is_whole_revolution)
        self._optics.check(chunk)

    def finish(self) -> None:
        """Judge what the end of the capture decides."""
        self._speed.finish()


class OpticsRules:
    """Rules of the returns of lasers and of sectors of the window.

    Both are compared with their neighbours and with the chunk before.
    """

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._share = np.zeros(0)
        self._light: F8 | None = None
        self._dead = frozenset[int]()

    def check(self, chunk: DataChunk) -> None:
        """Check one chunk."""
        if chunk.distance_lsb[..., 0].size < _SHORTEST:
            return
        packet = int(chunk.number[0])
        is_return = chunk.distance_lsb > 0
        by_elevation = np.argsort(chunk.layout.model.beams.elevation_deg)
        self._check_lasers(packet, is_return.mean(axis=(0, 1, 2)), by_elevation)
        self._check_sectors(packet, chunk, is_return)

    def _check_lasers(self, packet: int, share: F8, by_elevation: I8) -> None:
        """Report lasers without any return whose neighbours have many.

        A laser at the edge, with one neighbour, is reported if it had returns before.
        """
        before = self._share if len(self._share) == len(share) else np.zeros(len(share))
        upward = share[by_elevation]
        before = before[by_elevation]
        sees = upward >= _SEEN
        dead = upward == 0
        dead[1:-1] &= sees[:-2] & sees[2:]
        for edge, inner in ((0, 1), (-1, -2)):
            dead[edge] &= before[edge] >= _SEEN and upward[inner] >= 0.5 * before[inner] > 0
        found = frozenset(by_elevation[dead].tolist())
        found |= {laser for laser in self._dead if laser < len(share) and share[laser] == 0}
        for laser in sorted(found - self._dead):
            self._findings.add(
                Rule.LASER, packet, f"laser {laser} without returns", "some, as those beside it"
            )
        self._share = share
        self._dead = found

    def _check_sectors(self, packet: int, chunk: DataChunk, is_return: NDArray[np.bool_]) -> None:
        """Report sectors that turn dark from one chunk to the next while the others do not change."""
        sector = (chunk.azimuth_cdeg * _SECTORS // 36_000 % _SECTORS).ravel()
        returns = np.bincount(sector, is_return.sum(axis=(2, 3)).ravel(), _SECTORS)
        blocks = np.bincount(sector, minlength=_SECTORS)
        reflectivity = np.where(is_return, chunk.reflectivity, 0).sum(axis=(2, 3), dtype=np.int64)
        light = np.bincount(sector, reflectivity.ravel(), _SECTORS)
        known = blocks >= _SECTOR_BLOCKS
        mean = np.divide(light, blocks, out=np.zeros(_SECTORS), where=known)
        # A sector that is too dark to be judged gives no reference for the next chunk.
        before = self._light
        self._light = np.where(returns >= _SECTOR_RETURNS, mean, 0.0)
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


_SHORTEST_INTERVAL_NS = 1_400_000  # real units leave 1.47 ms or more between position packets
_UNEVEN_S = 0.25  # difference between the delays of two sentences of one receiver
_NEXT_NS = 50 * MS_NS  # position packets farther apart than this do not show the time of a sentence
_SENTENCE_CHARACTERS = 82  # longest sentence of NMEA 0183
_SENTENCE = re.compile(
    rb"\$(?P<talker>[A-Z]{2})RMC,"
    rb"((?P<time>([01]\d|2[0-3])[0-5]\d[0-5]\d|%b)(\.\d*)?)?,"
    rb"(?=(?P<status>[AV]),)"
    rb"(A,\d{4}(\.\d*)?,[NS],\d{5}(\.\d*)?,[EW]|V,(\d{4}(\.\d*)?)?,[NS]?,(\d{5}(\.\d*)?)?,[EW]?),"
    rb"(\d+(\.\d*)?)?,(\d+(\.\d*)?)?,"  # speed, course
    rb"([0-3]\d[01]\d\d\d)?,"
    rb"(\d+(\.\d*)?)?,[EW]?"  # magnetic variation
    rb"(,[ADEFMNPRS]?(,[SCUV]?)?)?"
    % LEAP_SECOND  # mode since NMEA 0183 version 2.3, navigational status since 4.1
)


class _Sentence(NamedTuple):
    """Contents of a sentence, and the texts of its faults, empty without a fault."""

    second: int = -1  # past the hour; -1 if the sentence has no time
    status: str = ""
    malformed: str = ""
    end: str = ""
    checksum: str = ""
    right: str = ""  # the correct checksum
    is_leap: bool = False
    talker: str = ""  # talker of a receiver with more systems than GPS, which the manual does not name


class PositionChunk:
    """Columns of n consecutive position packets.

    The first one is the last packet of the chunk `before`, already judged.
    """

    head_bytes = 14
    """Other sensors of the family report motion from here on; software detects the VLP-16 by the zeros."""
    latest_s = 2
    """The sentence of a second arrives during the next one; until then the sentence before is repeated."""

    def __init__(self, datagrams: Sequence[Datagram], before: "PositionChunk | None") -> None:
        self.last = datagrams[-1]
        packets = [before.last, *datagrams] if before else list(datagrams)
        self.added = slice(1 if before else 0, None)  # without the packet of the chunk before
        self.number, self.stamp_ns, self.identification = np.array(
            [(packet.number, packet.stamp_ns, packet.identification) for packet in packets]
        ).T
        payload = np.frombuffer(b"".join(packet.payload for packet in packets), np.uint8)
        payload = payload.reshape(len(packets), -1)
        fields = payload.view(POSITION_PAYLOAD)[:, 0]
        self.head = payload[:, : self.head_bytes].max(axis=1)
        self.has_head = self.head > 0
        self.timestamp_us = fields["timestamp_us"].astype(np.int64)
        self.pps = fields["pps"]
        self.clock_s = self.timestamp_us * US_NS / S_NS
        self.is_past_hour = self.timestamp_us >= HOUR_US
        self.state = np.array([*map(str.lower, PpsState.__members__), ""])[self.pps.clip(0, len(PpsState))]
        self.is_no_state = self.pps >= len(PpsState)
        is_error = self.pps == PpsState.ERROR
        state_before = np.append(PpsState.ABSENT, self.pps[:-1])
        was_locked = state_before == PpsState.LOCKED
        self.is_lost_lock = was_locked & (self.pps != state_before) & ~self.is_no_state
        self.is_error = is_error & (state_before != PpsState.ERROR) & ~self.is_lost_lock
        self._read_counts(packets)
        self._read_sentences(packets, before)

    def _read_counts(self, packets: Sequence[Datagram]) -> None:
        """Find lost packets by the identification, which counts on unless VeloView has replaced it."""
        self.due = np.append(self.identification[0], (self.identification[:-1] + 1) % 0x10000)
        self.missing = (self.identification - self.due) % 0x10000
        possible = np.diff(self.stamp_ns, prepend=self.stamp_ns[0]).clip(0) // _SHORTEST_INTERVAL_NS
        is_counted = np.array([not is_rewritten(packet) for packet in packets])
        self.is_lost = (self.missing > 0) & (self.missing <= possible) & is_counted
        self.is_no_count = (self.missing > possible) & is_counted

    def _read_sentences(self, packets: Sequence[Datagram], before: "PositionChunk | None") -> None:
        """Read the sentences, and compare their seconds with the clock and with earlier sentences."""
        areas = [packet.payload[SENTENCE_OFFSET:] for packet in packets]
        index = {area: place for place, area in enumerate(dict.fromkeys(areas))}  # a second has some hundred
        index_of = np.array([index[area] for area in areas])
        columns = [np.array(column)[index_of] for column in zip(*map(_read_sentence, index), strict=True)]
        self.second, self.status, self.malformed, self.end, self.checksum, self.right, is_leap, talker = (
            columns
        )
        self.talker = np.where(talker == np.append("", talker[:-1]), "", talker)
        times = [
            f"{sentence.second // 60:02d}:{sentence.second % 60:02d}"
            for sentence in map(_read_sentence, index)
        ]
        self.time = np.array(times)[index_of]
        is_locked = self.pps == PpsState.LOCKED
        is_known = self.second >= 0
        self.is_missing = is_locked & np.array([not any(area) for area in areas])
        place = np.maximum.accumulate(np.where(is_known, np.arange(len(packets)), -1))
        second_before = before.latest_second if before else -1
        latest_second = np.where(place >= 0, self.second[place], second_before)
        earlier = np.append(second_before, latest_second[:-1])
        self.latest_second: int = latest_second[-1]  # named by a sentence so far; -1 if none has a time
        self.is_void = is_known & (self.status == "V") & (self.second != earlier)
        self.delay_s = (self.clock_s - self.second) % 3600
        # After a leap second a clock that did not take it is a second ahead.
        is_after = np.logical_or.accumulate(is_leap) | (before.has_leapt if before else False)
        self.has_leapt: bool = bool(is_after[-1])
        is_old = is_known & (self.delay_s >= self.latest_s + is_after)
        self.is_old = _first_of_runs(is_old & is_locked)
        self.is_off = _first_of_runs(is_old & ~is_locked & (self.status == "A"))
        is_next = is_locked & is_known & ~is_old & (earlier >= 0) & (self.second == (earlier + 1) % 3600)
        is_next[1:] &= np.diff(self.stamp_ns) < _NEXT_NS
        delays_s = self.delay_s[self.added][is_next[self.added]]
        self.usual_delay_s: float = before.usual_delay_s if before else math.nan
        if math.isnan(self.usual_delay_s) and len(delays_s):
            self.usual_delay_s = float(delays_s[0])
        off_s = np.abs(self.delay_s - self.usual_delay_s)
        self.is_uneven = is_next & (off_s > _UNEVEN_S) & ~(is_after & (np.abs(off_s - 1.0) <= _UNEVEN_S))


def _first_of_runs(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the first of each run of consecutive packets in a mask (n,)."""
    return np.asarray(mask & ~np.append(False, mask[:-1]))


class PositionRules:
    """Rules of position packets, checked chunk by chunk."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._clock = ClockWatch(findings)
        self._before: PositionChunk | None = None
        self.void_sentences = 0  # seconds whose sentence has the status V
        self.lost_packets = 0

    def check(self, datagrams: Sequence[Datagram], gains: GpsGains) -> None:
        """Check packets of 512 bytes; GPS may set their clock when it is gained."""
        chunk = self._before = PositionChunk(datagrams, self._before)
        self._findings.apply(TABLES["positions"], chunk, chunk.added)
        step_us = wrap_hour(np.diff(chunk.timestamp_us, prepend=chunk.timestamp_us[0]), HOUR_US)
        host_step_us = np.diff(chunk.stamp_ns, prepend=chunk.stamp_ns[0]) // US_NS
        is_set = (np.abs(step_us - host_step_us) > JITTER_US) & gains.near(chunk.stamp_ns)
        columns = chunk.timestamp_us[chunk.added].tolist(), is_set[chunk.added].tolist()
        for datagram, timestamp_us, is_new in zip(datagrams, *columns, strict=True):
            if is_new:
                self._clock.restart()
            self._clock.check(datagram.number, datagram.stamp_ns, datagram.stamp_ns // US_NS - timestamp_us)
        self.void_sentences += int(chunk.is_void[chunk.added].sum())
        self.lost_packets += int(chunk.missing[chunk.added][chunk.is_lost[chunk.added]].sum())


@lru_cache(16)
def _read_sentence(area: bytes) -> _Sentence:
    """Read a sentence from its first character to the end of the payload.

    Some 146 packets repeat one sentence.
    """
    if not any(area):
        return _Sentence()
    text, _, rest = area.partition(b"\0")
    end = "" if text.endswith(b"\r\n") else f"an end of {text[-4:]!r}"
    if any(rest):
        end = "characters after a NUL"
    body, star, checksum = text.rstrip(b"\r\n").rpartition(b"*")
    match = _SENTENCE.fullmatch(body)
    if match is None or not star:
        return _Sentence(malformed=repr(text[:_SENTENCE_CHARACTERS]), end=end)
    time = match["time"]
    talker = match["talker"].decode()
    right = f"{reduce(xor, body[1:]):02X}"
    found = checksum.decode("ascii", "replace")
    return _Sentence(
        second=(60 * int(time[2:4]) + int(time[4:])) % 3600 if time else -1,
        is_leap=time == LEAP_SECOND,
        status=match["status"].decode(),
        end=end,
        checksum="" if found == right else found or "of no digits",
        right=right,
        talker="" if talker == "GP" else talker,
    )
