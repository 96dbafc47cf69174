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
# sweeps of a capture in memory, some 300 MB; an earlier one is read again from the beginning of the file
_KEPT = 300
_MARKED = 10_000  # greatest number of findings of a rule that are shown; all are counted
_ABOUT_POINTS = (
    *(
        Rule.FLAG,
        Rule.FACTORY,
        Rule.AZIMUTH_RANGE,
        Rule.LOST_PACKETS,
        Rule.TIME_RANGE,
        Rule.TIME_STEP,
        Rule.DUPLICATE,
    ),
    *(
        Rule.FROZEN,
        Rule.AZIMUTH_STEP,
        Rule.AZIMUTH_GAP,
        Rule.DISTANCE_CODE,
        Rule.DUAL_AZIMUTH,
        Rule.DUAL_ORDER,
    ),
)  # rules whose findings are shown with a sweep; other faults, such as late packets, leave points correct


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
    """Yield the revolutions of a scene's sensor with labels, until its windows are stopped."""
    with suppress(CancelledError):
        for scan in emulator.scans(start_s=start_s, duration_s=duration_s, unit=unit, truth=True):
            yield Sweep(scan, to_world(scan.xyz_m, emulator.world_T_sensor(scan.t_ns, unit=unit)))


def by_trajectory(scan: Scan, way: Trajectory | None) -> Sweep:
    """Transform a scan to the world by a trajectory that covers it.

    Without one its points stay in the sensor's frame.
    """
    if way is None:
        return Sweep(scan, scan.xyz_m.astype(np.float64))
    world_T_sensor = np.tile(np.eye(4), (len(scan.t_ns) + 1, 1, 1))
    world_T_sensor[:, :3, :3], world_T_sensor[:, :3, 3] = way.poses_at(np.append(scan.t_ns, scan.start_ns))
    pose = world_T_sensor[-1]
    poses = world_T_sensor[:-1]
    return Sweep(replace(scan, world_T_sensor=pose), to_world(scan.xyz_m, poses))


class SceneSweeps:
    """Sweeps of a scene's sensor, with labels; InputError if there is no such unit.

    `last_s` is the time from the start of the first sweep to the start of the last one, `step_s` the nominal
    time between sweeps, both in seconds.
    """

    def __init__(self, emulator: Emulator, unit: int = 1) -> None:
        self._emulator = emulator
        self._unit = unit
        self.step_s = 60.0 / emulator.parts.units[emulator.number(unit)].section.rpm
        end_s = min(emulator.scenario.duration_s, emulator.parts.motion.run_time_s)
        self._span_s = min(_TURNS * self.step_s, end_s)
        self.last_s = end_s - self._span_s

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

    InputError if there is no such unit or no whole revolution.

    Parameters
    ----------
    path : capture; faulty packets are skipped
    truth : folder written by `record --truth --truth-returns`
    unit : number of the sensor, from 1
    """

    def __init__(self, path: Path, truth: Path | None = None, unit: int = 1) -> None:
        self._path = path
        self._folder = truth
        self._number = unit
        self._way = None if truth is None else Trajectory(truth, unit)
        self._unit = chosen_unit(path, (self._way and self._way.sensor) or str(unit), where="--unit")
        found = verify_units(path, [self._unit], limit_per_rule=_MARKED)[0]
        self.health = [f"{rule}: {count}" for rule, count in found.counts.items()]
        """Broken rules of `vlp16emu verify` with their counts, and the reason if the file cannot be read to
        its end."""
        self.species = {} if truth is None else species_of(load(truth / "scenario.json"))
        """Names of species by number."""
        packets = list[I8]()
        self._starts_ns = list[int]()

        def note(table: PacketTable, _: Points) -> Mapping[str, AnyArray]:
            """Keep frame and time of the packets; return no labels."""
            packets.append(np.stack([table["number"], table["utc_ns"]]))
            return {}

        try:
            self._starts_ns.extend(scan.start_ns for scan in self._scans(note))
        except CaptureError as error:
            self.health.append(str(error))
        if not self._starts_ns:
            raise InputError(str(path), "no whole revolution", "a capture of at least two")
        faults = [one for one in found.findings if one.rule in _ABOUT_POINTS]
        frame, t_ns = np.concatenate(packets, axis=1)
        after = np.minimum(np.searchsorted(frame, [one.packet for one in faults]), len(t_ns) - 1)
        self._faults = defaultdict[int, list[str]](list)  # by sweep
        for sweep, fault in zip(
            np.searchsorted(self._starts_ns, t_ns[after], side="right"), faults, strict=True
        ):
            self._faults[int(sweep) - 1].append(str(fault))
        self.last_s = (self._starts_ns[-1] - self._starts_ns[0]) / 1e9
        self.step_s = self.last_s / max(len(self._starts_ns) - 1, 1) or 0.1
        self._reading: Generator[Scan] | None = None
        self._next = len(self._starts_ns)
        self._held = dict[int, Scan]()

    def at(self, time_s: float) -> Sweep:
        """Return the first sweep that begins after a time."""
        wanted = int(np.searchsorted(self._starts_ns, self._starts_ns[0] + int(time_s * 1e9)))
        wanted = min(wanted, len(self._starts_ns) - 1)
        if wanted not in self._held and (self._reading is None or wanted < self._next):
            self.close()
            truth = None if self._folder is None else CaptureTruth(self._folder, self._number, None)
            self._reading = self._scans(partial(_labels, truth))
            self._next = 0
        while self._reading is not None and wanted not in self._held:
            self._held[self._next] = next(self._reading)
            self._next += 1
            if len(self._held) > _KEPT:
                del self._held[min(self._held)]
        return by_trajectory(self._held[wanted], self._way)._replace(faults=tuple(self._faults[wanted]))

    def close(self) -> None:
        """Close the capture."""
        if self._reading is not None:
            self._reading.close()
            self._reading = None

    def _scans(self, labels_of: Callable[[PacketTable, Points], Mapping[str, AnyArray]]) -> Generator[Scan]:
        clock = packet_clock(self._path, self._unit)
        reader = CaptureReader(self._path, self._unit, clock=clock, passes_over=True)
        decoded = ((table, points_in(table)) for table in reader.tables())
        for scan in cut_scans(chunk_of(*each, labels_of(*each)) for each in decoded):
            if self._way is None or self._way.has(scan.t_ns).all():
                yield scan


def _labels(truth: CaptureTruth | None, table: PacketTable, points: Points) -> Mapping[str, AnyArray]:
    """Return the labels (n,) of the points of packets by field of `Labels`; none without ground truth."""
    if truth is None:
        return {}
    rows = truth.of(table, points, np.arange(len(points.ring)))
    return {field.name: rows.get(field.name, np.zeros(0, np.uint8)) for field in fields(Labels)}
