"""A capture, with or without its truth, as a bag."""

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from vlp16emu.errors import InputError, PacketError, readable
from vlp16emu.extras.bag.bag_file import LATEST_NS, BagFile, check_bag
from vlp16emu.extras.bag.messages import TrueMessages
from vlp16emu.extras.bag.sink import BagSink, TrueSamples, frames_of
from vlp16emu.extras.slam import Rig, write_beside
from vlp16emu.extras.truth.truth import ATTITUDE, STAMP
from vlp16emu.output import spare
from vlp16emu.packets import (
    DATA_BYTES,
    Capture,
    CapturedUnit,
    CaptureReader,
    check_stamps,
    chosen_unit,
    unit_clocks,
    units_in,
)
from vlp16emu.run.options import BagOptions
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS

_TIME = "t_utc_s"
_POSE = (_TIME, "x", "y", "z", "qx", "qy", "qz", "qw")
_AXES = ("wx_rad_s", "wy_rad_s", "wz_rad_s", "fx_m_s2", "fy_m_s2", "fz_m_s2")
_SAID = ("latitude_deg", "longitude_deg", "valid")
_EVER_NS = 2**62
_SET_RPM = 60.0
"""Speeds that can be set are multiples (63-9243 Rev D, section 8.3, p. 50)."""

Row = tuple[int, list[float]]
"""UTC of a sample, and its numbers."""


@dataclass(frozen=True, slots=True)
class BagResult:
    """Contents of a bag."""

    file: str
    messages: dict[str, int]
    """Messages of each topic."""
    duration_s: float
    """Time from the first message to the last."""
    clocks: tuple[str, ...]
    """Clock of each unit, in the order of their topics: sensor, gps or host."""
    host_ahead_s: tuple[float, ...]
    """Capture stamps less the sensor's clock at the first data packet of each unit."""
    repeats: int
    """Packets left out as they came before."""
    interrupted: bool


def write_bag(
    capture: Path,
    out: Path,
    truth: Path | None = None,
    *,
    unit: str | None = None,
    clock: str | None = None,
    options: BagOptions | None = None,
    stop: Event | None = None,
) -> BagResult:
    """Write the bag of a capture; memory does not grow with its length.

    Parameters
    ----------
    capture : file with VLP-16 packets, also of a real sensor
    out : .mcap, .bag or a folder, as `BagFile` takes it
    truth : folder with the truth of the run: true odometry, transforms, inertial unit and receiver
    unit : the one sensor of several to write, as `chosen_unit` takes it; without it all of them
    clock : of all stamps, as `unit_clocks` takes it
    options : transforms, and a configuration beside the bag, which without truth has the capture's speed alone
    stop : ends the bag between two packets; it is valid

    Raises
    ------
    CaptureError, PacketError
        If the capture is none, is damaged, or has stamps that no bag can hold
    InputError
        If the truth cannot be read or is not of as many units, or there is no such unit or clock
    OutputError, MissingExtraError, RunError
        as `BagFile` and `write_beside`
    """
    options = options or BagOptions()
    spare([capture], out)
    check_bag(out)
    stop, every = stop or Event(), units_in(capture, required=True)
    units = every if unit is None else [chosen_unit(capture, unit, where="--unit") or every[0]]
    clocks = unit_clocks(capture, units, clock, where="--clock")
    check_stamps(capture, clocks, LATEST_NS)
    made = [one.make() for one in clocks]
    taken = [every.index(one) for one in units], len(every)
    truth_of = partial(_truth, truth, taken, options.tf) if truth else None
    write = write_beside(out, options.slam, _rig(capture, units, truth, taken)) if options.slam is not None else None
    with (
        _named(capture),
        BagSink(out, len(units), lambda number, _: made[number], truth_of) as sink,
        Capture(capture) as datagrams,
    ):
        for datagram in datagrams:
            if stop.is_set():
                break
            of = next((number for number, unit in enumerate(units) if unit.owns(datagram)), None)
            if of is not None:
                kind = PacketKind.DATA if len(datagram.payload) == DATA_BYTES else PacketKind.POSITION
                sink.send(Packet(kind, datagram.stamp_ns, datagram.payload, of, number=datagram.number))
    if write:
        write()
    first_ns, last_ns = sink.bag.span_ns or (0, 0)
    return BagResult(
        file=str(out),
        messages=dict(sorted(sink.bag.counts.items())),
        duration_s=(last_ns - first_ns) / S_NS,
        clocks=tuple(one.clock for one in clocks),
        host_ahead_s=tuple((one.host_ahead_ns or 0) / S_NS for one in made),
        repeats=datagrams.repeated,
        interrupted=stop.is_set(),
    )


@contextmanager
def _named(capture: Path) -> Iterator[None]:
    """Add the name of the capture to errors of its packets."""
    try:
        yield
    except PacketError as error:
        raise PacketError(f"{capture}: {error.where}", error.found, error.expected) from None


