"""A capture, with or without its truth, as the messages that ROS has of such a sensor."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from threading import Event

import numpy as np
from numpy.typing import NDArray

from vlp16emu.bag.of_truth import true_streams
from vlp16emu.errors import spare
from vlp16emu.packets import (
    POSITION_BYTES,
    Capture,
    CapturedUnit,
    CaptureReader,
    PacketChunk,
    decode_position,
    units_in,
)
from vlp16emu.sinks.bag import BagFile, Beat
from vlp16emu.units import HOUR_NS, S_NS

_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
)
"""PointXYZIRT of velodyne_pointcloud (pointcloudXYZIRT.cpp, ros-drivers/velodyne): packed, 22 bytes."""
_FIELD_TYPES = {"f4": 7, "u2": 4}
"""FLOAT32 and UINT16 of sensor_msgs/PointField."""


@dataclass(frozen=True, slots=True)
class BagResult:
    """What a bag holds."""

    file: str
    messages: dict[str, int]
    """By topic."""
    duration_s: float
    """From the first message to the last."""
    interrupted: bool


def write_bag(capture: Path, out: Path, truth: Path | None = None, *, stop: Event | None = None) -> BagResult:
    """Write the bag of a capture; memory does not grow with its length.

    Each unit of several has its topics and its frame under `/unit_1` and so on. A scan ends with the packet that passes
    azimuth 0, as the driver's default `cut_angle` has it, and has the stamp of its first packet by the sensor's clock, as with
    its settings `gps_time` and `timestamp_first_packet`; what is left after the last cut is no scan.

    Parameters
    ----------
    capture : a classic pcap file of VLP-16 packets, also of a real sensor
    out : .mcap, .bag or a folder, as `BagFile` takes it
    truth : folder with the truth of the run: true odometry, transforms, inertial unit and receiver
    stop : ends the bag between two messages; it is valid

    Raises
    ------
    CaptureError, PacketError
        where the capture is none, or is damaged
    InputError
        where the truth cannot be read, or is not of as many units
    OutputError, MissingExtraError, RunError
        as `BagFile`
    """
    spare([capture], out)
    stop = stop or Event()
    units = units_in(capture)
    frames = [f"unit_{number}/velodyne" for number in range(1, len(units) + 1)]
    frames = frames if len(units) > 1 else ["velodyne"]
    with BagFile(out) as bag:
        streams: list[Iterator[Beat]] = []
        for unit, frame in zip(units, frames, strict=True):
            space = f"/{frame}".removesuffix("/velodyne")
            streams += [_scans(bag, capture, unit, space, frame), _sentences(bag, capture, unit, space)]
        if truth is not None:
            streams += true_streams(bag, truth, frames, _first_ns(capture))
        for _, write in heapq.merge(*streams, key=itemgetter(0)):
            if stop.is_set():
                break
            write()
    first_ns, last_ns = bag.span_ns or (0, 0)
    return BagResult(str(out), dict(sorted(bag.counts.items())), (last_ns - first_ns) / S_NS, stop.is_set())


def _first_ns(capture: Path) -> int:
    with CaptureReader(capture) as reader:
        chunk = next(reader.points())
        return int(chunk.packet_ns[0]) + _zero_ns(reader, chunk)


def _zero_ns(reader: CaptureReader, chunk: PacketChunk) -> int:
    """UTC of the hour from which the clock of a first chunk counts: the one nearest to the capture's stamp."""
    return round((reader.first_stamp_ns - int(chunk.packet_ns[0])) / HOUR_NS) * HOUR_NS


