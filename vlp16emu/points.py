"""Returns as points with all that is known of them, straight from the chain and not through packets."""

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.chain import Unit
from vlp16emu.chain.chain import Chain
from vlp16emu.labels import LabelScheme, PointLabels
from vlp16emu.packets import SEQUENCES_PER_BLOCK
from vlp16emu.scan import Chunk, Scan, cut_scans
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.head import Turn, turn_of
from vlp16emu.sensor.place import place
from vlp16emu.sinks.cloud import (
    LABEL_COLUMNS,
    LEAF_OR_WOOD,
    RETURN_NAMES,
    SCENE_COLUMNS,
    TRUTH_COLUMNS,
    Block,
    CloudAbout,
    point_file,
    scene_comments,
)
from vlp16emu.types import SURFACE, ReturnMode, Returns
from vlp16emu.units import S_NS, seconds_to_ns
from vlp16emu.world.make import ground_of

_LABELS = ("semantic", "part", "instance", "species")


@dataclass(frozen=True, slots=True)
class PointCloud:
    """What a file of points holds, and what it took."""

    file: str
    scene: str
    """Name, path or title."""
    seed: int
    unit: int
    """Which sensor of a rig, from 1."""
    sensor: str
    """Model."""
    beams: int
    elevation_deg: tuple[float, float]
    """Of the lowest and the highest beam."""
    pulses_per_s: float
    turn: Turn
    points: int
    returns: Mapping[str, int]
    """Points by `RETURN_NAMES`."""
    truth: bool
    """Whether points have labels."""
    bytes: int
    simulated_s: float
    wall_s: float
    real_time_factor: float
    """Simulated seconds per second."""
    interrupted: bool
    """Ended by its stop event."""


def write_cloud(
    chain: Chain,
    number: int,
    path: Path,
    span_s: tuple[float, float],
    *,
    truth: bool,
    labels: LabelScheme | None,
    scene: str,
    progress: AbstractContextManager[Callable[[float], None]],
    stop: Event,
) -> PointCloud:
    """Write the points of all pulses fired in a span into a file.

    Parameters
    ----------
    number : of the unit, from 0
    path : as `point_file` takes it
    truth : whether `TRUTH_COLUMNS` are written beside `SCENE_COLUMNS`
    labels : scheme by which `LABEL_COLUMNS` are written beside them, and the truth in any case
    scene : its name in the result
    progress : entered when the file is open; what it gives is called with the simulated seconds so far, block by block
    stop : ends the file between two blocks

    Raises
    ------
    TrajectoryError
        where the walk is over before the span
    InputError, OutputError, RunError
        as `point_file`
    """
    began_s, scenario, unit = time.perf_counter(), chain.scenario, chain.parts.units[number]
    truth = truth or labels is not None
    blocks = _blocks(
        chain, number, span_s, truth=truth, labels=labels
    )  # checks the span before the file is touched
    columns = SCENE_COLUMNS + TRUTH_COLUMNS * truth + LABEL_COLUMNS * (labels is not None)
    returns, simulated_s = np.zeros(3, np.int64), 0.0
    file = point_file(path, columns, _about(scenario, number, labels), where=str(path))
    with file as writer, progress as so_far, suppress(CancelledError):
        for block, end_ns in blocks:
            writer.write(block)
            returns += np.bincount(block["return_number"], minlength=3)
            simulated_s = end_ns / S_NS - span_s[0]
            so_far(simulated_s)
            if stop.is_set():
                break
    beams, wall_s = unit.head.beams, time.perf_counter() - began_s
    return PointCloud(
        file=str(path),
        scene=scene,
        seed=scenario.seed,
        unit=number + 1,
        sensor=unit.section.model,
        beams=len(beams.elevation_deg),
        elevation_deg=(float(beams.elevation_deg.min()), float(beams.elevation_deg.max())),
        pulses_per_s=S_NS / beams.sequence_ns * len(beams.elevation_deg),
        turn=turn_of(unit.head, simulated_s),
        points=int(returns.sum()),
        returns=dict(zip(RETURN_NAMES, returns.tolist(), strict=True)),
        truth=truth,
        bytes=path.stat().st_size,
        simulated_s=simulated_s,
        wall_s=wall_s,
        real_time_factor=simulated_s / wall_s,
        interrupted=stop.is_set(),
    )


