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


def fit_arrivals(number: I8, sensor_ns: I8, host_ns: I8) -> ArrivalFit:
    """Fit the host's clock to the sensor's.

    Parameters
    ----------
    number : (n,) frame numbers of one or more data packets, in order
    sensor_ns, host_ns : (n,) times at which the packets were complete, by both clocks; host's is the arrival
    """
    bounds = [0, *_cuts(sensor_ns, host_ns), len(number)]
    spans = list(pairwise(bounds))
    lengths_s = [(sensor_ns[end - 1] - sensor_ns[begin]) / S_NS for begin, end in spans]
    longest = int(np.argmax(lengths_s))
    rate = 1.0
    if lengths_s[longest] >= _LEAST_S:
        begin, end = spans[longest]
        rate = _rate(sensor_ns[begin:end], host_ns[begin:end])
    parts = list[FittedPart]()
    late_ns = np.empty(len(number))
    for (begin, end), length_s in zip(spans, lengths_s, strict=True):
        sensor = sensor_ns[begin:end]
        ahead_ns = host_ns[begin:end] - sensor
        is_short = length_s < _LEAST_S or (begin, end) == spans[longest]
        own = rate if is_short else _rate(sensor, host_ns[begin:end])
        off_ns = ahead_ns - ahead_ns[0] - (own - 1.0) * (sensor - sensor[0])
        least_ns = round(off_ns.min())
        late_ns[begin:end] = off_ns - least_ns
        first_ns = int(sensor[0])
        parts.append(FittedPart(int(number[begin]), first_ns, int(host_ns[begin]) + least_ns, own))
    return ArrivalFit(
        parts=tuple(parts),
        rate_ppm=round((parts[longest].rate - 1.0) * 1e6, 3),
        offset_s=round((parts[0].host_ns - parts[0].sensor_ns) / S_NS, 6),
        residual_ms=(round(float(np.median(late_ns)) / 1e6, 3), round(float(late_ns.max()) / 1e6, 3)),
    )


def _cuts(sensor_ns: I8, host_ns: I8) -> list[int]:
    """Return the indices of packets before which a clock steps, or after a gap."""
    step_ns = np.diff(sensor_ns)
    cuts = set((np.flatnonzero((step_ns < -_GAP_NS) | (step_ns > _GAP_NS)) + 1).tolist())
    for begin, end in pairwise([0, *sorted(cuts), len(sensor_ns)]):
        cuts |= {begin + index for index in _steps(sensor_ns[begin:end], host_ns[begin:end])}
    return sorted(cuts)


def _steps(sensor_ns: I8, host_ns: I8) -> list[int]:
    """Return the indices of packets before which the least delay of a second changes for good."""
    window = (sensor_ns - sensor_ns[0]) // _WINDOW_NS
    starts = np.flatnonzero(np.diff(window, prepend=-1) > 0)
    ahead_ns = host_ns - sensor_ns
    least_ns = np.minimum.reduceat(ahead_ns, starts)
    ends = np.append(starts[1:], len(sensor_ns))
    found = list[int]()
    for number in np.flatnonzero(np.abs(np.diff(least_ns)) > _STEP_NS).tolist():
        begin, end = int(starts[number]), int(ends[number + 1])
        change_ns = np.diff(ahead_ns[begin:end])
        is_later = least_ns[number + 1] > least_ns[number]
        at = int(np.argmax(change_ns) if is_later else np.argmin(change_ns))
        found.append(begin + at + 1)
    return found


def _rate(sensor_ns: I8, host_ns: I8) -> float:
    """Return the rate of the line of least total delay under all arrivals.

    It is the edge of their lower convex hull that is below the mean of the sensor's times.
    """
    x: F8 = (sensor_ns - sensor_ns[0]).astype(np.float64)
    y: F8 = (host_ns - sensor_ns).astype(np.float64)
    y -= y[0]
    order = np.argsort(x, kind="stable")
    hull = np.empty(len(order), np.int64)
    hull = hull[: _lower_hull(x, y, order, hull)]
    edges = x[hull]
    middle = min(max(int(np.searchsorted(edges, x.mean())), 1), len(hull) - 1)
    left, right = hull[middle - 1], hull[middle]
    ppm = (y[right] - y[left]) / max(x[right] - x[left], 1.0) * 1e6
    return 1.0 + float(np.clip(ppm, -_MOST_PPM, _MOST_PPM)) * 1e-6


@kernel
def _lower_hull(x: F8, y: F8, order: I8, hull: I8) -> int:
    """Write the indices of the lower convex hull of points (n,), in this order, and return their number."""
    count = 0
    for c in order:
        while count > 1:
            a = hull[count - 2]
            b = hull[count - 1]
            if (y[b] - y[a]) * (x[c] - x[a]) < (y[c] - y[a]) * (x[b] - x[a]):
                break
            count -= 1
        hull[count] = c
        count += 1
    return count
