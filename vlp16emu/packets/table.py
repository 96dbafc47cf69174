"""Data packets as a table, with UTC of each packet.

The time stamp of a packet counts from a full hour that the packet does not name, on a clock that follows UTC
only if it is locked to GPS (63-9243 Rev D, sections 7.1 and 9.3.1). So the hour comes from the host that
captured the packets, or from the sentences of a GPS receiver.

>>> import numpy as np
>>> from vlp16emu.packets import DATA_PAYLOAD, PacketClock, packet_row, packet_table
>>> payloads = np.zeros(2, DATA_PAYLOAD)
>>> payloads["timestamp_us"] = 3_599_999_000, 327
>>> arrivals_ns = 7_199_999_900_000, 7_200_001_230_000
>>> clock = PacketClock()
>>> captured = zip((1, 2), arrivals_ns, payloads)
>>> table = packet_table(packet_row(i, t_ns, each.tobytes(), clock) for i, t_ns, each in captured)
>>> table["utc_ns"].tolist()
[7199999000000, 7200000327000]
"""

import struct
from collections.abc import Iterable
from enum import StrEnum
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets.arrival import ArrivalFit
from vlp16emu.packets.decode import Points
from vlp16emu.packets.layout import (
    BLOCK,
    BLOCKS_PER_PACKET,
    DATA_ROW,
    PRODUCTS,
    RETURN_MODE_BYTE,
    layout_of_bytes,
)
from vlp16emu.types import I8, U4, SensorModel
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_HEAD = struct.Struct("<4q")  # the columns of `DATA_ROW` before the payload
_TAIL = struct.Struct("<IBB")  # stamp and factory bytes
_STAMP_AT = BLOCKS_PER_PACKET * BLOCK.itemsize  # they follow the blocks
_Time = TypeVar("_Time", int, I8)
_STEADY_NS = S_NS
"""Step of the sensor's clock up to which its hour is kept, even if the host's clock jumps."""


class Clock(StrEnum):
    """Time source for packets."""

    SENSOR = "sensor"  # The sensor's clock, in the hour nearest to the capture stamp
    GPS = "gps"  # The sensor's clock, in the hour of the first valid GPS sentence
    FITTED = "fitted"
    """The capture stamps, smoothed: a line through the least delays over the sensor's clock."""
    HOST = "host"
    """The capture stamp minus the duration of a packet, as a ROS driver without `gps_time` computes it."""

    @property
    def whose(self) -> str:
        """Owner of the clock, for a sentence."""
        return "host's, fitted to the sensor's" if self is Clock.FITTED else f"{self}'s"