def _scans(bag: BagFile, capture: Path, unit: CapturedUnit, space: str, frame: str) -> Iterator[Beat]:
    """Yield the scans of a unit, each at its last packet: the packets, then the points."""
    with CaptureReader(capture, unit) as reader:
        zero_ns: int | None = None
        packets: list[tuple[int, NDArray[np.uint8]]] = []
        points: list[NDArray[np.void]] = []
        clocks_ns: list[NDArray[np.int64]] = []
        last_cdeg = -1
        for chunk in reader.points():
            zero_ns = _zero_ns(reader, chunk) if zero_ns is None else zero_ns
            bounds = np.searchsorted(chunk.points.packet, np.arange(len(chunk.fields) + 1))
            arrays, clock_ns = _points(chunk), chunk.clock_ns + zero_ns
            for at, (begin, end) in enumerate(pairwise(bounds.tolist())):
                stamp_ns = int(chunk.packet_ns[at]) + zero_ns
                packets.append((stamp_ns, np.frombuffer(chunk.fields[at].tobytes(), np.uint8)))
                points.append(arrays[begin:end])
                clocks_ns.append(clock_ns[begin:end])
                azimuth_cdeg = int(chunk.fields["blocks"]["azimuth_cdeg"][at, 0])
                if azimuth_cdeg < last_cdeg:
                    cloud, t_ns = np.concatenate(points), np.concatenate(clocks_ns)
                    cloud["time"] = (t_ns - packets[0][0]) / S_NS
                    yield stamp_ns, partial(_write_scan, bag, packets, cloud, (space, frame))
                    packets, points, clocks_ns = [], [], []
                last_cdeg = azimuth_cdeg


def _points(chunk: PacketChunk) -> NDArray[np.void]:
    """(n,) `_POINT`, without times."""
    points = np.zeros(len(chunk.points.ring), _POINT)
    for number, axis in enumerate("xyz"):
        points[axis] = chunk.points.xyz_m[:, number]
    points["intensity"], points["ring"] = chunk.points.reflectivity, chunk.points.ring
    return points


def _write_scan(
    bag: BagFile,
    packets: list[tuple[int, NDArray[np.uint8]]],
    points: NDArray[np.void],
    names: tuple[str, str],
) -> None:
    (space, frame), begin_ns, end_ns = names, packets[0][0], packets[-1][0]
    topic = f"{space}/velodyne_packets"
    raw = [
        bag.make("velodyne_msgs/msg/VelodynePacket", stamp=bag.time(t_ns), data=data)
        for t_ns, data in packets
    ]
    header = bag.header(begin_ns, frame, topic)
    bag.write(topic, end_ns, bag.make("velodyne_msgs/msg/VelodyneScan", header=header, packets=raw))
    topic = topic.replace("velodyne_packets", "velodyne_points")
    fields = [
        bag.make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=offset,
            datatype=_FIELD_TYPES[kind.str[1:]],
            count=1,
        )
        for name, (kind, offset, *_) in (_POINT.fields or {}).items()
    ]
    cloud = bag.make(
        "sensor_msgs/msg/PointCloud2",
        header=bag.header(begin_ns, frame, topic),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=_POINT.itemsize,
        row_step=_POINT.itemsize * len(points),
        data=points.view(np.uint8),
        is_dense=True,
    )
    bag.write(topic, end_ns, cloud)


def _sentences(bag: BagFile, capture: Path, unit: CapturedUnit, space: str) -> Iterator[Beat]:
    """Yield each sentence of a unit's position packets, at the first one that has it."""
    topic, before = f"{space}/nmea_sentence", b""

    def write(t_ns: int, sentence: bytes) -> None:
        text = sentence.decode("ascii", "replace").strip()
        header = bag.header(t_ns, "gps", topic)
        bag.write(topic, t_ns, bag.make("nmea_msgs/msg/Sentence", header=header, sentence=text))

    with Capture(capture) as datagrams:
        for datagram in datagrams:
            if len(datagram.payload) != POSITION_BYTES or not unit.owns(datagram):
                continue
            sentence = decode_position(datagram.payload).sentence
            if sentence not in (b"", before):
                yield datagram.stamp_ns, partial(write, datagram.stamp_ns, sentence)
            before = sentence
