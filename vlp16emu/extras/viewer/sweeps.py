"""Sweeps by time: from a scene, computed on demand, or from a capture, with the faults of its packets."""

from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures import CaptureReader, chosen_unit, packet_clock
from vlp16emu.errors import CaptureError, InputError
from vlp16emu.extras.clouds.deskew import CaptureTruth, Trajectory
from vlp16emu.extras.clouds.scan import chunk_of, cut_scans
from vlp16emu.extras.verify.frames import Rule
from vlp16emu.extras.verify.run import verify_units
from vlp16emu.forest.plants.species import flora
from vlp16emu.packets import PacketTable, Points, points_in
from vlp16emu.run.emulator import Emulator
from vlp16emu.scenario import Scenario, load
from vlp16emu.types import F8, I8, AnyArray, Labels, Scan

_TURNS = 2.2  # span in revolutions: it always contains a whole one, also with an error of the motor's speed
_MOST_SCANS = 300
"""Scans of a capture in memory, some 300 MB; an earlier one is read again from the beginning of the file."""
_MOST_FINDINGS = 10_000  # greatest number of findings of a rule that are shown; all are counted
_POINT_RULES = (
    Rule.FLAG,
    Rule.FACTORY,
    Rule.AZIMUTH_RANGE,
    Rule.LOST_PACKETS,
    Rule.TIME_RANGE,
    Rule.TIME_STEP,
    Rule.DUPLICATE,
    Rule.FROZEN,
    Rule.AZIMUTH_STEP,
    Rule.AZIMUTH_GAP,
    Rule.DISTANCE_CODE,
    Rule.DUAL_AZIMUTH,
    Rule.DUAL_ORDER,
)
"""Rules whose findings are shown with a sweep; other faults, such as late packets, leave points correct."""


class Sweep(NamedTuple):
    """A revolution of the sensor."""

    scan: Scan
    world_m: F8  # (n, 3) points in the world
    faults: tuple[str, ...] = ()  # lines about its broken packets


def species_of(scenario: Scenario) -> dict[int, str]:
    """Return the names of species by their number in a scene's labels."""
    return dict(flora(getattr(scenario.world, "species_file", None)).names)


def to_world(xyz_m: NDArray[np.floating], world_T_sensor: F8) -> F8:
    """Return points (n, 3) in the world, each transformed by its own pose (n, 4, 4)."""
    world_m: F8 = np.einsum("nij,nj->ni", world_T_sensor[:, :3, :3], xyz_m)
    return world_m + world_T_sensor[:, :3, 3]


def sweeps_of_scene(
    emulator: Emulator, start_s: float, duration_s: float | None, unit: int = 1
) -> Iterator[Sweep]:
    """Yield the revolutions of a scene's sensor with labels, until its emulator is stopped."""
    with suppress(CancelledError):
        for scan in emulator.scans(start_s=start_s, duration_s=duration_s, unit=unit, truth=True):
            yield Sweep(scan, to_world(scan.xyz_m, emulator.world_T_sensor(scan.t_ns, unit=unit)))


def place_scan(scan: Scan, trajectory: Trajectory | None) -> Sweep:
    """Return a scan as a sweep in the world, by a trajectory that covers it.

    Without a trajectory the points stay in the sensor's frame.
    """
    if trajectory is None:
        return Sweep(scan, scan.xyz_m.astype(np.float64))
    world_T_sensor = np.tile(np.eye(4), (len(scan.t_ns) + 1, 1, 1))
    world_R_sensor, world_p_sensor_m = trajectory.poses_at(np.append(scan.t_ns, scan.start_ns))
    world_T_sensor[:, :3, :3] = world_R_sensor
    world_T_sensor[:, :3, 3] = world_p_sensor_m
    pose = world_T_sensor[-1]
    poses = world_T_sensor[:-1]
    return Sweep(replace(scan, world_T_sensor=pose), to_world(scan.xyz_m, poses))


class SceneSweeps:
    """Sweeps of a scene's sensor, with labels; InputError if there is no such unit."""

    def __init__(self, emulator: Emulator, unit: int = 1) -> None:
        self._emulator = emulator
        self._unit = unit
        self.step_s = 60.0 / emulator.parts.units[emulator.number(unit)].section.rpm
        """Nominal time between sweeps."""
        end_s = min(emulator.scenario.duration_s, emulator.parts.motion.run_time_s)
        self._span_s = min(_TURNS * self.step_s, end_s)
        self.last_s = end_s - self._span_s
        """Time from the start of the first sweep to that of the last one."""

    def at(self, time_s: float) -> Sweep:
        """Return the first sweep that begins after a time.

        Raises InputError if the run is shorter than a revolution.
        """
        begin_s = float(np.clip(time_s, 0.0, self.last_s))
        sweep = next(sweeps_of_scene(self._emulator, begin_s, self._span_s, self._unit), None)
        if sweep is None:
            raise InputError("duration_s", f"found {self._span_s:g} s", "a whole revolution of the sensor")
        return sweep


