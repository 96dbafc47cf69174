"""Data packets as a table, with UTC of each packet.

The time stamp of a packet counts from a full hour that the packet does not name, on a clock that follows UTC
only if it is locked to GPS (63-9243 Rev D, sections 7.1 and 9.3.1). So the hour comes from the host that
captured the packets, or from the sentences of a GPS receiver.

>>> import numpy as np
>>> from vlp16emu.packets import DATA_PAYLOAD, PacketClock, PacketTable
>>> fields = np.zeros(2, DATA_PAYLOAD)
>>> fields["timestamp_us"] = 3_599_999_000, 327
>>> arrival_ns = np.array([7_199_999_900_000, 7_200_001_230_000])
>>> PacketTable.of(fields, np.array([1, 2]), arrival_ns, PacketClock()).utc_ns.tolist()
[7199999000000, 7200000327000]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec
from vlp16emu.packets import layout
from vlp16emu.packets.decode import (
    SENSOR_R_MANUAL,
    PointFrame,
    Points,
    block_since_ns,
    is_dual,
    model_of,
    points_in,
)
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import I8, U1, U2, SensorModel
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_Time = TypeVar("_Time", int, I8)
_STEADY_NS = S_NS
"""Step of the sensor's clock up to which its hour is kept, even if the host's clock jumps."""

_PERIOD_NS = np.zeros(256, np.int64)
"""Duration of a packet by its return-mode byte; 0 for bytes that are no return mode."""
for _mode, _sequences in layout.SEQUENCES_PER_PACKET.items():
    _PERIOD_NS[layout.RETURN_MODE_BYTE[_mode]] = _sequences * SEQUENCE_NS


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


@dataclass(frozen=True, slots=True)
class PacketTable:
    """n data packets of one sensor in order of arrival, of a capture or as they are sent: a row for each packet.

    Columns of the payload are views of `fields`; their source is 63-9243 Rev D, section 9.3.2, table 9-2.
    """

    number: I8  # (n,) frame numbers in the capture, from 1, as in Wireshark
    arrival_ns: I8  # (n,) UTC stamps of the capture, or of sending
    sensor_ns: I8  # (n,) UTC of the first pulses by the sensor's clock
    utc_ns: I8  # (n,) UTC of the first pulses by the chosen clock
    fields: NDArray[np.void]  # (n,) `DATA_PAYLOAD`, the payloads themselves
    model: SensorModel | None = None  # of prototype units, whose product byte names another sensor

    @classmethod
    def of(
        cls,
        fields: NDArray[np.void],
        number: I8,
        arrival_ns: I8,
        clock: PacketClock,
        model: SensorModel | None = None,
    ) -> Self:
        """Make a table of one or more packets that follow those which `clock` has seen.

        Parameters
        ----------
        fields : (n,) `DATA_PAYLOAD`, as `np.frombuffer` reads it from the bytes of payloads
        number : (n,) frame numbers
        arrival_ns : (n,) capture stamps
        model : sensor model of prototype units
        """
        sensor_ns = clock.sensor_ns(arrival_ns, fields["timestamp_us"].astype(np.int64))
        fired_ns = arrival_ns - _PERIOD_NS[fields["return_mode"]]
        if clock.host_ahead_ns is None:
            clock.host_ahead_ns = int(fired_ns[0] - sensor_ns[0])
        utc_ns = fired_ns if clock.clock is Clock.HOST else sensor_ns
        return cls(number, arrival_ns, sensor_ns, utc_ns, fields, model)

    @classmethod
    def joined(cls, tables: Sequence[Self]) -> Self:
        """Return one or more tables of one sensor behind each other."""
        columns = zip(*(table.columns for table in tables), strict=True)
        return cls(*map(np.concatenate, columns), tables[0].model)

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> Self:
        """Return the packets of a slice or of a mask (n,)."""
        return type(self)(*(column[rows] for column in self.columns), self.model)

    @property
    def columns(self) -> tuple[NDArray[Any], ...]:
        """The five arrays in the order of their declaration."""
        return self.number, self.arrival_ns, self.sensor_ns, self.utc_ns, self.fields

    @property
    def timestamp_us(self) -> I8:
        """(n,) time stamps: microseconds past the hour at the first pulse."""
        return np.asarray(self.fields["timestamp_us"], np.int64)

    @property
    def mode(self) -> U1:
        """(n,) bytes of the return mode, `RETURN_MODE_BYTE`."""
        return np.asarray(self.fields["return_mode"])

    @property
    def product(self) -> U1:
        """(n,) bytes of the product, `FACTORY_BYTE`."""
        return np.asarray(self.fields["factory"])

    @property
    def is_dual(self) -> NDArray[np.bool_]:
        """(n,) True in dual return, in which two blocks share their firing sequences."""
        return is_dual(self.fields)

    @property
    def azimuth_cdeg(self) -> U2:
        """(n, 12) azimuths of the blocks, hundredths of a degree."""
        return np.asarray(self.fields["blocks"]["azimuth_cdeg"])

    @property
    def distance_lsb(self) -> U2:
        """(n, 12, 2, 16) distances of the records in steps of 2 mm; 0 without return."""
        return np.asarray(self.fields["blocks"]["records"]["distance_lsb"])

    @property
    def reflectivity(self) -> U1:
        """(n, 12, 2, 16) reflectivities of the records."""
        return np.asarray(self.fields["blocks"]["records"]["reflectivity"])

    @property
    def block_ns(self) -> I8:
        """(n, 12) UTC of the first pulse of each block by the chosen clock."""
        return self.utc_ns[:, None] + block_since_ns(self.fields)

    def points(self, frame: PointFrame = PointFrame.SENSOR) -> Points:
        """Return the points by the manual's formulas, without no-returns; packets must have no fault (`faults_in`)."""
        points = points_in(self.fields, model_of(self.fields, self.model), keep_no_returns=False)
        if frame is PointFrame.SENSOR:
            return points
        turned_m = matvec(SENSOR_R_MANUAL.T, points.xyz_m.astype(np.float64))
        return replace(points, xyz_m=turned_m.astype(np.float32))

    def t_ns(self, points: Points) -> I8:
        """Return UTC (m,) of points of these packets by the chosen clock."""
        return self.utc_ns[points.packet] + points.since_ns
