"""Data packets as a table, with UTC of each packet.

The time stamp of a packet counts from a full hour that the packet does not name, on a clock that follows UTC
only if it is locked to GPS (63-9243 Rev D, sections 7.1 and 9.3.1). So the hour comes from the host that
captured the packets, or from the sentences of a GPS receiver.

>>> import numpy as np
>>> from vlp16emu.packets import DATA_PAYLOAD, PacketClock, packet_table
>>> payloads = np.zeros(2, DATA_PAYLOAD)
>>> payloads["timestamp_us"] = 3_599_999_000, 327
>>> arrival_ns = np.array([7_199_999_900_000, 7_200_001_230_000])
>>> packet_table(payloads, np.array([1, 2]), arrival_ns, PacketClock())["utc_ns"].tolist()
[7199999000000, 7200000327000]
"""

from collections.abc import Iterable
from enum import StrEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets.decode import Points, is_dual
from vlp16emu.packets.layout import BLOCK_PERIOD_NS, BLOCKS_PER_PACKET, DATA_BYTES, DATA_ROW
from vlp16emu.types import I8
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_Time = TypeVar("_Time", int, I8)
_STEADY_NS = S_NS
"""Step of the sensor's clock up to which its hour is kept, even if the host's clock jumps."""


class Clock(StrEnum):
    """Time source for packets."""

    SENSOR = "sensor"  # The sensor's clock, in the hour nearest to the capture stamp
    GPS = "gps"  # The sensor's clock, in the hour of the first valid GPS sentence
    HOST = "host"
    """The capture stamp minus the duration of a packet, as a ROS driver without `gps_time` computes it."""


class PacketClock:
    """Converts the stamps of one sensor's packets into UTC by a chosen clock, in order of arrival.

    The hour is chosen as if capture stamps were behind UTC by `host_behind_ns`.
    """

    def __init__(self, clock: Clock = Clock.SENSOR, host_behind_ns: int = 0) -> None:
        self.clock = clock
        self._host_behind_ns = host_behind_ns
        self._before: tuple[int, int] | None = None
        """Arrival of the latest packet, and its UTC by the sensor's clock."""
        self.host_ahead_ns: int | None = None
        """Capture stamp of the first packet minus its end on the sensor's clock; None before the first
        packet."""

    def sensor_ns(self, arrival_ns: I8, timestamp_us: I8) -> I8:
        """Return UTC (n,) of time stamps by the sensor's clock; after each gap the hour is determined again."""
        first_ns = int(arrival_ns[0])
        arrival_before_ns, before_ns = self._before or (first_ns, first_ns + self._host_behind_ns)
        gone_ns = np.diff(arrival_ns, prepend=arrival_before_ns)
        step_ns = wrap_hour(np.diff(timestamp_us * US_NS, prepend=before_ns), HOUR_NS)
        hours = np.rint((gone_ns - step_ns) / HOUR_NS).astype(np.int64)
        hours[np.abs(step_ns) <= _STEADY_NS] = 0
        t_ns: I8 = before_ns + np.cumsum(step_ns + hours * HOUR_NS)
        self._before = int(arrival_ns[-1]), int(t_ns[-1])
        return t_ns

    def position_ns(self, arrival_ns: int, timestamp_us: int) -> int:
        """Return UTC of a position packet by the chosen clock."""
        if self.clock is Clock.HOST:
            return arrival_ns
        return int(self.sensor_ns(np.array([arrival_ns]), np.array([timestamp_us]))[0])


def wrap_hour(difference: _Time, hour: int) -> _Time:
    """Wrap a difference of times past the hour, a number or (n,), to half an hour around 0; `hour` is in its unit."""
    return (difference + hour // 2) % hour - hour // 2


PacketTable = NDArray[np.void]
"""(n,) `DATA_ROW`: data packets of one sensor in order of arrival, of a capture or as they are sent.

What takes payloads, (n,) `DATA_PAYLOAD`, takes tables too: `points_in`, `faults_in`, `is_dual`.
"""


def packet_table(payloads: Iterable[bytes], number: I8, arrival_ns: I8, clock: PacketClock) -> PacketTable:
    """Make the table of one or more packets that follow those which `clock` has converted.

    Parameters
    ----------
    payloads : 1206 bytes each
    number : (n,) frame numbers
    arrival_ns : (n,) capture stamps
    """
    table = np.zeros(len(number), DATA_ROW)
    # Rows end with the payload. To copy it field by field takes 70 times as long.
    content = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, DATA_BYTES)
    table.view(np.uint8).reshape(len(table), -1)[:, -DATA_BYTES:] = content
    sensor_ns = clock.sensor_ns(arrival_ns, table["timestamp_us"].astype(np.int64))
    blocks = np.where(is_dual(table), BLOCKS_PER_PACKET // 2, BLOCKS_PER_PACKET)
    fired_ns = arrival_ns - blocks * BLOCK_PERIOD_NS
    if clock.host_ahead_ns is None:
        clock.host_ahead_ns = int(fired_ns[0] - sensor_ns[0])
    table["number"] = number
    table["arrival_ns"] = arrival_ns
    table["sensor_ns"] = sensor_ns
    table["utc_ns"] = fired_ns if clock.clock is Clock.HOST else sensor_ns
    return table


def utc_ns_of(table: PacketTable, points: Points) -> I8:
    """Return UTC (m,) of the points of a table by the chosen clock."""
    t_ns: I8 = table["utc_ns"][points.packet] + points.since_ns
    return t_ns
