"""Stamps of the recording host, judged by the sensor's own stamps, and fitted to them.

Packets arrive late, never early. So the host's clock as a function of the sensor's is the line of least total
delay under all arrivals (Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay
measurements", INFOCOM 1999), piecewise over gaps and steps of either clock.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vlp16emu.kernels.compiler import kernel
from vlp16emu.types import F8, I8
from vlp16emu.units import S_NS, US_NS

_PACE_SHARE = 0.6
"""Share of the steps that are too short or too long for the sensor's pace from which on stamps are no pace:
a network card that passes on packets in pairs makes half of them short."""
_PACE_FACTOR = 2.0
_BATCH_NS = S_NS // 4  # longest batch that a short capture may begin or end with
_GAP_NS = S_NS
_WINDOW_NS = S_NS  # holds the least delay of some batches of 200 ms
_STEP_NS = 20_000_000  # a greater change of the least delay from second to second is a step of a clock
_LEAST_S = 10.0  # shorter parts have the rate of the longest part, or 1
_MOST_PPM = 500.0  # rates beyond it are no rates of two quartzes
_RUNS = 0.1  # greatest relative difference of both clocks over a capture
_MOST_LATE = 2**15  # delays that are kept for their median: those of all packets of 43 s


@dataclass(frozen=True, slots=True)
class HostStamps:
    """Judgement of the host's stamps of one unit: whether they can be the sensor's pace.

    Stamps of converters may be missing, equal, microseconds apart or whole seconds; recorders may stamp in
    batches.
    """

    steps: int = 0  # between packets in which the sensor's clock went on
    short: int = 0  # steps of less than half the sensor's
    long: int = 0  # steps of more than twice the sensor's
    equal: int = 0
    host_ns: int = 0  # sums of the steps
    sensor_ns: int = 0

    @classmethod
    def of(cls, host_ns: I8, sensor_ns: I8) -> "HostStamps":
        """Judge the stamps (n,) of data packets by their times (n,) on the sensor's clock."""
        step_ns = np.diff(sensor_ns)
        goes_on = (step_ns > 0) & (step_ns <= _GAP_NS)
        step_ns = step_ns[goes_on]
        host_step_ns = np.diff(host_ns)[goes_on]
        is_kept = np.abs(host_step_ns - step_ns) <= _GAP_NS  # else one of the clocks was set
        return cls(
            steps=len(step_ns),
            short=int(np.count_nonzero(host_step_ns * _PACE_FACTOR < step_ns)),
            long=int(np.count_nonzero(host_step_ns > step_ns * _PACE_FACTOR)),
            equal=int(np.count_nonzero(host_step_ns == 0)),
            host_ns=int(host_step_ns[is_kept].sum()),
            sensor_ns=int(step_ns[is_kept].sum()),
        )

    def __add__(self, other: "HostStamps") -> "HostStamps":
        """Return the judgement of both."""
        return HostStamps(
            steps=self.steps + other.steps,
            short=self.short + other.short,
            long=self.long + other.long,
            equal=self.equal + other.equal,
            host_ns=self.host_ns + other.host_ns,
            sensor_ns=self.sensor_ns + other.sensor_ns,
        )

    @property
    def fault(self) -> str | None:
        """Reason why they cannot be the sensor's pace; None if they can."""
        least = _PACE_SHARE * self.steps
        if not self.steps or max(self.short, self.long) <= least:
            return None
        if self.equal == self.steps:
            return "all host stamps are equal"
        mean_us = self.host_ns / self.steps / US_NS
        true_us = self.sensor_ns / self.steps / US_NS
        if not self.runs:
            return f"host stamps are {mean_us:.3g} us apart, and the sensor's packets {true_us:.0f} us"
        late_ms = mean_us * self.steps / max(self.steps - self.short, 1) / 1000
        return f"host stamps come in batches {late_ms:.3g} ms apart"

    @property
    def runs(self) -> bool:
        """True if on the whole the stamps go on like the sensor's clock."""
        most_ns = max(_RUNS * self.sensor_ns, min(_BATCH_NS, self.sensor_ns // 2))
        return abs(self.host_ns - self.sensor_ns) <= most_ns


@dataclass(frozen=True, slots=True)
class FittedPart:
    """A line through the least delays of packets between two gaps or steps of a clock."""

    first: int  # frame number of its first packet
    sensor_ns: int  # an instant on the sensor's clock
    host_ns: int  # the same instant on the host's clock
    rate: float  # host seconds per second of the sensor

    def host_at(self, sensor_ns: int) -> int:
        """Return the host's time of an instant on the sensor's clock."""
        since_ns = sensor_ns - self.sensor_ns
        return self.host_ns + since_ns + round((self.rate - 1.0) * since_ns)

    def hosts_at(self, sensor_ns: I8) -> I8:
        """Return the host's times (n,) of instants (n,), as `host_at`."""
        since_ns = sensor_ns - self.sensor_ns
        drift_ns: I8 = np.rint((self.rate - 1.0) * since_ns).astype(np.int64)
        return self.host_ns + since_ns + drift_ns


@dataclass(frozen=True, slots=True)
class ArrivalFit:
    """The host's clock as a function of the sensor's, from the arrivals of a unit's data packets."""

    parts: tuple[FittedPart, ...]  # in order of their packets
    rate_ppm: float  # by which the host's clock is faster than the sensor's, in the longest part
    offset_s: float  # host's clock minus sensor's at the first packet
    residual_ms: tuple[float, float]  # median and greatest delay of the packets after their line

    @property
    def summary(self) -> dict[str, float]:
        """Numbers of the fit by name, for a report."""
        median_ms, most_ms = self.residual_ms
        return {
            "rate_ppm": self.rate_ppm,
            "offset_s": self.offset_s,
            "median_delay_ms": median_ms,
            "most_delay_ms": most_ms,
            "parts": len(self.parts),
        }

    def host_at(self, number: int, sensor_ns: int) -> int:
        """Return the host's time of an instant on the sensor's clock.

        Parameters
        ----------
        number : frame number of a packet near this instant
        """
        part = self.parts[0]
        for later in self.parts[1:]:  # there are few
            if later.first > number:
                break
            part = later
        return part.host_at(sensor_ns)

    def hosts_at(self, number: I8, sensor_ns: I8) -> I8:
        """Return the host's times (n,) of instants (n,), as `host_at`."""
        place = np.searchsorted([part.first for part in self.parts[1:]], number, "right")
        host_ns = np.empty(len(number), np.int64)
        for used in np.unique(place).tolist():
            host_ns[place == used] = self.parts[used].hosts_at(sensor_ns[place == used])
        return host_ns


class ArrivalRecord:
    """Running record of the arrivals of a unit's data packets, by which host stamps are judged and fitted.

    Its size grows with gaps and with steps of a clock, not with the number of packets: it keeps the convex
    hull of the delays of each part between them, and a sample of all delays for their median.
    """

    def __init__(self) -> None:
        self.stamps = HostStamps()
        self._last = np.zeros((3, 0), np.int64)  # the latest packet; rows as in `_held`
        self._held = np.zeros((3, 0), np.int64)
        """(3, n) frame numbers and times by both clocks of packets whose part is not decided: of the last
        whole second, and of the one that is not whole."""
        self._begin_ns = 0  # sensor's time of the first packet after the last gap
        self._cuts = set[int]()  # places of `_held` before which a clock steps
        self._parts = list[_Part]()
        self._goes_on = False  # True if the next packet belongs to the last part
        self._late = _LateSample()

    def take(self, number: I8, sensor_ns: I8, host_ns: I8) -> None:
        """Take the next packets.

        Parameters
        ----------
        number : (n,) frame numbers, in order
        sensor_ns, host_ns : (n,) times at which the packets were complete, by both clocks; host's is the
            arrival
        """
        new = np.stack([number, sensor_ns, host_ns])
        with_last = np.concatenate([self._last, new], axis=1)
        self._last = new[:, -1:]
        self.stamps += HostStamps.of(with_last[2], with_last[1])
        step_ns = np.diff(with_last[1], prepend=with_last[1, 0])[-new.shape[1] :]
        gaps = np.flatnonzero(np.abs(step_ns) > _GAP_NS).tolist()
        for begin, end in pairwise(sorted({0, *gaps, new.shape[1]})):
            if begin in gaps:
                self._end_stretch()
            if not self._goes_on and not self._held.shape[1]:
                self._begin_ns = int(new[1, begin])
            self._held = np.concatenate([self._held, new[:, begin:end]], axis=1)
            self._decide()

    def fit(self) -> ArrivalFit | None:
        """Fit the host's clock to the sensor's; None without packets."""
        self._end_stretch()
        parts = self._parts
        if not parts:
            return None
        longest = int(np.argmax([part.length_s for part in parts]))
        rate = parts[longest].rate if parts[longest].length_s >= _LEAST_S else 1.0
        rates = np.array([rate if part.length_s < _LEAST_S else part.rate for part in parts])
        least_ns = [part.least_ns(own) for part, own in zip(parts, rates.tolist(), strict=True)]
        most_ns = [part.most_ns(own) for part, own in zip(parts, rates.tolist(), strict=True)]
        fitted = [
            FittedPart(part.first, part.sensor_ns, part.host_ns + least, own)
            for part, least, own in zip(parts, least_ns, rates.tolist(), strict=True)
        ]
        median_ns = self._late.median_ns(rates, np.array(least_ns))
        late_ns = max(most - least for most, least in zip(most_ns, least_ns, strict=True))
        return ArrivalFit(
            parts=tuple(fitted),
            rate_ppm=round((fitted[longest].rate - 1.0) * 1e6, 3),
            offset_s=round((fitted[0].host_ns - fitted[0].sensor_ns) / S_NS, 6),
            residual_ms=(round(median_ns / 1e6, 3), round(late_ns / 1e6, 3)),
        )

    def _decide(self) -> None:
        """Decide on the parts of all held packets before the last whole second."""
        starts = self._seconds()
        if len(starts) < 3:
            return
        self._find_steps(starts[:-1], int(starts[-1]))
        self._settle(int(starts[-2]))

    def _end_stretch(self) -> None:
        """Decide on the parts of all held packets; the next one begins another."""
        if self._held.shape[1]:
            self._find_steps(self._seconds(), self._held.shape[1])
            self._settle(self._held.shape[1])
        self._goes_on = False

    def _seconds(self) -> I8:
        """Return the places of the held packets that begin a second since the last gap."""
        second = (self._held[1] - self._begin_ns) // _WINDOW_NS
        starts: I8 = np.flatnonzero(np.diff(second, prepend=second[:1] - 1) > 0)
        return starts

    def _find_steps(self, starts: I8, stop: int) -> None:
        """Find the packets before which the least delay of a second changes for good.

        The last of the seconds ends at place `stop`.
        """
        ahead_ns = self._held[2, :stop] - self._held[1, :stop]
        least_ns = np.minimum.reduceat(ahead_ns, starts)
        ends = np.append(starts[1:], stop)
        for second in np.flatnonzero(np.abs(np.diff(least_ns)) > _STEP_NS).tolist():
            begin = int(starts[second])
            change_ns = np.diff(ahead_ns[begin : int(ends[second + 1])])
            is_later = least_ns[second + 1] > least_ns[second]
            at = int(np.argmax(change_ns) if is_later else np.argmin(change_ns))
            self._cuts.add(begin + at + 1)

    def _settle(self, stop: int) -> None:
        """Add the held packets before place `stop` to their parts."""
        cuts = sorted(cut for cut in self._cuts if cut < stop)
        for begin, end in pairwise(sorted({0, *cuts, stop})):
            if begin in cuts or not self._goes_on:
                self._parts.append(_Part(*self._held[:, begin].tolist()))
                self._goes_on = True
            since_ns, delay_ns = self._parts[-1].take(*self._held[1:, begin:end])
            self._late.take(len(self._parts) - 1, since_ns, delay_ns)
        self._cuts = {cut - stop for cut in self._cuts if cut >= stop}
        self._held = self._held[:, stop:]


class _Part:
    """Arrivals between two gaps or steps of a clock: their ends, their mean, and the hull of their delays."""

    def __init__(self, first: int, sensor_ns: int, host_ns: int) -> None:
        self.first = first  # frame number of the first packet; its times by both clocks
        self.sensor_ns = sensor_ns
        self.host_ns = host_ns
        self._last_ns = sensor_ns
        self._count = 0
        self._sum_ns = 0.0
        self._least = np.zeros((2, 0))
        """Lower convex hull of the arrivals: times since the first packet by the sensor's clock, and the
        delays (2, n), in ns; `_most` is the upper one, of the negative delays."""
        self._most = np.zeros((2, 0))

    def take(self, sensor_ns: I8, host_ns: I8) -> tuple[F8, F8]:
        """Take packets; return their times and delays since the first one."""
        since_ns: F8 = (sensor_ns - self.sensor_ns).astype(np.float64)
        delay_ns: F8 = (host_ns - self.host_ns - (sensor_ns - self.sensor_ns)).astype(np.float64)
        self._last_ns = int(sensor_ns[-1])
        self._count += len(sensor_ns)
        self._sum_ns += float(since_ns.sum())
        self._least = _lower_hull_of(self._least, since_ns, delay_ns)
        self._most = _lower_hull_of(self._most, since_ns, -delay_ns)
        return since_ns, delay_ns

    @property
    def length_s(self) -> float:
        """Time from the first packet to the last by the sensor's clock."""
        return (self._last_ns - self.sensor_ns) / S_NS

    @property
    def rate(self) -> float:
        """Rate of the line of least total delay under all arrivals.

        It is the edge of their lower convex hull that is below the mean of the sensor's times.
        """
        x, y = self._least
        middle = min(max(int(np.searchsorted(x, self._sum_ns / self._count)), 1), len(x) - 1)
        ppm = (y[middle] - y[middle - 1]) / max(x[middle] - x[middle - 1], 1.0) * 1e6
        return 1.0 + float(np.clip(ppm, -_MOST_PPM, _MOST_PPM)) * 1e-6

    def least_ns(self, rate: float) -> int:
        """Return the least delay after a line of this rate through the first packet."""
        x, y = self._least
        return round(float((y - (rate - 1.0) * x).min()))

    def most_ns(self, rate: float) -> float:
        """Return the greatest delay after a line of this rate through the first packet."""
        x, y = self._most
        return float((-y - (rate - 1.0) * x).max())


class _LateSample:
    """Delays of every n-th packet, n as small as the room allows, for their median."""

    def __init__(self) -> None:
        self._row = np.empty((3, _MOST_LATE))  # number of the part; time and delay since its first packet
        self._rows = 0
        self._every = 1
        self._passed = 0

    def take(self, part: int, since_ns: F8, delay_ns: F8) -> None:
        """Take packets of a part."""
        rows = np.stack([np.full(len(since_ns), float(part)), since_ns, delay_ns])
        rows = rows[:, -self._passed % self._every :: self._every]
        self._passed += len(since_ns)
        while self._rows + rows.shape[1] > _MOST_LATE:
            kept = self._row[:, : self._rows : 2]
            rows = rows[:, self._rows % 2 :: 2]
            self._rows = kept.shape[1]
            self._row[:, : self._rows] = kept.copy()
            self._every *= 2
        self._row[:, self._rows : self._rows + rows.shape[1]] = rows
        self._rows += rows.shape[1]

    def median_ns(self, rates: F8, least_ns: F8) -> float:
        """Return the median of the delays after the lines of the parts."""
        part, since_ns, delay_ns = self._row[:, : self._rows]
        of = part.astype(np.int64)
        return float(np.median(delay_ns - (rates[of] - 1.0) * since_ns - least_ns[of]))


def _lower_hull_of(hull: F8, x: F8, y: F8) -> F8:
    """Return the lower convex hull (2, n) of points and of an earlier hull."""
    points = np.concatenate([hull, np.stack([x, y])], axis=1)
    points = np.take(points, np.argsort(points[0], kind="stable"), axis=1)
    places = np.empty(points.shape[1], np.int64)
    return np.take(points, places[: _lower_hull(points[0], points[1], places)], axis=1)


def fit_arrivals(number: I8, sensor_ns: I8, host_ns: I8) -> ArrivalFit | None:
    """Fit the host's clock to the sensor's; parameters as for `ArrivalRecord.take`."""
    record = ArrivalRecord()
    record.take(number, sensor_ns, host_ns)
    return record.fit()


@kernel
def _lower_hull(x: F8, y: F8, hull: I8) -> int:
    """Write the indices of the lower convex hull of points (n,), by rising x, and return their number."""
    count = 0
    for c in range(x.shape[0]):
        while count > 1:
            a = hull[count - 2]
            b = hull[count - 1]
            if (y[b] - y[a]) * (x[c] - x[a]) < (y[c] - y[a]) * (x[b] - x[a]):
                break
            count -= 1
        hull[count] = c
        count += 1
    return count
