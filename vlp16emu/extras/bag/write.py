"""A run, or a capture with or without its truth, as a bag."""

import csv
import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vlp16emu.captures import (
    Capture,
    CaptureReader,
    Clock,
    PacketClock,
    UnitClock,
    chosen_unit,
    unit_clocks,
    units_in,
)
from vlp16emu.captures.capture import CapturedUnit, Datagram
from vlp16emu.elementary import matvec
from vlp16emu.engine import Engine
from vlp16emu.errors import CaptureError, InputError, PacketError, readable
from vlp16emu.extras.bag.bag_file import LATEST_NS, BagFile, check_bag
from vlp16emu.extras.bag.messages import TrueMessages, UnitMessages
from vlp16emu.extras.imu.sampler import Inertial
from vlp16emu.extras.slam.configure import Rig, written_beside
from vlp16emu.extras.truth.folder import read_json
from vlp16emu.extras.truth.truth import ATTITUDE, IMU_AXES, STAMP, Samples, attitude_of, rig_of, true_motion
from vlp16emu.motion.pose import Kinematics
from vlp16emu.output import spare
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES
from vlp16emu.run.options import BagOptions
from vlp16emu.sensor.settings import RPM_STEP
from vlp16emu.sinks import PacketSink, PcapResult
from vlp16emu.types import Packet, PacketKind, PpsState
from vlp16emu.units import S_NS, US_NS

if TYPE_CHECKING:
    from vlp16emu.extras.camera.shot import Photographer

_EXPECTED = "a file of a --truth folder"
_TIME = "t_utc_s"
_POSE = (_TIME, "x", "y", "z", "qx", "qy", "qz", "qw")
_SAID = ("latitude_deg", "longitude_deg", "valid")
_EVER_NS = 2**62
_OFTEN_NS = S_NS // 10  # span of ground truth that is written together

Row = tuple[int, list[float]]  # UTC of a sample, and its values
Feed = Callable[[int], None]  # writes all samples up to and including an instant that are not written yet


