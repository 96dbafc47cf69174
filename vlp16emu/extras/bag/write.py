"""A run, or a capture with or without its truth, as a bag."""

import hashlib
import os
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from vlp16emu.captures import Capture, CaptureReader, Survey, UnitClock, by_unit, unit_clocks
from vlp16emu.captures.datagrams import Datagram
from vlp16emu.captures.units import CapturedUnit
from vlp16emu.engine import Engine
from vlp16emu.errors import CaptureError, InputError, PacketError
from vlp16emu.extras.bag.bag_file import LATEST_NS, BagFile, check_bag
from vlp16emu.extras.bag.messages import TrueMessages, UnitMessages
from vlp16emu.extras.slam.configure import Rig, written_beside
from vlp16emu.extras.truth.description import read_rig, read_scenario
from vlp16emu.extras.truth.tables import (
    FIXES,
    INERTIAL,
    POSES,
    Rows,
    StoredTable,
    fix_samples,
    inertial_samples,
    pose_samples,
)
from vlp16emu.extras.truth.truth import rig_of
from vlp16emu.output import spare
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES, Clock, PacketClock
from vlp16emu.run.options import BagOptions
from vlp16emu.sensor.settings import set_rpm
from vlp16emu.sinks import PacketSink, PcapResult
from vlp16emu.trees import Table, Tree
from vlp16emu.types import Packet, PacketKind, PpsState
from vlp16emu.units import S_NS, US_NS

if TYPE_CHECKING:
    from vlp16emu.extras.camera.lens import Lens
    from vlp16emu.extras.camera.shot import Photographer, Shot

_EXPECTED = "a file of a --truth folder"
_EVER_NS = 2**62
_OFTEN_NS = S_NS // 10  # span of ground truth that is written together


@dataclass(frozen=True, slots=True)
class TruthSource:
    """Ground truth of a run, from its engine or from its files.

    Functions return the samples from an instant on and before another one.
    """

    rig: Table  # `rig.json`, with the units that are written
    scenario: Table  # `scenario.json`
    after_ns: int  # time after the last packet that is also written
    poses: Callable[[int, int], Rows]
    readings: Callable[[int, int], Rows] | None = None  # of the inertial unit
    fixes: Callable[[int, int], Rows] | None = None
    images: "tuple[Lens, Callable[[int, int], Iterable[Shot]]] | None" = None

    def write_to(self, to: TrueMessages, start_ns: int, stop_ns: int) -> None:
        """Write all messages from `start_ns` on and before `stop_ns`."""
        to.odometry(self.poses(start_ns, stop_ns))
        if self.readings is not None:
            to.inertial(self.readings(start_ns, stop_ns))
        if self.fixes is not None:
            to.fixes(self.fixes(start_ns, stop_ns))
        if self.images is not None:
            lens, shots = self.images
            for shot in shots(start_ns, stop_ns):
                to.image(lens, shot)