def _about(scenario: Scenario, number: int, labels: LabelScheme | None) -> CloudAbout:
    """Say what a file holds."""
    comments = scene_comments(scenario.start_utc.isoformat())
    gps = scenario.gps
    return CloudAbout(
        comments=comments if labels is None else (*comments, f"label: {labels.name}, {labels.source}"),
        start_utc=scenario.start_utc,
        origin=(gps.latitude_deg, gps.longitude_deg, gps.height_m),
        unit=number + 1,
    )


def _blocks(
    chain: Chain, number: int, span_s: tuple[float, float], *, truth: bool, labels: LabelScheme | None
) -> Iterator[tuple[Block, int]]:
    """Points of each block of a span, and the time in ns since the first pulse until which they reach."""
    start_ns, unit = chain.scenario.start_ns, chain.parts.units[number]
    begin_ns, end_ns = (start_ns + seconds_to_ns(s) for s in span_s)
    scenario = chain.scenario
    labelled = labels and PointLabels(labels, ground_of(scenario.world, scenario.world_seed).height_m)

    def made(block: Returns) -> tuple[Block, int]:
        t_ns = block.firings.t_ns
        points, _ = _points(unit, block, (t_ns >= begin_ns) & (t_ns < end_ns), truth=truth)
        points["since_start_ns"] = points["t_ns"] - start_ns
        if labelled:
            points |= labelled.of(points)
        return points, min(int(t_ns[-1, 0]) + unit.head.beams.sequence_ns, end_ns) - start_ns

    return map(made, chain.returns(*span_s, number, truth=truth))


def scans_of(chain: Chain, number: int, span_s: tuple[float, float], *, truth: bool) -> Iterator[Scan]:
    """Whole revolutions of a unit, numbered from 0, within a span; with labels if the truth is wanted.

    Raises
    ------
    TrajectoryError
        where the walk is over before the span
    """
    start_ns, unit = chain.scenario.start_ns, chain.parts.units[number]
    begin_ns, end_ns = (start_ns + seconds_to_ns(s) for s in span_s)
    returns = chain.returns(*span_s, number, truth=truth)
    chunks = (_chunk(unit, block, begin_ns, end_ns, truth=truth) for block in returns)
    return cut_scans(chunks, lambda t_ns: world_T_sensor(unit, np.array([t_ns]))[0])


def world_T_sensor(unit: Unit, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n, 4, 4) from the sensor's frame to the world, at instants (n,) UTC."""
    poses = unit.motion.poses_at(t_ns)
    T = np.zeros((len(t_ns), 4, 4))
    T[:, :3, :3] = poses.world_R_body
    T[:, :3, 3], T[:, 3, 3] = poses.world_p_body_m, 1.0
    return T


