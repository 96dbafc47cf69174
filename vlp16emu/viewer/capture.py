"""Sweeps of a capture, ours or a real sensor's: with what is wrong with its packets, and with the truth of its run if there is one."""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.deskew import CaptureTruth, Trajectory, TrajectoryErrors
from vlp16emu.errors import CaptureError, InputError
from vlp16emu.packets import CaptureReader, PacketChunk, chosen_unit
from vlp16emu.scan import Labels, LabelsOf, Scan, clock_zero_ns, scans_in
from vlp16emu.scenario import load
from vlp16emu.sensor.beams import BEAM_TABLES, BeamTable
from vlp16emu.validator import Finding, Rule, verify_capture
from vlp16emu.viewer.sweeps import Mark, Sweep
from vlp16emu.world.plants.flora import flora

_KEPT = 300
"""Sweeps of a capture that are kept, some 300 MB; one before them is read from the file's begin again."""
_MARKED = 10_000
"""Findings of each rule that are marked; all are counted."""
_PASSED_OVER = Rule.FLAG, Rule.FACTORY, Rule.AZIMUTH_RANGE
"""For these a packet is not read."""
_ABOUT_POINTS = (
    *_PASSED_OVER,
    *(Rule.LOST_PACKETS, Rule.TIME_RANGE, Rule.TIME_STEP, Rule.DUPLICATE, Rule.FROZEN, Rule.AZIMUTH_STEP),
    *(Rule.AZIMUTH_GAP, Rule.DISTANCE_CODE, Rule.DUAL_AZIMUTH, Rule.DUAL_ORDER),
)
"""What is marked; of the others, such as late packets, points are right."""


class CaptureSweeps:
    """Sweeps of a capture one after another; all of one place, unless the truth of the run has the poses.

    Parameters
    ----------
    path : of the capture; packets at fault are passed over
    truth : folder that `record --truth --truth-returns` has written
    unit : of several, from 1

    Raises
    ------
    CaptureError, PacketError
        where the file holds no sensor's packets
    InputError, TrajectoryError, MissingExtraError
        where there is no whole revolution or no such unit, or the truth is none
    """

    def __init__(self, path: Path, truth: Path | None = None, unit: int = 1) -> None:
        self._path, self._folder, self._number = path, truth, unit
        self._way = None if truth is None else Trajectory(truth, unit, TrajectoryErrors())
        self._unit = chosen_unit(path, (self._way and self._way.sensor) or str(unit), where="--unit")
        found = verify_capture(path, self._unit, limit_per_rule=_MARKED)
        self.health = [f"{rule}: {count}" for rule, count in found.counts.items()]
        """Which rules of `vlp16emu verify` are broken, how often, and why the file cannot be read to its end."""
        self.species = {} if truth is None else _species(truth)
        """Names by number."""
        log, self._starts_ns = _PacketLog(), list[int]()
        reader = self._reader()
        try:
            self._starts_ns.extend(scan.start_ns for scan in self._scans(reader, log.of(reader)))
        except CaptureError as error:
            self.health.append(str(error))
        if not self._starts_ns:
            raise InputError(str(path), "no whole revolution", "a capture of at least two")
        self.beams: BeamTable = BEAM_TABLES[reader.summary.model]
        self._marks = log.marks(found.findings)
        self.last_s = (self._starts_ns[-1] - self._starts_ns[0]) / 1e9
        self.step_s = self.last_s / max(len(self._starts_ns) - 1, 1) or 0.1
        self._reading: Generator[Scan] | None = None
        self._next, self._held = len(self._starts_ns), dict[int, Scan]()

    def at(self, time_s: float) -> Sweep:
        """See `Sweeps`."""
        wanted = int(np.searchsorted(self._starts_ns, self._starts_ns[0] + int(time_s * 1e9)))
        wanted = min(wanted, len(self._starts_ns) - 1)
        if wanted not in self._held and (self._reading is None or wanted < self._next):
            self.close()
            truth = None if self._folder is None else CaptureTruth(self._folder, self._number, None)
            self._reading, self._next = self._scans(self._reader(), partial(_labels, truth)), 0
        while self._reading is not None and wanted not in self._held:
            self._held[self._next] = next(self._reading)
            self._next += 1
            if len(self._held) > _KEPT:
                del self._held[min(self._held)]
        return self._placed(self._held[wanted], wanted)

    def close(self) -> None:
        """Close the file."""
        if self._reading is not None:
            self._reading.close()
            self._reading = None

    def _reader(self) -> CaptureReader:
        return CaptureReader(self._path, self._unit, passes_over=True)

    def _scans(self, reader: CaptureReader, labels_of: LabelsOf) -> Generator[Scan]:
        for scan in scans_in(reader, labels_of):
            if self._way is None or self._way.has(scan.t_ns).all():
                yield scan

    def _placed(self, scan: Scan, wanted: int) -> Sweep:
        """Put a scan into the world, and mark what is wrong in it."""
        ends_ns = [*self._starts_ns[1:], np.iinfo(np.int64).max]
        marks = [mark for t_ns, mark in self._marks if scan.start_ns <= t_ns < ends_ns[wanted]]
        if self._way is None:
            return Sweep(scan, scan.xyz_m.astype(np.float64), tuple(marks))
        turn, place_m = self._way.poses_at(np.append(scan.t_ns, scan.start_ns))
        world_T_sensor = np.eye(4)
        world_T_sensor[:3, :3], world_T_sensor[:3, 3] = turn[-1], place_m[-1]
        world_m = np.einsum("nij,nj->ni", turn[:-1], scan.xyz_m) + place_m[:-1]
        return Sweep(replace(scan, world_T_sensor=world_T_sensor), world_m, tuple(marks))