class BagSink(PacketSink):
    """Sink that writes packets of one or several sensors, and the ground truth of the same time, into a bag.

    If there are several units, each has its topics and its frame under `/unit_1` and so on.

    Parameters
    ----------
    path : .mcap, .bag or a folder, as `BagFile` takes it
    frames : frames of the clouds of the units
    clock_of : returns the clock of a sensor from its number, from 0, and the stamp of its first data packet
    options : transforms
    truth : ground truth to be in the bag

    Raises OutputError, MissingExtraError like `BagFile`; RunError if the disk is full, here or later.
    """

    def __init__(
        self,
        path: Path,
        frames: Sequence[str],
        clock_of: Callable[[int, int], PacketClock],
        options: BagOptions,
        truth: TruthSource | None,
    ) -> None:
        self.bag = BagFile(path)
        self._frames = frames
        self._clock_of = clock_of
        self._tf = options.tf
        self._truth = truth
        self._units = dict[int, UnitMessages]()
        self._messages: TrueMessages | None = None
        self._written_ns = 0
        """Ground truth before this instant is written."""
        self._sent = Counter[PacketKind]()
        self._seen_ns = self._next_ns = -_EVER_NS

    def __exit__(self, *raised: object) -> None:
        with self.bag:
            if isinstance(raised[1], BaseException):
                raise raised[1]
            for unit in self._units.values():
                unit.check()
            if self._truth is not None:
                self._write_truth(self._seen_ns + self._truth.after_ns)

    def send(self, packet: Packet) -> None:
        """Write one packet with the stamp of its capture; its number, if it has one, is its frame's number.

        Raises PacketError if it is no VLP-16 packet.
        """
        if (unit := self._units.get(packet.unit)) is None:
            clock = self._clock_of(packet.unit, packet.due_ns)
            unit = self._units[packet.unit] = UnitMessages(self.bag, self._frames[packet.unit], clock)
        self._sent[packet.kind] += 1
        stamp_ns = packet.due_ns // US_NS * US_NS  # like stamps of captures
        if len(packet.payload) == DATA_BYTES:
            t_ns = unit.data(stamp_ns, packet.payload, packet.number or self._sent.total())
            if self._messages is None and self._truth is not None:
                truth = self._truth
                self._messages = TrueMessages(self.bag, truth.rig, truth.scenario, self._frames, self._tf)
                self._messages.fixed(t_ns)
                self._written_ns = t_ns
        elif len(packet.payload) == POSITION_BYTES:
            t_ns = unit.position(stamp_ns, packet.payload)
        else:
            return
        self._seen_ns = max(self._seen_ns, t_ns)
        if t_ns >= self._next_ns:
            self._next_ns = t_ns + _OFTEN_NS
            self._write_truth(self._seen_ns)

    def _write_truth(self, until_ns: int) -> None:
        """Write the ground truth up to and including an instant that is not written yet."""
        if self._messages is not None and self._truth is not None:
            self._truth.write_to(self._messages, self._written_ns, until_ns + 1)
            self._written_ns = until_ns + 1

    @property
    def result(self) -> PcapResult:
        """Return the contents of the closed bag; sha256 of several files in the order of their names."""
        path = self.bag.path
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        return PcapResult(
            bytes=sum(file.stat().st_size for file in files),
            sha256=", ".join(map(_sha256, files)),
            messages=dict(sorted(self.bag.counts.items())),
        )


