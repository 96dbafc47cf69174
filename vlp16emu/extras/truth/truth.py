"""Ground truth of a run: trajectory, inertial unit, GNSS, events, rig and scenario."""

import heapq
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import islice
from typing import Self

import numpy as np

from vlp16emu.engine import Engine, Parts, Unit, mounts_of
from vlp16emu.engine.engine import positions_due, sent_before
from vlp16emu.errors import RunError
from vlp16emu.extras.bench.events import Event
from vlp16emu.extras.bench.faults import PacketFault, arriving_packets, earliest_ns, faults_of, kinds_of
from vlp16emu.extras.truth.folder import TruthFolder
from vlp16emu.extras.truth.slots import SlotTable
from vlp16emu.extras.truth.tables import (
    POSES,
    Samples,
    fix_samples,
    inertial_samples,
    pose_rows,
    pose_samples,
    quaternions,
    seconds_text,
)
from vlp16emu.motion.settings import Mount
from vlp16emu.output import write_json
from vlp16emu.packets import SENSOR_R_MANUAL
from vlp16emu.rotation import rotation
from vlp16emu.run.emulator import Emulator, HasEngine
from vlp16emu.run.options import TruthPlace, TruthTo
from vlp16emu.scenario import Scenario, named_files
from vlp16emu.sensor.settings import Sensor, require_packets
from vlp16emu.trees import Tree
from vlp16emu.types import F8, Packet, PacketKind
from vlp16emu.units import S_NS, seconds_to_ns


@dataclass(frozen=True, slots=True, order=True)
class Happening:
    """An event with the packets of one kind that are due while it lasts, or one packet that an event hits."""

    begin_ns: int  # UTC, like the next field
    end_ns: int
    event: int  # number of the table in the scene, from 1
    unit: int  # from 1
    kind: str
    packets: PacketKind
    first: (
        int  # number of the first packet after its begin; packets count from 0 at the first pulse of the run
    )
    count: int  # number of packets until its end

    @property
    def row(self) -> str:
        """Return its line of `events.csv`."""
        last = str(self.first + self.count - 1) if self.count else ""
        cells = (
            seconds_text(self.begin_ns),
            seconds_text(self.end_ns),
            self.event,
            self.unit,
            self.kind,
            self.packets,
        )
        return ",".join(map(str, (*cells, self.first, last, self.count))) + "\n"


def happenings(
    scenario: Scenario, units: Sequence[Unit], from_ns: int | None, until_ns: int, stop_ns: int
) -> list[Happening]:
    """Return the events that begin in a span of time since the first pulse.

    Events that hit each packet with a probability are listed packet by packet, in order of due time.

    Parameters
    ----------
    from_ns : begin of the span; None to include earlier events
    until_ns : end of the span
    stop_ns : end of the run, and of events that last longer
    """
    found = list[Happening]()
    for place, event in enumerate(scenario.events):
        begin_ns = event.begin_ns
        if not event.is_random and (from_ns is None or from_ns <= begin_ns) and begin_ns < until_ns:
            found += _whole(scenario, units[event.unit - 1], place, event, stop_ns)
    random = [fault for fault in faults_of(scenario, units) if fault.event.is_random]
    if random:
        found += _single(scenario, units, random, from_ns or 0, until_ns)
    return sorted(found)


def _whole(scenario: Scenario, unit: Unit, place: int, event: Event, stop_ns: int) -> Iterator[Happening]:
    begin_ns = event.begin_ns
    over_ns = event.end_ns
    start_ns = scenario.start_ns
    if event.effect != "power":
        over_ns = min(over_ns, max(stop_ns, begin_ns))
    kinds: tuple[PacketKind, ...] = (PacketKind.POSITION if event.effect == "gps" else PacketKind.DATA,)
    for kind in kinds_of(event) if event.effect == "packets" else kinds:
        first = sent_before(scenario, unit, kind, begin_ns)
        until_ns = over_ns
        if event.effect == "packets" and event.count is not None:
            due_ns = (
                packet.due_ns
                for packet in timetable(scenario, [unit], begin_ns, over_ns)
                if packet.kind is kind
            )
            last_ns = max(islice(due_ns, event.count), default=start_ns + begin_ns)
            until_ns = last_ns + 1 - start_ns
        count = sent_before(scenario, unit, kind, until_ns) - first
        times = start_ns + begin_ns, start_ns + until_ns
        yield Happening(*times, place + 1, event.unit, event.kind, kind, first, count)