class PacketClock:
    """Converts the stamps of one sensor's packets into UTC by a chosen clock, in order of arrival.

    Parameters
    ----------
    clock : clock of the results
    host_behind_ns : the hour is chosen as if capture stamps were behind UTC by it
    fit : the host's clock over the sensor's, for `Clock.FITTED`
    model : sensor model of a prototype unit, whose product byte names another sensor
    """

    def __init__(
        self,
        clock: Clock = Clock.SENSOR,
        host_behind_ns: int = 0,
        fit: ArrivalFit | None = None,
        model: SensorModel | None = None,
    ) -> None:
        assert (clock is Clock.FITTED) == (fit is not None)
        self._ages_ns = ages_ns(model)
        self.clock = clock
        self.fit = fit
        self.model = model
        self._number = 0  # frame number of the latest data packet
        self._host_behind_ns = host_behind_ns
        self._before: tuple[int, int] | None = None
        """Arrival of the latest packet, and its UTC by the sensor's clock."""
        self.host_ahead_ns: int | None = None
        """Capture stamp of the first packet minus its end on the sensor's clock; None before the first
        packet."""

    def sensor_ns(self, arrival_ns: int, timestamp_us: int) -> int:
        """Return UTC of a time stamp by the sensor's clock; after each gap the hour is determined again."""
        before = self._before or (arrival_ns, arrival_ns + self._host_behind_ns)
        gone_ns = arrival_ns - before[0]
        step_ns = wrap_hour(timestamp_us * US_NS - before[1], HOUR_NS)
        if abs(step_ns) > _STEADY_NS:
            step_ns += round((gone_ns - step_ns) / HOUR_NS) * HOUR_NS
        t_ns = before[1] + step_ns
        self._before = arrival_ns, t_ns
        return t_ns

    def packet_ns(self, number: int, arrival_ns: int, payload: bytes) -> tuple[int, int]:
        """Return UTC of a data packet's first pulse, by the sensor's clock and by the chosen one.

        `number` is the number of its frame.
        """
        timestamp_us, mode, product = _TAIL.unpack_from(payload, _STAMP_AT)
        sensor_ns = self.sensor_ns(arrival_ns, timestamp_us)
        lasts_ns = int(self._ages_ns[product, mode])
        fired_ns = arrival_ns - lasts_ns
        if self.host_ahead_ns is None:
            self.host_ahead_ns = fired_ns - sensor_ns
        self._number = number
        if self.fit is not None:
            return sensor_ns, self.fit.host_at(number, sensor_ns + lasts_ns) - lasts_ns
        return sensor_ns, fired_ns if self.clock is Clock.HOST else sensor_ns

    def packets_ns(self, number: I8, arrival_ns: I8, fields: NDArray[np.void]) -> tuple[I8, I8]:
        """Return UTC (n,) of the first pulses of data packets (n,) `DATA_PAYLOAD`, as `packet_ns`."""
        sensor_ns = self.sensors_ns(arrival_ns, fields["timestamp_us"])
        lasts_ns: I8 = self._ages_ns[fields["factory"], fields["return_mode"]]
        fired_ns = arrival_ns - lasts_ns
        if self.host_ahead_ns is None:
            self.host_ahead_ns = int(fired_ns[0] - sensor_ns[0])
        self._number = int(number[-1])
        if self.fit is not None:
            return sensor_ns, self.fit.hosts_at(number, sensor_ns + lasts_ns) - lasts_ns
        return sensor_ns, fired_ns if self.clock is Clock.HOST else sensor_ns

    def sensors_ns(self, arrival_ns: I8, timestamp_us: U4) -> I8:
        """Return UTC (n,) of time stamps (n,) that follow one another, as `sensor_ns`."""
        first_ns = self.sensor_ns(int(arrival_ns[0]), int(timestamp_us[0]))
        stamp_us: I8 = timestamp_us.astype(np.int64)
        apart_us: I8 = stamp_us[1:] - stamp_us[:-1]
        step_ns = wrap_hour(apart_us * US_NS, HOUR_NS)
        for place in np.flatnonzero(np.abs(step_ns) > _STEADY_NS).tolist():
            gone_ns = int(arrival_ns[place + 1]) - int(arrival_ns[place])
            step_ns[place] += round((gone_ns - int(step_ns[place])) / HOUR_NS) * HOUR_NS
        t_ns: I8 = first_ns + np.cumsum(np.append(0, step_ns))
        self._before = int(arrival_ns[-1]), int(t_ns[-1])
        return t_ns

    def position_ns(self, arrival_ns: int, timestamp_us: int) -> int:
        """Return UTC of a position packet by the chosen clock."""
        if self.clock is Clock.HOST:
            return arrival_ns
        sensor_ns = self.sensor_ns(arrival_ns, timestamp_us)
        return sensor_ns if self.fit is None else self.fit.host_at(self._number, sensor_ns)


@cache
def ages_ns(model: SensorModel | None = None) -> I8:
    """Return the times from the stamps of data packets to their sending, (256, 256) by product and mode.

    It is 0 for unknown modes; unknown products have the VLP-16's. `model` is that of a prototype unit.
    """
    ages = np.zeros((256, 256), np.int64)
    for mode in RETURN_MODE_BYTE.values():
        ages[:, mode] = layout_of_bytes(mode, -1).age_ns
        for product in PRODUCTS:
            ages[product, mode] = layout_of_bytes(mode, product, model).age_ns
    return ages


def wrap_hour(difference: _Time, hour: int) -> _Time:
    """Wrap a difference of times past the hour, a number or (n,), to half an hour around 0; in any unit."""
    return (difference + hour // 2) % hour - hour // 2


PacketTable = NDArray[np.void]
"""(n,) `DATA_ROW`: data packets of one sensor in order of arrival, of a capture or as they are sent.

What takes payloads, (n,) `DATA_PAYLOAD`, takes tables too: `points_in`, `faults_in`, `is_dual`.
"""


def packet_row(number: int, arrival_ns: int, payload: bytes, clock: PacketClock) -> bytes:
    """Return the row of a data packet that follows those which `clock` has converted."""
    return _HEAD.pack(number, arrival_ns, *clock.packet_ns(number, arrival_ns, payload)) + payload


def packet_table(rows: Iterable[bytes]) -> PacketTable:
    """Return the table of packets from their rows, which can be written."""
    return np.frombuffer(bytearray().join(rows), DATA_ROW)


def captured_table(number: I8, arrival_ns: I8, fields: NDArray[np.void], clock: PacketClock) -> PacketTable:
    """Return the table of packets, (n,) `DATA_PAYLOAD`, that follow those which `clock` has converted."""
    table = np.empty(len(fields), DATA_ROW)
    rows = table.view(np.uint8).reshape(len(fields), -1)
    rows[:, _HEAD.size :] = fields.view(np.uint8).reshape(len(fields), -1)
    table["number"] = number
    table["arrival_ns"] = arrival_ns
    table["sensor_ns"], table["utc_ns"] = clock.packets_ns(number, arrival_ns, fields)
    return table


def utc_ns_of(table: PacketTable, points: Points) -> I8:
    """Return UTC (m,) of the points of a table by the chosen clock."""
    t_ns: I8 = table["utc_ns"][points.packet] + points.since_ns
    return t_ns