def _sha256(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


@contextmanager
def bag_of_run(
    path: Path, engine: Engine, rate_hz: int, options: BagOptions | None = None
) -> Iterator[list[BagSink]]:
    """Open a bag for the packets and the ground truth of a run, with poses at `rate_hz`.

    Raises the errors of `BagFile` and `written_beside`.
    """
    options = options or BagOptions()
    units = engine.parts.units
    frames = _frames(len(units))
    truth = _truth_of_run(engine, rate_hz)

    def clock_of(number: int, due_ns: int) -> PacketClock:
        """Return the sensor's clock for a unit that is locked to GPS, else the host's."""
        is_locked = units[number].state.gps.pps.at(due_ns) is PpsState.LOCKED
        return PacketClock(Clock.SENSOR if is_locked else Clock.HOST)

    with (
        written_beside(path, options.slam, lambda: Rig.from_truth(truth.rig, truth.scenario, frames[0])),
        BagSink(path, frames, clock_of, options, truth) as sink,
    ):
        yield [sink]


def _truth_of_run(engine: Engine, rate_hz: int) -> TruthSource:
    """Return the ground truth of a run, with poses at `rate_hz`."""
    scenario = engine.scenario
    poses = pose_samples(engine.parts.units[0].motion, scenario.start_ns, rate_hz)
    tree = scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    truth = TruthSource(rig_of(scenario, engine.parts), tree, -(-S_NS // rate_hz), poses.between)
    if (readings := inertial_samples(engine)) is not None:
        truth = replace(truth, readings=readings.between)
    if engine.parts.gps.connected:
        truth = replace(truth, fixes=fix_samples(engine).between)
    if scenario.camera is not None:
        from vlp16emu.extras.camera.shot import Photographer  # here: few scenes have a camera

        photographer = Photographer(engine)
        shots = partial(_shots_of_run, photographer, scenario.start_ns)
        truth = replace(truth, images=(photographer.lens, shots))
    return truth


def _frames(units: int) -> list[str]:
    """Return the frames of the clouds of `units` sensors; their topics have the same prefixes."""
    return ["velodyne"] if units == 1 else [f"unit_{number}/velodyne" for number in range(1, units + 1)]


def _shots_of_run(
    photographer: "Photographer", zero_ns: int, start_ns: int, stop_ns: int
) -> Iterator["Shot"]:
    """Take the images of the scene's camera, until the run is stopped."""
    step_ns = photographer.step_ns
    first_ns = start_ns + (zero_ns - start_ns) % step_ns
    for t_ns in range(first_ns, stop_ns, step_ns):
        with suppress(CancelledError):  # a stopped run goes without its last images
            yield photographer.take(t_ns)


def write_bag(
    capture: Path,
    out: Path,
    truth: Path | None = None,
    *,
    images: Path | None = None,
    unit: str | None = None,
    clock: str | None = None,
    options: BagOptions | None = None,
    stop: Event | None = None,
    progress: Callable[[float], None] | None = None,
) -> Tree:
    """Write the bag of a capture, and return its contents; memory does not grow with its length.

    Parameters
    ----------
    capture : file with VLP-16 packets, also of a real sensor
    out : .mcap, .bag or a folder, as `BagFile` takes it
    truth : folder with the truth of the run: true odometry, transforms, inertial unit and receiver
    images : folder of images of the same run, which needs `truth`
    unit : the sensor to write, as `chosen_unit` takes it; by default all sensors
    clock : clock of all stamps, as `unit_clocks` takes it
    options : transforms, and a configuration beside the bag, which without ground truth has only the
        capture's speed
    stop : ends the bag between two packets; it is valid
    progress : called with the share of the capture that is read, in each of two passes

    Raises CaptureError, PacketError if the file is no capture, is damaged, or has stamps out of the range of
    bags; InputError if the ground truth cannot be read or has another number of units, or there is no such
    unit or clock; OutputError, MissingExtraError, RunError like `BagFile` and `written_beside`.
    """
    options = options or BagOptions()
    stop = stop or Event()
    spare([capture], out)
    check_bag(out)
    if images is not None and truth is None:
        raise InputError(
            "--images", "found without --truth", "--truth DIR of the same run, whose frames they are in"
        )
    survey = Survey(capture, stop, progress)
    units = _units_of(survey, unit)
    clocks = unit_clocks(capture, units, clock, where="--clock", stop=stop)
    _check_stamps(capture, clocks)
    frames = _frames(len(units))
    true = _truth_beside(survey, units, min(each.first_ns for each in clocks), truth, images)
    datagrams = Capture(capture, progress=progress)

    with (
        written_beside(out, options.slam, lambda: _rig(true, capture, units[0], frames[0])),
        BagSink(out, frames, lambda number, _: clocks[number].clock, options, true) as sink,
    ):
        for number, datagram in by_unit(datagrams, units):
            if stop.is_set():
                break
            if number is not None:
                _send(datagram, number, sink, capture)
    return {**_contents(out, sink, clocks, datagrams), "interrupted": stop.is_set()}


def _contents(out: Path, sink: BagSink, clocks: Sequence[UnitClock], datagrams: Capture) -> Tree:
    """Return what a written bag holds, the clocks of its stamps, and what the capture lacked."""
    first_ns, last_ns = sink.bag.span_ns or (0, 0)
    return {
        "file": str(out),
        "messages": dict(sorted(sink.bag.counts.items())),  # by topic
        "duration_s": (last_ns - first_ns) / S_NS,
        "clocks": tuple(each.clock.clock for each in clocks),  # of each unit, in the order of their topics
        "fit": tuple(each.clock.fit.summary for each in clocks if each.clock.fit),  # of the host's clock
        "host_ahead_s": tuple((each.clock.host_ahead_ns or 0) / S_NS for each in clocks),
        "repeats": datagrams.repeated,  # packets left out as repeated
        "damage": tuple(datagrams.damage),  # damaged parts of the capture that were left out
    }


def _units_of(survey: Survey, unit: str | None) -> list[CapturedUnit]:
    """Return the sensors to write: one if it is named, else all."""
    every = survey.required()
    if unit is None:
        return every
    return [survey.chosen(unit, where="--unit") or every[0]]


def _truth_beside(
    survey: Survey, units: Sequence[CapturedUnit], first_ns: int, folder: Path | None, images: Path | None
) -> TruthSource | None:
    """Return the ground truth of a capture whose first packet is at `first_ns` UTC; None without a folder."""
    if folder is None:
        return None
    taken = [survey.units.index(one) for one in units]
    truth = _truth_of_folder(folder, taken, len(survey.units), first_ns)
    return truth if images is None else _with_images(truth, images, first_ns)


def _rig(true: TruthSource | None, capture: Path, unit: CapturedUnit, frame: str) -> Rig:
    """Return the sensors of the ground truth.

    Without it the unit of the capture is returned, at the rotor speed of its first packets.
    """
    if true:
        return Rig.from_truth(true.rig, true.scenario, frame)
    reader = CaptureReader(capture, unit, is_quiet=True)
    next(reader.tables(), None)
    summary = reader.summary
    return Rig(float(set_rpm(summary.rpm)), lidar_frame=frame, model=summary.model)


def _send(datagram: Datagram, unit: int, sink: BagSink, capture: Path) -> None:
    """Send a datagram of a unit, numbered from 0, to the sink; PacketError names the capture."""
    kind = PacketKind.DATA if len(datagram.payload) == DATA_BYTES else PacketKind.POSITION
    try:
        sink.send(Packet(kind, datagram.stamp_ns, datagram.payload, unit, number=datagram.number))
    except PacketError as error:
        raise PacketError(f"{capture}: {error.where}", error.found, error.expected) from None


def _check_stamps(capture: Path, clocks: Sequence[UnitClock]) -> None:
    """Refuse a capture whose first packets are before 1970 or after the range of bags."""
    for of in clocks:
        if not 0 <= of.first_ns <= LATEST_NS:
            found = f"a first packet at {of.first_ns / S_NS:.3f} s since 1970 by the {of.clock.clock}'s clock"
            raise CaptureError(str(capture), found, f"0 to {LATEST_NS // S_NS} s; --clock chooses another")


def _truth_of_folder(folder: Path, taken: Sequence[int], units: int, first_ns: int) -> TruthSource:
    """Return the ground truth of a run, without images.

    Parameters
    ----------
    taken : units to write, of the `units` units of a capture
    first_ns : UTC of the first packet of the capture
    """
    rig = read_rig(folder, _EXPECTED)
    scenario = read_scenario(folder, _EXPECTED)
    if len(rig["units"]) != units:
        raise InputError(
            str(folder / "rig.json"), f"found {len(rig['units'])} units", f"{units}, as in the capture"
        )
    rig = {**rig, "units": [rig["units"][number] for number in taken]}
    rig.pop("camera", None)  # of images that are not in the bag
    poses = StoredTable((folder / rig["units"][0]["trajectory"]).with_suffix(".npy"), POSES.dtype)
    t_ns = poses.rows["t_ns"]
    if not len(t_ns) or t_ns[-1] < first_ns:
        found = f"poses until {t_ns[-1] / S_NS:.3f} s" if len(t_ns) else "no poses"
        expected = f"poses from the capture's first pulse on, {first_ns / S_NS:.3f} s"
        raise InputError(str(poses.path), found, expected)
    step_ns = int(t_ns[-1] - t_ns[-2:][0])
    truth = TruthSource(rig, scenario, step_ns, poses.between)
    if os.path.lexists(folder / "imu.npy"):
        for name, described in (("rig.json", rig), ("scenario.json", scenario)):
            if "imu" not in described:
                raise InputError(str(folder / name), "no imu", "the inertial unit of imu.npy")
        truth = replace(truth, readings=StoredTable(folder / "imu.npy", INERTIAL).between)
    if os.path.lexists(folder / "gnss.npy"):
        truth = replace(truth, fixes=StoredTable(folder / "gnss.npy", FIXES.dtype).between)
    return truth


def _with_images(truth: TruthSource, folder: Path, first_ns: int) -> TruthSource:
    """Add the images of a folder from `first_ns` on, and their camera."""
    from vlp16emu.extras.camera.folder import read_images

    cameras, lens, shots = read_images(folder)
    times_ns = [row["t_ns"] for row in cameras["images"]]
    later = islice(shots, bisect_left(times_ns, first_ns), None)

    def between(start_ns: int, stop_ns: int) -> Iterator["Shot"]:
        """Read the next images; spans follow one another from `first_ns` on."""
        return islice(later, bisect_left(times_ns, stop_ns) - bisect_left(times_ns, start_ns))

    return replace(truth, rig={**truth.rig, "camera": cameras["rig"]}, images=(lens, between))
