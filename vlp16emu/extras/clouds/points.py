"""Returns as points with all their ground truth, directly from the engine, not through packets."""

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from vlp16emu.engine import Engine
from vlp16emu.extras.clouds import cloud
from vlp16emu.extras.clouds.scan import points_of
from vlp16emu.extras.options import PointOptions
from vlp16emu.extras.truth.slots import LEAF_OR_WOOD
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.report import Turn, turn_of
from vlp16emu.scenario import Scenario
from vlp16emu.types import I8, Returns
from vlp16emu.units import S_NS, seconds_to_ns


@dataclass(frozen=True, slots=True)
class PointCloud:
    """Contents of a file of points, and the time that it took."""

    file: str
    scene: str  # name, path or title
    seed: int
    unit: int  # number of the sensor in a rig, from 1
    sensor: str  # model
    beams: int
    elevation_deg: tuple[float, float]  # elevation of the lowest and the highest beam
    pulses_per_s: float
    turn: Turn
    points: int
    returns: Mapping[str, int]  # points by `cloud.RETURN_NAMES`
    truth: bool  # True if points have labels
    bytes: int
    simulated_s: float
    wall_s: float  # time of the run by the host's clock
    real_time_factor: float  # simulated seconds per second
    interrupted: bool  # True if the stop event ended it


def write_points(
    emulator: Emulator,
    path: str | Path,
    *,
    progress: Callable[[float], None] = lambda _: None,
    stop: Event | None = None,
    **options: Any,
) -> PointCloud:
    """Write points in the world and in the sensor's frame, for a sensor of any beam table.

    Parameters
    ----------
    path : .npz, .ply, .csv, .pcd, .las or .laz by its suffix; overwritten if it exists
    progress : called with the simulated seconds so far, block by block
    stop : ends the file from another thread; it is valid, and there is none before the first block
    options : fields of `PointOptions`

    Raises InputError if there is no such unit or scheme, or the suffix names no format; MissingExtraError if
    the library for a format is not installed; OutputError if file or folder cannot be written, or are an
    input of the scene; TrajectoryError if the walk ends before the span; RunError if the disk is full: the
    file is then incomplete; CancelledError, and earlier files stay, if `stop` is set before the first block.
    """
    path = Path(path)
    began_s = time.perf_counter()
    point_options = PointOptions.from_fields(options)
    number = emulator.number(point_options.unit)
    stop = stop or Event()
    emulator = emulator.stopped_by(stop)
    scenario = emulator.scenario
    scheme = cloud.label_scheme(point_options.labels) if point_options.labels else None
    truth = point_options.truth or bool(point_options.labels)
    span_s = scenario.span_s(point_options.start_s, point_options.duration_s)
    begin_s, _ = span_s
    blocks = _blocks(emulator.engine, number, span_s, truth=truth, labels=scheme)  # checks the span first
    columns = cloud.SCENE_COLUMNS + cloud.TRUTH_COLUMNS * truth + cloud.LABEL_COLUMNS * bool(scheme)
    returns = np.zeros(3, np.int64)
    simulated_s = 0.0
    file = cloud.point_file(
        path, columns, _metadata(scenario, number, scheme), where=str(path), inputs=emulator.files
    )
    with file as writer, emulator.truth(point_options.truth_to, span_s) as folder:
        with suppress(CancelledError):
            for block, end_ns in blocks:
                writer.write(block)
                returns += np.bincount(block["return_number"], minlength=3)
                simulated_s = end_ns / S_NS - begin_s
                if folder:
                    folder.up_to(begin_s + simulated_s)
                progress(simulated_s)
                if stop.is_set():
                    break
        if stop.is_set() and not simulated_s:
            raise CancelledError  # earlier files stay
    return _summary(
        emulator,
        point_options.unit,
        path,
        returns,
        (begin_s, simulated_s),
        has_truth=truth,
        wall_s=time.perf_counter() - began_s,
        is_interrupted=stop.is_set(),
    )


def _summary(
    emulator: Emulator,
    unit: int,
    path: Path,
    returns: I8,
    span_s: tuple[float, float],
    *,
    has_truth: bool,
    wall_s: float,
    is_interrupted: bool,
) -> PointCloud:
    """Return the contents of a written file.

    Parameters
    ----------
    returns : points by return number (3,), in the order of `cloud.RETURN_NAMES`
    span_s : begin of the run, and simulated seconds since
    """
    sensor = emulator.parts.units[emulator.number(unit)]
    beams = sensor.head.beams
    begin_s, simulated_s = span_s
    return PointCloud(
        file=str(path),
        scene=emulator.name,
        seed=emulator.scenario.seed,
        unit=unit,
        sensor=sensor.section.model,
        beams=len(beams.elevation_deg),
        elevation_deg=(float(beams.elevation_deg.min()), float(beams.elevation_deg.max())),
        pulses_per_s=S_NS / beams.sequence_ns * len(beams.elevation_deg),
        turn=turn_of(sensor.head, begin_s, begin_s + simulated_s),
        points=int(returns.sum()),
        returns=dict(zip(cloud.RETURN_NAMES, returns.tolist(), strict=True)),
        truth=has_truth,
        bytes=path.stat().st_size,
        simulated_s=simulated_s,
        wall_s=wall_s,
        real_time_factor=simulated_s / wall_s,
        interrupted=is_interrupted,
    )


def _metadata(scenario: Scenario, number: int, scheme: cloud.LabelScheme | None) -> cloud.CloudMetadata:
    comments = cloud.scene_comments()
    if scheme:
        comments = (*comments, f"label: {scheme.name}, {scheme.source}")
    gps = scenario.gps
    origin = gps.latitude_deg, gps.longitude_deg, gps.height_m
    return cloud.CloudMetadata(comments, scenario.start_utc, origin, number + 1)


def _blocks(
    engine: Engine, number: int, span_s: tuple[float, float], *, truth: bool, labels: cloud.LabelScheme | None
) -> Iterator[tuple[cloud.Block, int]]:
    """Return the points of each block of a span, and their end time in ns since the first pulse.

    Raises TrajectoryError at once if the walk ends before the span.
    """
    start_ns = engine.scenario.start_ns
    unit = engine.parts.units[number]
    begin_ns, end_ns = (start_ns + seconds_to_ns(since_s) for since_s in span_s)
    scenario = engine.scenario
    point_labels = None
    if labels:
        point_labels = cloud.PointLabels(labels, scenario.world.site(scenario.world_seed).height_m)

    def points_in(block: Returns) -> tuple[cloud.Block, int]:
        """Return the points of a block within the span, and their number."""
        t_ns = block.firings.t_ns
        inside = (t_ns >= begin_ns) & (t_ns < end_ns)
        if block.is_sent is not None:
            inside &= block.is_sent[:, None]
        points, _ = points_of(unit, block, inside, truth=truth)
        points["since_start_ns"] = points["t_ns"] - start_ns
        if truth:
            points["leaf_wood"] = LEAF_OR_WOOD[points["part"]]
        if point_labels:
            points |= point_labels.labels_of(points)
        return points, min(int(t_ns[-1, 0]) + unit.head.beams.sequence_ns, end_ns) - start_ns

    return map(points_in, engine.returns(*span_s, number, truth=truth))