class Truth(NamedTuple):
    """Ground truth of a run, from its engine or from its files."""

    rig: Mapping[str, Any]  # `rig.json`, with the units that are written
    scenario: Mapping[str, Any]  # `scenario.json`
    feeds: Callable[
        [TrueMessages, int], Sequence[Feed]
    ]  # returns the feeds of samples from the first pulse on
    after_ns: int  # time after the last packet that is also written


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
        truth: Truth | None,
    ) -> None:
        self.bag = BagFile(path)
        self._frames = frames
        self._clock_of = clock_of
        self._tf = options.tf
        self._truth = truth
        self._units = dict[int, UnitMessages]()
        self._feeds: Sequence[Feed] | None = None
        self._sent = Counter[PacketKind]()
        self._seen_ns = self._next_ns = -_EVER_NS

    def __exit__(self, *raised: object) -> None:
        with self.bag:
            if isinstance(raised[1], BaseException):
                raise raised[1]
            for unit in self._units.values():
                unit.check()
            self._write_truth(self._truth.after_ns if self._truth else 0)

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
            if self._feeds is None and self._truth is not None:
                to = TrueMessages(self.bag, self._truth.rig, self._truth.scenario, self._frames, self._tf)
                to.fixed(t_ns)
                self._feeds = self._truth.feeds(to, t_ns)
        elif len(packet.payload) == POSITION_BYTES:
            t_ns = unit.position(stamp_ns, packet.payload)
        else:
            return
        self._seen_ns = max(self._seen_ns, t_ns)
        if t_ns >= self._next_ns:
            self._next_ns = t_ns + _OFTEN_NS
            self._write_truth(0)

    def _write_truth(self, after_ns: int) -> None:
        for feed in self._feeds or ():
            feed(self._seen_ns + after_ns)

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
    """Open a bag for the packets and the ground truth of a run, with poses at `rate_hz`; errors of `BagFile` and `written_beside`."""
    options = options or BagOptions()
    scenario = engine.scenario
    units = engine.parts.units
    rig = rig_of(scenario, engine.parts)
    tree = scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    frames = _frames(len(units))
    photographer = None
    if scenario.camera is not None:
        from vlp16emu.extras.camera.shot import Photographer  # here: few scenes have a camera

        photographer = Photographer(engine)

    def clock_of(number: int, due_ns: int) -> PacketClock:
        is_locked = units[number].state.gps.pps.at(due_ns) is PpsState.LOCKED
        return PacketClock(Clock.SENSOR if is_locked else Clock.HOST)

    truth = Truth(rig, tree, partial(_feeds_of_run, engine, rate_hz, photographer), -(-S_NS // rate_hz))
    with (
        written_beside(path, options.slam, lambda: Rig.of(rig, tree, frames[0])),
        BagSink(path, frames, clock_of, options, truth) as sink,
    ):
        yield [sink]


def _frames(units: int) -> list[str]:
    """Return the frames of the clouds of `units` sensors; their topics have the same prefixes."""
    return ["velodyne"] if units == 1 else [f"unit_{number}/velodyne" for number in range(1, units + 1)]


def _feeds_of_run(
    engine: Engine, rate_hz: int, photographer: "Photographer | None", to: TrueMessages, begin_ns: int
) -> Sequence[Feed]:
    from scipy.spatial.transform import Rotation

    parts = engine.parts
    start_ns = engine.scenario.start_ns

    def odometry(true: Kinematics) -> None:
        quaternion = Rotation.from_matrix(true.world_R_body).as_quat(canonical=True)
        own_m_s = matvec(true.world_R_body.transpose(0, 2, 1), true.world_v_body_m_s)
        numbers = np.column_stack([true.world_p_body_m, quaternion, own_m_s, true.body_w_rad_s]).tolist()
        for sample in zip(true.t_ns.tolist(), numbers, strict=True):
            to.odometry(*sample)

    def inertial(read: Inertial) -> None:
        rates = np.column_stack(
            [read.angular_rate_rad_s, read.specific_force_m_s2, *attitude_of(read)]
        ).tolist()
        stamps_ns = read.t_ns if read.stamp_ns is None else read.stamp_ns
        for sample in zip(stamps_ns.tolist(), rates, strict=True):
            to.inertial(*sample)

    def fixes(seconds: range) -> None:
        for second in seconds:
            said = engine.receiver.fix(second * S_NS)
            to.fix(second * S_NS, (said.latitude_deg, said.longitude_deg, said.valid))

    poses = partial(true_motion, parts.units[0].motion, start_ns, rate_hz)
    feeds: list[Feed] = [Samples(odometry, poses, start_ns, rate_hz, begin_ns).up_to]
    if (imu := engine.scenario.imu) is not None and parts.imu is not None:
        feeds.append(Samples(inertial, parts.imu.read, start_ns, imu.rate_hz, begin_ns).up_to)
    if (named_ns := parts.gps.second_ns(begin_ns)) is not None:
        begin_ns = max(named_ns, begin_ns)
        feeds.append(Samples(fixes, lambda first, count: range(first, first + count), 0, 1, begin_ns).up_to)
    if photographer is not None:
        feeds.append(_images_of_run(engine, photographer, to, begin_ns))
    return feeds


def _images_of_run(engine: Engine, photographer: "Photographer", to: TrueMessages, begin_ns: int) -> Feed:
    """Return the feed of the images that the scene's camera takes from an instant on, until the run is stopped."""
    start_ns = engine.scenario.start_ns
    step_ns = photographer.step_ns

    def take(t_ns: int) -> None:
        with suppress(CancelledError):  # a stopped run goes without its last images
            to.image(photographer.lens, photographer.take(t_ns))

    first = -(-(begin_ns - start_ns) // step_ns)
    return _feed(((start_ns + number * step_ns,) for number in count(first)), take)


def _images_of_folder(folder: Path, to: TrueMessages, begin_ns: int) -> Feed:
    """Return the feed of the images of a folder from an instant on."""
    from vlp16emu.extras.camera.folder import read_images

    _, lens, shots = read_images(folder)
    rows = ((shot.t_ns, shot) for shot in shots if shot.t_ns >= begin_ns)
    return _feed(rows, lambda _, shot: to.image(lens, shot))


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
) -> dict[str, Any]:
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
    every = units_in(capture, required=True)
    units = every if unit is None else [chosen_unit(capture, unit, where="--unit") or every[0]]
    clocks = unit_clocks(capture, units, clock, where="--clock")
    _check_stamps(capture, clocks)
    made = [one.make() for one in clocks]
    frames = _frames(len(units))
    true = (
        None if truth is None else _truth_of(truth, [every.index(one) for one in units], len(every), images)
    )

    with (
        written_beside(out, options.slam, lambda: _rig(true, capture, units[0], frames[0])),
        BagSink(out, frames, lambda number, _: made[number], options, true) as sink,
        Capture(capture) as datagrams,
    ):
        for datagram in datagrams:
            if stop.is_set():
                break
            _send(datagram, units, sink, capture)
    first_ns, last_ns = sink.bag.span_ns or (0, 0)
    return {
        "file": str(out),
        "messages": dict(sorted(sink.bag.counts.items())),  # by topic
        "duration_s": (last_ns - first_ns) / S_NS,
        "clocks": tuple(one.clock for one in clocks),  # of each unit, in the order of their topics
        "host_ahead_s": tuple((one.host_ahead_ns or 0) / S_NS for one in made),
        "repeats": datagrams.repeated,  # packets left out as repeated
        "interrupted": stop.is_set(),
    }


def _rig(true: Truth | None, capture: Path, unit: CapturedUnit, frame: str) -> Rig:
    """Return the sensors of the ground truth; without it the unit of the capture, at the rotor speed of its first packets."""
    if true:
        return Rig.of(true.rig, true.scenario, frame)
    with CaptureReader(capture, unit) as reader:
        next(reader.points(), None)
        return Rig(float(max(round(reader.summary.rpm / RPM_STEP), 1) * RPM_STEP), lidar_frame=frame)


def _send(datagram: Datagram, units: Sequence[CapturedUnit], sink: BagSink, capture: Path) -> None:
    """Send a datagram of one of the units to the sink; PacketError names the capture."""
    of = next((number for number, unit in enumerate(units) if unit.owns(datagram)), None)
    if of is None:
        return
    kind = PacketKind.DATA if len(datagram.payload) == DATA_BYTES else PacketKind.POSITION
    try:
        sink.send(Packet(kind, datagram.stamp_ns, datagram.payload, of, number=datagram.number))
    except PacketError as error:
        raise PacketError(f"{capture}: {error.where}", error.found, error.expected) from None


def _check_stamps(capture: Path, clocks: Sequence[UnitClock]) -> None:
    """Refuse a capture whose first packets are before 1970 or after the range of bags."""
    for of in clocks:
        if not 0 <= of.first_ns <= LATEST_NS:
            found = f"a first packet at {of.first_ns / S_NS:.3f} s since 1970 by the {of.clock}'s clock"
            raise CaptureError(str(capture), found, f"0 to {LATEST_NS // S_NS} s; --clock chooses another")


def _truth_of(folder: Path, taken: Sequence[int], units: int, images: Path | None) -> Truth:
    """Return the ground truth of a folder for the units `taken`, with images; the capture has `units` units."""
    rig, scenario = (read_json(folder / name, _EXPECTED) for name in ("rig.json", "scenario.json"))
    if len(rig["units"]) != units:
        raise InputError(
            str(folder / "rig.json"), f"found {len(rig['units'])} units", f"{units}, as in the capture"
        )
    rig = {**rig, "units": [rig["units"][number] for number in taken]}
    rig.pop("camera", None)  # of images that are not in the bag
    if images is not None:
        from vlp16emu.extras.camera.folder import read_images

        rig["camera"] = read_images(images)[0]["rig"]

    def feeds(to: TrueMessages, begin_ns: int) -> list[Feed]:
        imu = scenario.get("imu") or {}
        read = (*IMU_AXES, *(ATTITUDE if imu.get("attitude") else ()))
        stamp = STAMP if imu.get("jitter_s") or any(imu.get("delay_s", ())) else _TIME
        found = [_feed(_poses(folder / rig["units"][0]["trajectory"], begin_ns), to.odometry)]
        for name, columns, take, time in (
            ("imu.csv", read, to.inertial, stamp),
            ("gnss.csv", _SAID, to.fix, _TIME),
        ):
            if (folder / name).exists():
                rows = _table(folder / name, columns, time=time)
                found.append(_feed((row for row in rows if row[0] >= begin_ns), take))
        if images is not None:
            found.append(_images_of_folder(images, to, begin_ns))
        return found

    return Truth(rig, scenario, feeds, _EVER_NS)


def _feed(rows: Iterator[tuple[int, *tuple[Any, ...]]], take: Callable[..., None]) -> Feed:
    """Return a function that passes rows in order, up to and including an instant, to `take`."""
    waiting = next(rows, None)

    def up_to(t_ns: int) -> None:
        nonlocal waiting
        while waiting is not None and waiting[0] <= t_ns:
            take(*waiting)
            waiting = next(rows, None)

    return up_to


def _poses(path: Path, begin_ns: int) -> Iterator[Row]:
    """Yield poses from an instant on, with velocity and angular rate up to the next pose; the last pose repeats the rates before it."""
    from scipy.spatial.transform import Rotation

    before: Row | None = None
    rates = [0.0] * 6
    for t_ns, pose in _table(path, _POSE[1:], names=_POSE):
        if before is not None:
            (t0_ns, pose0) = before
            step_s = (t_ns - before[0]) / S_NS
            try:
                back = Rotation.from_quat(pose0[3:]).inv()
                turn = Rotation.from_quat(pose[3:])
            except ValueError:
                raise InputError(str(path), f"no rotation at {t_ns / S_NS:.3f} s", "a quaternion") from None
            moved_m = matvec(back.as_matrix(), np.subtract(pose[:3], pose0[:3]))
            rates = (np.concatenate([moved_m, (back * turn).as_rotvec()]) / step_s).tolist()
            if t0_ns >= begin_ns:
                yield t0_ns, pose0 + rates
        before = t_ns, pose
    if before is None or before[0] < begin_ns:
        found = "no poses" if before is None else f"poses until {before[0] / S_NS:.3f} s"
        raise InputError(
            str(path), found, f"poses from the capture's first pulse on, {begin_ns / S_NS:.3f} s"
        )
    yield before[0], before[1] + rates


def _table(
    path: Path, columns: Sequence[str], names: Sequence[str] = (), *, time: str = _TIME
) -> Iterator[Row]:
    """Yield the time and the numbers of some columns of a CSV, or of a TUM file, which has no header."""
    with readable(path, _EXPECTED, InputError, most_bytes=_EVER_NS), path.open() as lines:
        reader = csv.DictReader(lines, names or None, delimiter=" " if names else ",")
        if missing := {time, *columns} - set(reader.fieldnames or ()):
            raise InputError(
                f"{path}, line 1", f"no column {min(missing)}", f"the columns {', '.join(columns)}"
            )
        for row in reader:
            if row[time] == "#":
                continue
            try:
                seconds, _, decimals = row[time].partition(
                    "."
                )  # other programs write fewer decimals than nine
                yield int(seconds + f"{decimals:0<9}"[:9]), [float(row[name]) for name in columns]
            except (AttributeError, TypeError, ValueError):
                found = f"found {' '.join(str(cell) for cell in row.values())[:60]}"
                raise InputError(f"{path}, line {reader.line_num}", found, "numbers") from None
