"""Whole revolutions of a sensor as arrays, from a scene or from a capture."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets import (
    BLOCK_PERIOD_NS,
    BLOCKS_PER_PACKET,
    JUMP_NS,
    RETURN_MODE_BYTE,
    CaptureReader,
    PacketChunk,
    PointFrame,
    Points,
    chosen_unit,
    frame_named,
    packet_clock,
    scan_starts,
)
from vlp16emu.types import F4, F8, I8, U1, U2, U4, ReturnMode

LabelsOf = Callable[[PacketChunk], Mapping[str, NDArray[Any]]]
"""Returns the arrays of `Labels` for the n points of packets; empty if there are none."""


@dataclass(frozen=True, slots=True)
class Labels:
    """Ground truth of n points: the surface that each was reflected by."""

    semantic: U1
    """(n,) `Semantic`."""
    part: U1
    """(n,) `PlantPart`."""
    instance: U4
    """(n,) unique per plant, stone or object; 0 none."""
    species: U2
    """(n,) number in the species table; 0 none."""
    range_m: F4
    """(n,) distance without range errors."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One revolution: n points in the order of their pulses; pulses without return make no point.

    A revolution begins with the first azimuth reading (the sensor takes one in two firing sequences) that has passed
    0. In dual return each echo is there once, the last one first.

    Each point is in the sensor's frame at the instant of its own pulse. `world_T_sensor` is the pose at `start_ns`
    alone: on a moving sensor it takes only the scan's first points to their places in the world. Those of all are
    `Emulator.world_T_sensor(scan.t_ns)`.
    """

    start_ns: int
    """UTC of the revolution's first pulse, whether or not it has a return."""
    t_ns: I8
    """(n,) UTC of the pulse. Of a capture: by the clock that is chosen for `decode`, in whole microseconds for each packet."""
    xyz_m: F4
    """(n, 3) in the sensor: x forward at azimuth 0, y left, z up."""
    distance_m: F4
    """(n,) from the centre of the sensor."""
    azimuth_deg: F8
    """(n,) at the instant of the pulse, [0, 360)."""
    ring: U2
    """(n,) by elevation, 0 the lowest."""
    reflectivity: U1
    """(n,) 0..100 diffuse, 101..255 retroreflective."""
    is_last: NDArray[np.bool_]
    """(n,) a last return; else the strongest, or in dual return, where that is the last, the second strongest."""
    world_T_sensor: F8 | None = None
    """(4, 4) takes `xyz_m` to the world (local east, north, up), at `start_ns`; None for a capture."""
    labels: Labels | None = None
    """Where the truth was asked for."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """The n points of m azimuth readings, in order of time."""

    t_ns: I8
    """(m,) UTC of the first pulse after each reading."""
    azimuth_deg: F8
    """(m,) readings."""
    reading: I8
    """(n,) index of each point's reading, ascending."""
    arrays: Mapping[str, NDArray[Any]]
    """Arrays of n points by the names that they have in a scan."""

    def then(self, later: "Chunk") -> "Chunk":
        """Return this chunk with a later one appended."""
        return Chunk(
            np.concatenate([self.t_ns, later.t_ns]),
            np.concatenate([self.azimuth_deg, later.azimuth_deg]),
            np.concatenate([self.reading, later.reading + len(self.t_ns)]),
            {name: np.concatenate([array, later.arrays[name]]) for name, array in self.arrays.items()},
        )

    def part(self, begin: int, end: int) -> Self:
        """Return the readings from `begin` until before `end`, with their points."""
        first, last = np.searchsorted(self.reading, (begin, end))
        points = {name: array[first:last] for name, array in self.arrays.items()}
        readings = slice(begin, end)
        return type(self)(self.t_ns[readings], self.azimuth_deg[readings], self.reading[first:last] - begin, points)


def cut_scans(chunks: Iterable[Chunk], pose_at: Callable[[int], F8] | None = None) -> Iterator[Scan]:
    """Cut points into whole revolutions; begun ones at both ends and beside a jump of the clock are left out.

    Parameters
    ----------
    chunks : in order of time, without gaps
    pose_at : returns `world_T_sensor` (4, 4) at a UTC time in ns; None for a capture
    """
    held, begun = None, False
    for chunk in chunks:
        if not len(chunk.t_ns):
            continue
        held = chunk if held is None else held.then(chunk)
        starts = scan_starts(held.azimuth_deg, held.t_ns).tolist()
        for begin, end in pairwise(starts):
            jumps = abs(int(held.t_ns[end] - held.t_ns[end - 1])) > JUMP_NS
            if not jumps and (begun or _begins_at_zero(held.azimuth_deg[begin:])):
                yield _scan(held.part(begin, end), pose_at)
            begun = not jumps
        held = held.part(starts[-1], len(held.t_ns))
    if held is not None and (begun or _begins_at_zero(held.azimuth_deg)) and _ends_at_zero(held.azimuth_deg):
        yield _scan(held, pose_at)