def _single(
    scenario: Scenario, units: Sequence[Unit], faults: Sequence[PacketFault], from_ns: int, until_ns: int
) -> Iterator[Happening]:
    numbers = {unit.number: sent_before(scenario, unit, PacketKind.DATA, from_ns) for unit in units}
    for packet in timetable(scenario, units, from_ns, until_ns):
        number = packet.number
        if packet.kind is PacketKind.DATA:
            number = numbers[packet.unit]
            numbers[packet.unit] += 1
        for fault in faults:
            if fault.unit.number == packet.unit and fault.hits(packet, number):
                times = (packet.due_ns, packet.due_ns)
                of = (fault.number + 1, fault.unit.number + 1)
                first = sent_before(scenario, fault.unit, packet.kind, packet.due_ns - scenario.start_ns)
                yield Happening(*times, *of, fault.event.kind, packet.kind, first, 1)


def timetable(scenario: Scenario, units: Sequence[Unit], start_ns: int, stop_ns: int) -> Iterator[Packet]:
    """Yield the packets due in a span since the first pulse in order of sending, without casting a ray.

    They have no bytes. A sensor without packets yields one for each group of as many firing sequences.
    """

    def data(unit: Unit) -> Iterator[Packet]:
        """Yield the data packets of a unit."""
        sequence_ns = unit.head.beams.sequence_ns
        for rows in unit.timeline.sequences(start_ns, stop_ns):
            for first, last in zip(rows[:, 0].tolist(), rows[:, -1].tolist(), strict=True):
                due_ns, fired_ns = (scenario.start_ns + number * sequence_ns for number in (last + 1, first))
                yield Packet(PacketKind.DATA, due_ns, b"", unit.number, fired_ns)

    def position(unit: Unit) -> Iterator[Packet]:
        """Yield the position packets of a unit."""
        if isinstance(unit.section, Sensor):
            for numbers, due in positions_due(scenario, unit, start_ns, stop_ns):
                for number, due_ns in zip(numbers.tolist(), due.tolist(), strict=True):
                    yield Packet(PacketKind.POSITION, due_ns, b"", unit.number, number=number)

    streams = (stream(unit) for unit in units for stream in (data, position))
    return heapq.merge(*streams, key=lambda packet: packet.due_ns)


_EVENT_COLUMNS = ("t_utc_s", "until_utc_s", "event", "unit", "kind", "packets", "first", "last", "count")
_OF_UNITS = (
    "name",
    "model",
    "serial_number",
    "address",
    "data_port",
    "position_port",
)  # keys of a unit in `rig.json`
_OF_SENSORS = frozenset({PacketKind.DATA, PacketKind.POSITION})
"""Kinds of packets that pace the ground truth; other outputs change no line."""

_AT_ONCE_S = 0.05  # simulated time between two checks of the event that ends a run