class CaptureSweeps:
    """Sweeps of a capture, in the sensor's frame or, with the ground truth of the run, in the world.

    Parameters
    ----------
    path : capture; faulty packets are skipped
    truth : folder written by `record --truth --truth-returns`
    unit : number of the sensor, from 1

    Raises InputError if there is no such unit or no whole revolution.
    """

    def __init__(self, path: Path, truth: Path | None = None, unit: int = 1) -> None:
        self._path = path
        self._folder = truth
        self._unit_number = unit
        self._trajectory = None if truth is None else Trajectory(truth, unit)
        self._unit = chosen_unit(
            path, (self._trajectory and self._trajectory.sensor) or str(unit), where="--unit"
        )
        verification = verify_units(path, [self._unit], limit_per_rule=_MOST_FINDINGS)[0]
        self.health = [f"{rule}: {count}" for rule, count in verification.counts.items()]
        """Broken rules of `vlp16emu verify` with their counts, and the reason if the file cannot be read to
        its end."""
        self.species = {} if truth is None else species_of(load(truth / "scenario.json"))
        """Names of species by number."""
        packets = list[I8]()
        self._starts_ns = list[int]()

        def keep_packets(table: PacketTable, _: Points) -> Mapping[str, AnyArray]:
            """Keep frame and time of the packets; return no labels."""
            packets.append(np.stack([table["number"], table["utc_ns"]]))
            return {}

        try:
            self._starts_ns.extend(scan.start_ns for scan in self._scans(keep_packets))
        except CaptureError as error:
            self.health.append(str(error))
        if not self._starts_ns:
            raise InputError(str(path), "no whole revolution", "a capture of at least two")
        faults = [finding for finding in verification.findings if finding.rule in _POINT_RULES]
        frame, t_ns = np.concatenate(packets, axis=1)
        after = np.minimum(np.searchsorted(frame, [finding.packet for finding in faults]), len(t_ns) - 1)
        self._faults = defaultdict[int, list[str]](list)  # by sweep
        sweeps = np.searchsorted(self._starts_ns, t_ns[after], side="right") - 1
        for sweep, fault in zip(sweeps.tolist(), faults, strict=True):
            self._faults[sweep].append(str(fault))
        self.last_s = (self._starts_ns[-1] - self._starts_ns[0]) / 1e9
        self.step_s = self.last_s / max(len(self._starts_ns) - 1, 1) or 0.1
        self._reading: Generator[Scan] | None = None
        self._next = len(self._starts_ns)
        self._scans_read = dict[int, Scan]()

    def at(self, time_s: float) -> Sweep:
        """Return the first sweep that begins after a time."""
        number = int(np.searchsorted(self._starts_ns, self._starts_ns[0] + int(time_s * 1e9)))
        number = min(number, len(self._starts_ns) - 1)
        if number not in self._scans_read and (self._reading is None or number < self._next):
            self.close()
            truth = None if self._folder is None else CaptureTruth(self._folder, self._unit_number, None)
            self._reading = self._scans(partial(_labels, truth))
            self._next = 0
        while self._reading is not None and number not in self._scans_read:
            self._scans_read[self._next] = next(self._reading)
            self._next += 1
            if len(self._scans_read) > _MOST_SCANS:
                del self._scans_read[min(self._scans_read)]
        sweep = place_scan(self._scans_read[number], self._trajectory)
        return sweep._replace(faults=tuple(self._faults[number]))

    def close(self) -> None:
        """Close the capture."""
        if self._reading is not None:
            self._reading.close()
            self._reading = None

    def _scans(self, labels_of: Callable[[PacketTable, Points], Mapping[str, AnyArray]]) -> Generator[Scan]:
        clock = packet_clock(self._path, self._unit)
        reader = CaptureReader(self._path, self._unit, clock=clock, passes_over=True)
        decoded = ((table, points_in(table)) for table in reader.tables())
        for scan in cut_scans(chunk_of(*packets, labels_of(*packets)) for packets in decoded):
            if self._trajectory is None or self._trajectory.has(scan.t_ns).all():
                yield scan


def _labels(truth: CaptureTruth | None, table: PacketTable, points: Points) -> Mapping[str, AnyArray]:
    """Return the labels (n,) of the points of packets by field of `Labels`; none without ground truth."""
    if truth is None:
        return {}
    rows = truth.values_of(table, points, np.arange(len(points.ring)))
    return {field.name: rows.get(field.name, np.zeros(0, np.uint8)) for field in fields(Labels)}
