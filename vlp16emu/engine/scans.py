"""Returns as points and whole revolutions, without going through packets."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine.build import Unit
from vlp16emu.engine.engine import Engine
from vlp16emu.packets import SEQUENCES_PER_BLOCK
from vlp16emu.raycast.displace import offset_tangents
from vlp16emu.scan import Chunk, Scan, cut_scans
from vlp16emu.sensor.place import place
from vlp16emu.types import SURFACE, ReturnMode, Returns
from vlp16emu.units import seconds_to_ns

_LABELS = ("semantic", "part", "instance", "species")


def scans_of(engine: Engine, number: int, span_s: tuple[float, float], *, truth: bool) -> Iterator[Scan]:
    """Return whole revolutions of a unit, numbered from 0, within a span; with labels if `truth`.

    Raises
    ------
    TrajectoryError : If the walk is over before the span
    """
    start_ns, unit = engine.scenario.start_ns, engine.parts.units[number]
    begin_ns, end_ns = (start_ns + seconds_to_ns(s) for s in span_s)
    returns = engine.returns(*span_s, number, truth=truth)
    chunks = (_chunk(unit, block, begin_ns, end_ns, truth=truth) for block in returns)
    return cut_scans(chunks, lambda t_ns: world_T_sensor(unit, np.array([t_ns]))[0])


def world_T_sensor(unit: Unit, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the poses (n, 4, 4) of the sensor in the world, at instants (n,) UTC."""
    poses = unit.motion.poses_at(t_ns)
    T = np.zeros((len(t_ns), 4, 4))
    T[:, :3, :3] = poses.world_R_body
    T[:, :3, 3], T[:, 3, 3] = poses.world_p_body_m, 1.0
    return T


def _chunk(unit: Unit, returns: Returns, begin_ns: int, end_ns: int, *, truth: bool) -> Chunk:
    """Points of a block whose azimuth is read within a span, each echo once, the last one first."""
    firings, step = returns.firings, SEQUENCES_PER_BLOCK
    reading_ns = firings.t_ns[::step, 0]
    taken = (reading_ns >= begin_ns) & (reading_ns < end_ns)
    inside = np.broadcast_to(np.repeat(taken, step)[:, None], firings.t_ns.shape)
    points, sequence = points_of(unit, returns, inside, truth=truth)
    # Of dual return, the strongest one is the last one where both are the same.
    distance_m, is_dual = returns.distance_m[sequence, points["laser"]], unit.section.return_mode == "dual"
    is_last = points["return_number"] == 1
    is_last |= (points["return_number"] == 0) & (distance_m[:, 0] == distance_m[:, 1]) & is_dual
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


def points_of(
    unit: Unit, returns: Returns, inside: NDArray[np.bool_], *, truth: bool
) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Return the points of pulses (k, L) that are `inside`, and the row (n,) of the firing sequence of each."""
    firings, beams, t_ns = returns.firings, unit.head.beams, returns.firings.t_ns
    sent = _sent(returns.distance_m, ReturnMode(unit.section.return_mode)) & inside[..., None]
    sequence, laser, number = np.nonzero(sent)
    distance_m, pulse_ns = returns.distance_m[sent], t_ns[sequence, laser]
    poses = unit.motion.poses_at(pulse_ns)
    tangents = None
    if unit.beam.section.model == "offset":
        tangents = offset_tangents(distance_m, unit.beam, firings.index + sequence, laser, t_ns.shape[1])
    placed = place(beams, firings, sequence, laser, distance_m, poses, tangents)
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
    return {name: rows[name] for name in (*_LABELS, "reflectance")} | {"range_m": returns.range_m[sent]}