def _species(folder: Path) -> dict[int, str]:
    world = load(folder / "scenario.json").world
    return dict(flora(getattr(world, "species_file", None)).names)


def _labels(truth: CaptureTruth | None, chunk: PacketChunk) -> Mapping[str, NDArray[Any]]:
    """Give the arrays of `Labels` of the points of packets."""
    if truth is None:
        return {}
    rows = truth.of(chunk, slice(0, len(chunk.fields)), np.arange(len(chunk.clock_ns)))
    return {field.name: rows.get(field.name, np.zeros(0, np.uint8)) for field in fields(Labels)}


class _PacketLog:
    """Frame, time and azimuths of the data packets of a capture, as they are read."""

    def __init__(self) -> None:
        self._parts = list[NDArray[np.int64]]()
        self._zero_ns = 0

    def of(self, reader: CaptureReader) -> LabelsOf:
        """Make what notes the packets that a reader reads."""

        def note(chunk: PacketChunk) -> Mapping[str, NDArray[Any]]:
            """Keep what marks need of the packets; labels of points are none."""
            if not self._parts:
                self._zero_ns = clock_zero_ns(reader, chunk)
            azimuth_cdeg = chunk.fields["blocks"]["azimuth_cdeg"][:, [0, -1]]
            self._parts.append(np.column_stack([chunk.number, chunk.packet_ns + self._zero_ns, azimuth_cdeg]))
            return {}

        return note

    def marks(self, findings: Sequence[Finding]) -> list[tuple[int, Mark]]:
        """Give the marks of findings with their times, UTC in ns."""
        frame, t_ns, first_cdeg, last_cdeg = np.concatenate(self._parts).T
        marks = list[tuple[int, Mark]]()
        for finding in findings:
            after = min(int(np.searchsorted(frame, finding.packet)), len(frame) - 1)
            is_read = frame[after] == finding.packet
            if finding.rule not in _ABOUT_POINTS or not (is_read or finding.rule in _PASSED_OVER):
                continue
            begin_deg, end_deg = first_cdeg[after] / 100, last_cdeg[after] / 100
            if finding.rule is Rule.LOST_PACKETS or not is_read:
                begin_deg, end_deg = last_cdeg[max(after - 1, 0)] / 100, begin_deg
            marks.append((int(t_ns[after]), Mark(begin_deg, end_deg, str(finding))))
        return marks