class Truth:
    """Writer of the ground truth of a run, paced by its packets or by their due times; a context manager.

    Parameters
    ----------
    to : folder and options
    of : holder of the engine that makes the packets, with the events so far
    span_s : span of the run, since the first pulse

    Raises OutputError if the folder cannot be used, or contains a file that the scenario names; ScenarioError
    if poses of packets are requested for a sensor without packets; RunError if it cannot be written, here or
    later.
    """

    def __init__(self, to: TruthTo, of: HasEngine, span_s: tuple[float, float]) -> None:
        engine = of.engine
        scenario = engine.scenario
        parts = engine.parts
        self._of = of
        self._units = parts.units
        self._to = to
        self._scenario = scenario
        self._span_s = span_s
        wanted = self._units if to.per_packet else ()
        for unit in self._units if to.per_packet or to.per_return else ():
            require_packets(unit.section)
        self._step_ns = -(-S_NS // to.rate_hz)
        self._seen_ns = self._next_ns = begin_ns = scenario.start_ns + seconds_to_ns(span_s[0])
        self._is_whole = False
        self._listed_ns: int | None = None
        times = partial(timetable, scenario, self._units)
        span_ns = map(seconds_to_ns, span_s)
        self._to_come = self.beside(
            engine.packets(*span_s)
            if to.per_return
            else arriving_packets(scenario, self._units, times, *span_ns)
        )
        with ExitStack() as stack:
            self._folder = stack.enter_context(TruthFolder(to.folder, named_files(scenario)))
            write_json(self._folder.path / to.scenario.name, _scenario_tree(scenario, span_s))
            write_json(self._folder.path / "rig.json", rig_of(scenario, parts))
            # The first packet may begin before the requested span.
            earliest_s = earliest_ns(faults_of(scenario, self._units), seconds_to_ns(span_s[0])) / S_NS
            firsts_ns = (self._first_ns(unit, earliest_s, span_s[1]) for unit in self._units)
            from_ns = max(min(begin_ns, *firsts_ns) - self._step_ns, scenario.start_ns)
            self._trajectories = [self._trajectory(unit, from_ns) for unit in self._units]
            self._series = [*self._trajectories, *self._devices(engine, begin_ns, from_ns)]
            for unit in wanted:
                self._folder.begin_rows(_file("packets", unit), POSES)
            self._firsts_ns: dict[int, list[int]] = {unit.number: [] for unit in wanted}
            self._returns = dict[int, SlotTable]()
            for unit in self._units if to.per_return else ():
                table = SlotTable(self._folder.path / f"{_file('returns', unit)}.parquet")
                self._returns[unit.number] = stack.enter_context(table)
            self._open = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        failed = error
        try:
            with suppress(CancelledError):
                self._finish()
        except RunError as late:
            failed = error or late
        self._open.__exit__(
            type(failed) if failed else None, failed, None
        )  # this keeps the folder if nothing failed
        if failed is not error and failed is not None:
            raise failed

    def _trajectory(self, unit: Unit, from_ns: int) -> "Series":
        samples = pose_samples(unit.motion, self._scenario.start_ns, self._to.rate_hz)
        return Series(self._folder, _file("trajectory", unit), samples, from_ns)

    def _devices(self, engine: Engine, begin_ns: int, from_ns: int) -> Iterator["Series"]:
        if (readings := inertial_samples(engine)) is not None:
            yield Series(self._folder, "imu", readings, from_ns)
        if (named_ns := engine.parts.gps.second_ns(begin_ns)) is not None:
            yield Series(self._folder, "gnss", fix_samples(engine), named_ns)

    def _finish(self) -> None:
        """Write the samples up to the last packet, and the scene with the span of the run."""
        self._write()
        for series in self._trajectories:
            series.up_to(self._seen_ns + self._step_ns)
        begin_s, stop_s = self._span_s
        if not self._is_whole and self._seen_ns > self._scenario.start_ns + seconds_to_ns(begin_s):
            stop_s = (self._seen_ns + 1 - self._scenario.start_ns) / S_NS
        if (ran := self._of.engine.scenario) is not self._scenario or stop_s != self._span_s[1]:
            write_json(self._folder.path / self._to.scenario.name, _scenario_tree(ran, (begin_s, stop_s)))

    def beside(self, packets: Iterable[Packet]) -> Iterator[Packet]:
        """Pass packets on, and write the ground truth up to a packet once a second.

        A packet counts as sent when the next one is requested: a run that stops at a packet has not sent it.
        """
        for packet in packets:
            yield packet
            if packet.kind not in _OF_SENSORS:
                continue
            self._seen_ns = packet.due_ns
            if self._firsts_ns and packet.fired_ns is not None:
                self._firsts_ns[packet.unit].append(packet.fired_ns)
            if packet.slots is not None and self._returns:
                self._returns[packet.unit].add(packet)
            if packet.due_ns >= self._next_ns:
                self._next_ns = packet.due_ns + S_NS
                self._write()
        self._is_whole = True

    def up_to(self, since_s: float) -> None:
        """Write the ground truth up to a time since the first pulse, without packets of a run."""
        until_ns = self._scenario.start_ns + seconds_to_ns(since_s)
        next((packet for packet in self._to_come if packet.due_ns >= until_ns), None)

    def _first_ns(self, unit: Unit, start_s: float, stop_s: float) -> int:
        rows = unit.timeline.sequences(seconds_to_ns(start_s), seconds_to_ns(stop_s))
        first = next((int(some[0, 0]) * unit.head.beams.sequence_ns for some in rows), None)
        return self._scenario.start_ns + (seconds_to_ns(stop_s) if first is None else first)

    def _write(self) -> None:
        for series in self._series:
            series.up_to(self._seen_ns)
        self._write_events()
        for number, firsts_ns in self._firsts_ns.items():
            if firsts_ns:
                unit = self._units[number]
                rows = pose_rows(unit.motion.kinematics_at(np.array(firsts_ns)))
                self._folder.append_rows(_file("packets", unit), POSES, rows)
                firsts_ns.clear()

    def _write_events(self) -> None:
        ran = self._of.engine.scenario
        stop_ns = seconds_to_ns(self._span_s[1])
        until_ns = stop_ns if self._is_whole else self._seen_ns + 1 - ran.start_ns
        from_ns = self._listed_ns
        if not ran.events or (from_ns is not None and until_ns <= from_ns):
            return
        if from_ns is None:
            self._folder.append("events.csv", f"{','.join(_EVENT_COLUMNS)}\n")
        found = happenings(ran, self._of.engine.parts.units, from_ns, until_ns, stop_ns)
        begin_ns = ran.start_ns + seconds_to_ns(self._span_s[0])
        self._listed_ns = until_ns
        self._folder.append("events.csv", "".join(one.row for one in found if one.end_ns >= begin_ns))


class Series:
    """Samples in a folder of ground truth that are written at their time, from `from_ns` on."""

    def __init__(self, folder: TruthFolder, name: str, samples: Samples, from_ns: int) -> None:
        self._folder = folder
        self._name = name
        self._samples = samples
        self._next_ns = from_ns
        folder.begin_rows(name, samples.table)

    def up_to(self, t_ns: int) -> None:
        """Write all samples up to and including an instant that are not written yet."""
        rows = self._samples.between(self._next_ns, t_ns + 1)
        if len(rows):
            self._folder.append_rows(self._name, self._samples.table, rows)
            self._next_ns = t_ns + 1


def _file(name: str, unit: Unit) -> str:
    """Return the name of a file of a unit, without suffix."""
    return f"{name}_{unit.number + 1}" if unit.number else name


def _scenario_tree(scenario: Scenario, span_s: tuple[float, float]) -> Tree:
    tree = scenario.model_dump(mode="json", by_alias=True, exclude_none=True) | {"duration_s": span_s[1]}
    start = f", --start {span_s[0]!r}" if span_s[0] else ""
    return {"written_by": f"vlp16emu {version('vlp16emu')}{start}"} | tree


def rig_of(scenario: Scenario, parts: Parts) -> Tree:
    """Return `rig.json`: the frames of the trajectory and the extrinsics of the devices."""
    gps = scenario.gps
    imu = scenario.imu
    camera = scenario.camera
    devices = Tree()
    if imu:
        devices["imu"] = _extrinsics("body_T_imu", parts.imu_mount, imu.mount)
    if camera:
        from vlp16emu.extras.camera.mount import AXES, camera_mount, optical  # here: few scenes have a camera

        true = camera_mount(scenario)
        devices["camera"] = {"axes": AXES} | _extrinsics("body_T_camera", true, camera.mount, optical)
    place = {key: getattr(gps, key) for key in ("latitude_deg", "longitude_deg", "height_m")}
    return {
        "world": {"axes": "x east, y north, z up"} | place,
        "sensor": {
            "axes": "x forward at azimuth 0, y left, z up; the frame of the trajectory and of decoded points"
        },
        "units": [
            {
                "unit": unit.number + 1,
                **{key: getattr(unit.section, key) for key in _OF_UNITS if hasattr(unit.section, key)},
                "trajectory": f"{_file('trajectory', unit)}{POSES.suffix}",
                **_extrinsics("body_T_sensor", unit.mount, given),
            }
            for unit, given in zip(parts.units, mounts_of(scenario), strict=True)
        ],
        "manual": {
            "axes": "azimuth 0 on +y, clockwise seen from above (63-9243 Rev D, section 9.1)",
            "sensor_T_manual": transform(SENSOR_R_MANUAL, np.zeros(3)),
        },
        "antenna": {"above_sensor_m": gps.antenna_above_m, "towards": "world up"},
    } | devices


def _extrinsics(key: str, true: Mount, given: Mount, axes: Callable[[F8], F8] = lambda R: R) -> Tree:
    """Return the extrinsics of a device, whose own axes `axes` makes of those of its mount."""
    return {key: _mount(true, axes)} | ({f"given_{key}": _mount(given, axes)} if given.has_errors else {})


def given_mount(device: Tree, key: str, *, true: bool = False) -> F8 | None:
    """Return the extrinsics (4, 4) of a device of `rig.json`; None if it spins.

    They are as its user knows them, or with `true` the true ones.
    """
    given = f"given_{key}"
    mount = device[key if true or given not in device else given]
    return None if "spin_hz" in mount else np.array(mount["matrix"])


def _mount(section: Mount, axes: Callable[[F8], F8]) -> Tree:
    R = axes(rotation(section.yaw_deg, section.pitch_deg, section.roll_deg))
    spin = {"spin_hz": section.spin_hz, "spin_axis": section.spin_axis} if section.spin_hz else {}
    return transform(R, np.array(section.lever_arm_m)) | spin


def transform(R: F8, p_m: F8) -> Tree:
    """Return a rigid transform as matrix and as translation and quaternion, for JSON."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = p_m
    quaternion = quaternions(R) + 0.0  # no -0.0
    return {"matrix": T.tolist(), "translation_m": p_m.tolist(), "quaternion_xyzw": quaternion.tolist()}


def write_truth(
    emulator: Emulator,
    to: TruthPlace,
    *,
    start_s: float = 0.0,
    duration_s: float | None = None,
    progress: Callable[[float], None] = lambda _: None,
    stop: threading.Event | None = None,
) -> float:
    """Write the ground truth that `record` writes beside a run, byte for byte, without casting a pulse.

    Parameters
    ----------
    to : folder
    start_s, duration_s : as in `Emulator.record`
    progress : called with the simulated seconds so far
    stop : ends the run from another thread

    Returns
    -------
    Simulated seconds

    Raises OutputError if the folder cannot be written, or contains an input of the scene; ScenarioError if
    poses of packets are requested for a sensor without packets; TrajectoryError if the walk ends before the
    span; RunError if the disk is full: then the lines before are kept; CancelledError, and an earlier folder
    stays, if `stop` is set at once.
    """
    stop = stop or threading.Event()
    emulator = emulator.with_truth_in(TruthTo.of(to)).stopped_by(stop)
    begin_s, stop_s = span_s = emulator.scenario.span_s(start_s, duration_s)
    emulator.engine.span_ns(*span_s)  # checks the span before the folder is touched
    done_s = 0.0
    with emulator.truth(to, span_s) as truth:
        with suppress(CancelledError):
            while truth and done_s < stop_s - begin_s and not stop.is_set():
                truth.up_to(begin_s + min(done_s + _AT_ONCE_S, stop_s - begin_s))
                done_s = min(done_s + _AT_ONCE_S, stop_s - begin_s)
                progress(done_s)
        if stop.is_set() and not done_s:
            raise CancelledError  # earlier files stay
    return done_s