class _Rows:
    """Rows of a file in order of time, each written when its time has come."""

    def __init__(self, rows: Iterator[Row], take: Callable[..., None]) -> None:
        self._rows, self._take = rows, take
        self._next = next(rows, None)

    def up_to(self, t_ns: int) -> None:
        while self._next is not None and self._next[0] <= t_ns:
            self._take(*self._next)
            self._next = next(self._rows, None)


def _rig(capture: Path, units: Sequence[CapturedUnit], truth: Path | None, taken: tuple[Sequence[int], int]) -> Rig:
    """Return the rig of a capture by its truth, or with the speed of its first packets."""
    frame = frames_of(len(units))[0]
    if truth:
        return Rig.of(*_described(truth, taken), frame)
    with CaptureReader(capture, units[0]) as reader:
        next(reader.points(), None)
        return Rig(max(round(reader.summary.rpm / _SET_RPM), 1) * _SET_RPM, lidar_frame=frame)


def _described(folder: Path, taken: tuple[Sequence[int], int]) -> tuple[Any, Any]:
    """Return `rig.json`, with the units `taken` of so many in the capture, and `scenario.json` of a folder of truth."""
    rig, scenario = (_json(folder / name) for name in ("rig.json", "scenario.json"))
    numbers, several = taken
    if len(rig["units"]) != several:
        raise InputError(str(folder / "rig.json"), f"found {len(rig['units'])} units", f"{several}, as in the capture")
    return {**rig, "units": [rig["units"][number] for number in numbers]}, scenario


def _truth(
    folder: Path, taken: tuple[Sequence[int], int], tf: str, bag: BagFile, frames: Sequence[str], begin_ns: int
) -> list[tuple[TrueSamples, int]]:
    """Open the files of a folder of truth from an instant UTC on, for the units `taken` of so many in the capture."""
    rig, scenario = _described(folder, taken)
    to = TrueMessages(bag, rig, frames, imu := scenario.get("imu"), scenario["gps"], tf)
    to.fixed(begin_ns)
    files = [_Rows(_poses(folder / rig["units"][0]["trajectory"], begin_ns), to.odometry)]
    read = (*_AXES, *(ATTITUDE if imu and imu.get("attitude") else ()))
    stamp = STAMP if imu and (imu.get("jitter_s") or any(imu.get("delay_s", ()))) else _TIME
    for name, columns, take, time in (("imu.csv", read, to.inertial, stamp), ("gnss.csv", _SAID, to.fix, _TIME)):
        if (folder / name).exists():
            rows = (row for row in _table(folder / name, columns, time=time) if row[0] >= begin_ns)
            files.append(_Rows(rows, take))
    return [(file, _EVER_NS) for file in files]


def _json(path: Path) -> Any:
    with readable(path, "a file of a --truth folder", InputError):
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise InputError(str(path), "no JSON", "a file of a --truth folder") from None


def _poses(path: Path, begin_ns: int) -> Iterator[Row]:
    """Yield poses from an instant on, and velocity and angular rate until the next one; the last one keeps those before."""
    from scipy.spatial.transform import Rotation

    before: Row | None = None
    rates = [0.0] * 6
    for t_ns, pose in _table(path, _POSE[1:], names=_POSE):
        if before is not None:
            (t0_ns, pose0), step_s = before, (t_ns - before[0]) / S_NS
            try:
                back, turn = Rotation.from_quat(pose0[3:]).inv(), Rotation.from_quat(pose[3:])
            except ValueError:
                raise InputError(str(path), f"no rotation at {t_ns / S_NS:.3f} s", "a quaternion") from None
            moved_m, turned = back.apply(np.subtract(pose[:3], pose0[:3])), back * turn
            rates = (np.concatenate([moved_m, turned.as_rotvec()]) / step_s).tolist()
            if t0_ns >= begin_ns:
                yield t0_ns, pose0 + rates
        before = t_ns, pose
    if before is None or before[0] < begin_ns:
        found = "no poses" if before is None else f"poses until {before[0] / S_NS:.3f} s"
        expected = f"poses from the capture's first pulse on, {begin_ns / S_NS:.3f} s"
        raise InputError(str(path), found, expected)
    yield before[0], before[1] + rates


def _table(
    path: Path, columns: Sequence[str], names: Sequence[str] | None = None, *, time: str = _TIME
) -> Iterator[Row]:
    """Yield the numbers of columns, and the time, of a CSV; or of a TUM file, which has no names of its own."""
    with readable(path, "a file of a --truth folder", InputError, most_bytes=_EVER_NS), path.open() as lines:
        reader = csv.DictReader(lines, names, delimiter=" " if names else ",")
        if missing := {time, *columns} - set(reader.fieldnames or ()):
            raise InputError(f"{path}, line 1", f"no column {min(missing)}", f"the columns {', '.join(columns)}")
        for row in reader:
            if row[time] == "#":
                continue
            try:
                yield int(row[time].replace(".", "")), [float(row[name]) for name in columns]
            except (TypeError, ValueError):
                found = f"found {' '.join(str(cell) for cell in row.values())[:60]}"
                raise InputError(f"{path}, line {reader.line_num}", found, "numbers") from None