def _chunk(unit: Unit, returns: Returns, begin_ns: int, end_ns: int, *, truth: bool) -> Chunk:
    """Points of the azimuth readings of a block that are taken in a span, each echo once, the last one first."""
    firings, step = returns.firings, SEQUENCES_PER_BLOCK
    reading_ns = firings.t_ns[::step, 0]
    taken = (reading_ns >= begin_ns) & (reading_ns < end_ns)
    inside = np.broadcast_to(np.repeat(taken, step)[:, None], firings.t_ns.shape)
    points, sequence = _points(unit, returns, inside, truth=truth)
    is_last = _is_last(points["return_number"], sequence, points["laser"], returns.distance_m, unit)
    order = np.lexsort((~is_last, points["laser"], sequence))
    arrays = {
        "t_ns": points["t_ns"],
        "xyz_m": points["sensor_m"].astype(np.float32),
        "distance_m": points["distance_m"],
        "azimuth_deg": points["azimuth_deg"],
        "ring": points["ring"],
        "reflectivity": points["reflectivity"],
        "is_last": is_last,
    } | ({name: points[name] for name in (*_LABELS, "range_m")} if truth else {})
    return Chunk(
        t_ns=reading_ns[taken],
        azimuth_deg=firings.reading_deg[::step][taken],
        reading=(np.cumsum(taken) - 1)[sequence[order] // step],
        arrays={name: array[order] for name, array in arrays.items()},
    )


def _is_last(
    number: NDArray[np.int64],
    sequence: NDArray[np.int64],
    laser: NDArray[np.int64],
    distance_m: NDArray[np.float32],
    unit: Unit,
) -> NDArray[np.bool_]:
    """(n,) whether points are last returns; of the strongest, in dual return, those that are both."""
    mode = ReturnMode(unit.section.return_mode)
    strongest, last = distance_m[sequence, laser, 0], distance_m[sequence, laser, 1]
    is_both = (number == 0) & (strongest == last) & (mode is ReturnMode.DUAL)
    return np.asarray((number == 1) | is_both)


def _points(
    unit: Unit, returns: Returns, inside: NDArray[np.bool_], *, truth: bool
) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Make points of the returns of pulses (k, L) that are `inside`; beside them the row (n,) of their sequence."""
    firings, beams, t_ns = returns.firings, unit.head.beams, returns.firings.t_ns
    sent = _sent(returns.distance_m, ReturnMode(unit.section.return_mode)) & inside[..., None]
    sequence, laser, number = np.nonzero(sent)
    distance_m, pulse_ns = returns.distance_m[sent], t_ns[sequence, laser]
    poses = unit.motion.poses_at(pulse_ns)
    placed = place(beams, firings, sequence, laser, distance_m, poses)
    points: dict[str, NDArray[Any]] = {
        "t_ns": pulse_ns,
        "world_m": placed.world_m,
        "sensor_m": placed.sensor_m,
        "distance_m": distance_m,
        "azimuth_deg": placed.azimuth_deg,
        "elevation_deg": placed.elevation_deg,
        "reflectivity": returns.reflectivity[sent],
        "ring": beams.ring[laser],
        "laser": laser,
        "return_number": number,
        "viewpoint_m": np.broadcast_to(poses.world_p_body_m, placed.world_m.shape),
    }
    return points | (_labels(returns, sent) if truth else {}), sequence


def _sent(distance_m: NDArray[np.float32], mode: ReturnMode) -> NDArray[np.bool_]:
    """(k, L, 3) which returns the sensor would report: each echo once, a lone one as the strongest.

    The rules of dual return: 63-9243 Rev D, section 9.3.2.
    """
    sent = distance_m > 0
    if mode is ReturnMode.DUAL:
        same = distance_m[..., 0] == distance_m[..., 1]
        sent[..., 1] &= ~same
        sent[..., 2] &= same
    else:
        sent &= np.arange(3) == (1 if mode is ReturnMode.LAST else 0)
    return sent


def _labels(returns: Returns, sent: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Look up the surface behind each point; what fog or rain throws back is of no class."""
    assert returns.surface is not None
    assert returns.surfaces is not None
    assert returns.range_m is not None
    surfaces = np.append(returns.surfaces, np.zeros(1, SURFACE))  # the last row is that of `NO_SURFACE`
    rows = surfaces[np.minimum(returns.surface[sent], len(returns.surfaces))]
    return {name: rows[name] for name in (*_LABELS, "reflectance")} | {
        "leaf_wood": LEAF_OR_WOOD[rows["part"]],
        "range_m": returns.range_m[sent],
    }