def _begins_at_zero(azimuth_deg: F8) -> bool:
    """Return True if the reading before the first one would belong to another revolution."""
    return len(azimuth_deg) > 1 and bool(azimuth_deg[0] < (azimuth_deg[1] - azimuth_deg[0]) % 360.0)


def _ends_at_zero(azimuth_deg: F8) -> bool:
    """Return True if the reading after the last one would belong to another revolution."""
    return len(azimuth_deg) > 1 and bool(2 * azimuth_deg[-1] - azimuth_deg[-2] >= 360.0)


def _scan(chunk: Chunk, pose_at: Callable[[int], F8] | None) -> Scan:
    arrays, start_ns = dict(chunk.arrays), int(chunk.t_ns[0])
    labels = None
    if "semantic" in arrays:
        labels = Labels(**{name: arrays.pop(name) for name in Labels.__slots__})
    pose = None if pose_at is None else pose_at(start_ns)
    return Scan(start_ns=start_ns, world_T_sensor=pose, labels=labels, **arrays)


def decode(
    capture: str | Path,
    unit: str | int | None = None,
    *,
    frame: str | PointFrame = PointFrame.SENSOR,
    clock: str | None = None,
) -> Iterator[Scan]:
    """Read the scans of a capture, ours or a real sensor's, by the formulas of the sensor's manual.

    Parameters
    ----------
    capture : a classic pcap file with the packets of a VLP-16, Puck LITE or Puck Hi-Res
    unit : one sensor of several: its number from 1, or `address:port` with its data port
    frame : of `xyz_m`: "sensor" (x forward, y left, z up) or "manual" (x right, y forward, z up)
    clock : of `t_ns`: "sensor", "gps" or "host"; by default as `unit_clocks` chooses

    Returns
    -------
    iterator over the whole revolutions, which reads the file as it goes; errors come after the scans before them

    Raises
    ------
    CaptureError : where the file cannot be read or is damaged, or has no data packets
    PacketError : where a packet is not a VLP-16's
    InputError : there is no such frame, clock or unit, or there are several units and none is named
    """
    path = Path(capture)
    chosen = chosen_unit(path, None if unit is None else str(unit))
    reader = CaptureReader(path, chosen, frame_named(frame), clock=packet_clock(path, chosen, clock))
    return scans_in(reader, lambda _: {})


def scans_in(reader: CaptureReader, labels_of: LabelsOf) -> Iterator[Scan]:
    """Read the scans of a capture that is open; errors as `decode`."""
    return cut_scans(chunk_of(chunk, labels_of(chunk)) for chunk in reader.points())


def chunk_of(chunk: PacketChunk, labels: Mapping[str, NDArray[Any]]) -> Chunk:
    """Sort the points of data packets by azimuth readings."""
    points, blocks = chunk.points, chunk.fields["blocks"]
    dual = chunk.fields["return_mode"] == RETURN_MODE_BYTE[ReturnMode.DUAL]
    block = np.arange(BLOCKS_PER_PACKET)
    is_reading = ~dual[:, None] | (block % 2 == 0)  # blocks 0 and 1 of dual return share theirs
    block_ns = np.where(dual[:, None], block // 2, block) * BLOCK_PERIOD_NS
    first = np.concatenate([[0], np.cumsum(is_reading.sum(axis=1))])
    since_ns = chunk.clock_ns - chunk.packet_ns[points.packet]
    kept = ~twins(points)
    arrays: dict[str, NDArray[Any]] = {
        "t_ns": chunk.t_ns,
        "xyz_m": points.xyz_m,
        "distance_m": points.distance_m,
        "azimuth_deg": points.azimuth_deg,
        "ring": points.ring.astype(np.uint16),
        "reflectivity": points.reflectivity,
        "is_last": points.is_last,
        **labels,
    }
    return Chunk(
        t_ns=(chunk.utc_ns[:, None] + block_ns)[is_reading],
        azimuth_deg=blocks["azimuth_cdeg"][is_reading] / 100,
        reading=(first[points.packet] + since_ns // BLOCK_PERIOD_NS)[kept],
        arrays={name: array[kept] for name, array in arrays.items()},
    )


def twins(points: Points) -> NDArray[np.bool_]:
    """Return a mask (n,) of records in dual return that repeat the one before, as a lone return is sent (63-9243 Rev D, section 9.3.2)."""
    same = points.is_last[:-1] & ~points.is_last[1:]
    same &= np.diff(points.packet) == 0
    same &= np.diff(points.time_ns) == 0
    same &= points.laser[1:] == points.laser[:-1]
    same &= points.distance_m[1:] == points.distance_m[:-1]
    return np.concatenate([np.zeros(min(1, len(points.laser)), np.bool_), same])
