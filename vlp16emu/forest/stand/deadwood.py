"""Logs and stumps: what lies felled, uprooted, broken or rotten, and what is left standing of it."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, hypot, sin
from vlp16emu.forest.stand.floor_shapes import LOG_TAPER, FloorKind, labelled
from vlp16emu.forest.stand.layer import Layer
from vlp16emu.forest.stand.placed import PlacedThings, Site, between, laid, placements, together, turned
from vlp16emu.types import Array, IntArray

Mask = NDArray[np.bool_]

_STATIONS = np.linspace(-0.5, 0.5, 9)
"""Along a log, where the ground under it and the distance from the path are looked at."""

_SUNK = 0.25  # share of its half height that a sound log has sunk into the ground; assumption

_DECAY = (0.3, 1.0)
"""Range of the decay of a log that decays: from round to oval at the third of five classes to one that lies wholly on the
ground (decay class system for coarse woody debris in Ann. For. Sci. 67(8), 2010, f09374, table I)."""

_DECAYED_LOWER, _DECAYED_WIDER, _DECAYED_SUNK = 0.5, 0.2, 0.5
"""Of a log of decay 1: by how much its section is lower and wider, and sunk besides; assumptions."""

_BREAK_AT, _BREAK_GAP, _BREAK_TURN = (0.35, 0.65), (0.02, 0.1), np.radians(12.0)
"""Range of the place of a break and of the gap there, over the length, and half-range of the angle between the pieces;
assumptions."""

_PLATE_M, _PLATE_PER_DIAMETER = 1.0, 4.0
"""Diameter of a root plate: that of a log without thickness, and its growth with the mean diameter of the log; assumption."""

_PLATE_THICKNESS = 0.25  # over its diameter; assumption

_PLATE_AXIS = 0.3
"""Height of the butt over the ground, over the diameter of its plate, whose lower part stands in its pit; assumption."""

_PLATE_STATIONS = np.linspace(-0.4, 0.4, 5)
"""Across a plate, where the distance from the path and from trunks is looked at."""


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Whole logs and pieces of broken ones, (n,) each."""

    log: IntArray  # which log it is of
    is_top: Mask  # whether it is the upper piece of a broken one
    xy_m: Array  # (n, 2) middle
    towards: Array  # from butt to top, rad from east
    length_m: Array
    wide_m: Array
    high_m: Array
    sunk: Array  # share of the half height

    def along_m(self) -> Array:
        """Places (n, 9, 2) along them."""
        return _line_m(self.xy_m, self.towards, self.length_m[:, None] * _STATIONS)


def lay_logs(layer: Layer, site: Site, xy_m: Array, draws: Array, fate: Array) -> PlacedThings:
    """Lay trunks along the ground under them, some with their root plate, some broken in two, some rotten."""
    own = layer.section
    diameter_m = between(own.diameter_m, draws[:, 0])
    is_uprooted, is_broken = fate[:, 0] < own.uprooted, fate[:, 1] < own.broken
    # Where a root plate still stands, the log is young.
    decay = np.where((fate[:, 2] < own.decayed) & ~is_uprooted, between(_DECAY, fate[:, 3]), 0.0)
    plate_m = np.where(is_uprooted, _PLATE_M + _PLATE_PER_DIAMETER * diameter_m, 0.0)
    whole = _Pieces(
        log=np.arange(len(xy_m)),
        is_top=np.zeros(len(xy_m), np.bool_),
        xy_m=xy_m,
        towards=2 * np.pi * draws[:, 2],
        length_m=between(own.length_m, draws[:, 1]),
        wide_m=diameter_m * (1 + _DECAYED_WIDER * decay),
        high_m=diameter_m * (1 - _DECAYED_LOWER * decay),
        sunk=_SUNK + _DECAYED_SUNK * decay,
    )
    pieces = _broken(whole, is_broken, fate[:, 4:])
    world_T = _laid_down(pieces, site, plate_m)
    keep = _free(pieces, site) & _free_plates(pieces, plate_m, site)
    keep = np.bincount(pieces.log, ~keep, len(xy_m))[pieces.log] == 0
    species, looks = _species(layer, draws)[pieces.log], draws[pieces.log]
    log_looks = np.where(pieces.is_top[:, None], looks[:, [6, 5]], looks[:, 4:6])
    in_two, has_plate = is_broken[pieces.log], (plate_m[pieces.log] > 0) & ~pieces.is_top
    butt_T = _plates(world_T, pieces, plate_m)
    return together(
        [
            labelled(FloorKind.LOG, keep & ~in_two, world_T, log_looks, species=species),
            labelled(FloorKind.BROKEN_LOG, keep & in_two, world_T, log_looks, species=species),
            labelled(FloorKind.ROOT_PLATE, keep & has_plate, butt_T, looks[:, [7, 5]], species=species),
        ]
    )


def lay_stumps(layer: Layer, site: Site, xy_m: Array, draws: Array) -> PlacedThings:
    """Lay out what is left of trees that were felled or broke."""
    own, species = layer.section, _species(layer, draws)
    diameter_m, height_m = between(own.diameter_m, draws[:, 0]), between(own.height_m, draws[:, 1])
    keep = site.clear(xy_m, 0.8 * diameter_m, 0.8 * diameter_m)
    place_m = np.column_stack([xy_m, site.height_m(*xy_m.T)])
    size = np.column_stack([diameter_m, diameter_m, height_m])
    world_T = placements(place_m, turned(360 * draws[:, 2]), size)
    is_broken = draws[:, 6] < own.broken
    kinds = (FloorKind.STUMP, keep & ~is_broken), (FloorKind.BROKEN_STUMP, keep & is_broken)
    return together([labelled(kind, which, world_T, draws[:, 4:], species=species) for kind, which in kinds])


def _species(layer: Layer, draws: Array) -> IntArray:
    numbers = np.array([tree.number for tree in layer.species], np.int64)
    return numbers[(len(numbers) * draws[:, 3]).astype(int)]


def _broken(whole: _Pieces, is_broken: Mask, draws: Array) -> _Pieces:
    """Break some of the logs (n,) in two; draws (n, 3) say where, how far apart, and at what angle."""
    at, gap = between(_BREAK_AT, draws[:, 0]), between(_BREAK_GAP, draws[:, 1])
    turn = np.where(is_broken, _BREAK_TURN * (2 * draws[:, 2] - 1), 0.0)
    share = np.where(is_broken, at, 1.0)
    butt = _piece(whole, -0.5 + share / 2, share, is_broken)
    # The upper piece is turned about its lower end.
    low, length_m = (at + gap - 0.5) * whole.length_m, (1 - at - gap) * whole.length_m
    end_m = _line_m(whole.xy_m, whole.towards, low[:, None])[:, 0]
    top = replace(
        _piece(whole, at / 2, 1 - at - gap, is_broken),
        xy_m=_line_m(end_m, whole.towards + turn, length_m[:, None] / 2)[:, 0],
        towards=whole.towards + turn,
        is_top=is_broken,
    )
    both = ((getattr(butt, field.name), getattr(top, field.name)) for field in fields(_Pieces))
    return _Pieces(*(np.concatenate([lower, upper[is_broken]]) for lower, upper in both))


def _piece(whole: _Pieces, middle: Array, share: Array, is_broken: Mask) -> _Pieces:
    """Cut pieces (n,) out of logs, about middles and of lengths that are shares of theirs; as thick as the logs are there."""
    thick = np.where(is_broken, 1 - 2 * LOG_TAPER * middle, 1.0)
    return replace(
        whole,
        xy_m=_line_m(whole.xy_m, whole.towards, (middle * whole.length_m)[:, None])[:, 0],
        length_m=share * whole.length_m,
        wide_m=thick * whole.wide_m,
        high_m=thick * whole.high_m,
    )


def _laid_down(pieces: _Pieces, site: Site, plate_m: Array) -> Array:
    """`world_T_shape` (n, 3, 4) of pieces on the ground; the butts of those with plates of diameters (logs,) are raised."""
    station_m = pieces.length_m[:, None] * _STATIONS
    ground_m = site.height_m(*np.moveaxis(pieces.along_m(), -1, 0))
    # Straight line of least squares through the ground at evenly spaced stations.
    slope = (ground_m * station_m).sum(axis=1) / (np.square(station_m)).sum(axis=1)
    rest_m = (1 - pieces.sunk) * pieces.high_m / 2
    butt_m = np.where(pieces.is_top, 0.0, _PLATE_AXIS * plate_m[pieces.log])
    lift_m = np.maximum(butt_m - rest_m, 0.0)
    z_m = ground_m.mean(axis=1) + rest_m + lift_m / 2
    world_R_log = laid(pieces.towards, slope - lift_m / pieces.length_m)
    size = np.column_stack([pieces.length_m, pieces.wide_m, pieces.high_m])
    return placements(np.column_stack([pieces.xy_m, z_m]), world_R_log, size)


def _plates(world_T: Array, pieces: _Pieces, plate_m: Array) -> Array:
    """`world_T_shape` (n, 3, 4) of root plates at the butts of pieces, across them; of diameters (logs,)."""
    along = world_T[:, :, 0] / pieces.length_m[:, None]
    rise = along[:, 2] / hypot(along[:, 0], along[:, 1])
    size = plate_m[pieces.log, None] * [_PLATE_THICKNESS, 1.0, 1.0]
    return placements(world_T[:, :, 3] - world_T[:, :, 0] / 2, laid(pieces.towards, rise), size)


def _free(pieces: _Pieces, site: Site) -> Mask:
    radius_m = np.repeat(pieces.wide_m / 2, len(_STATIONS))
    along_m = pieces.along_m()
    clear = site.clear(along_m.reshape(-1, 2), radius_m, radius_m).reshape(along_m.shape[:2])
    return np.asarray(clear.all(axis=1))


def _free_plates(pieces: _Pieces, plate_m: Array, site: Site) -> Mask:
    """Which pieces (n,) have a root plate that keeps clear of the path and of trunks, or none."""
    clear = np.ones(len(pieces.log), np.bool_)
    own = np.flatnonzero(~pieces.is_top & (plate_m[pieces.log] > 0))
    wide_m = plate_m[pieces.log[own]]
    butt_m = _line_m(pieces.xy_m[own], pieces.towards[own], -pieces.length_m[own, None] / 2)[:, 0]
    across_m = _line_m(butt_m, pieces.towards[own] + np.pi / 2, wide_m[:, None] * _PLATE_STATIONS)
    reach_m = np.repeat(_PLATE_THICKNESS * wide_m, len(_PLATE_STATIONS))
    found = site.clear(across_m.reshape(-1, 2), reach_m, reach_m)
    clear[own] = found.reshape(across_m.shape[:2]).all(axis=1)
    return clear


def _line_m(xy_m: Array, towards: Array, along_m: Array) -> Array:
    """Places (n, k, 2) at distances (n, k) from points (n, 2) in directions (n,), rad from east."""
    away = np.stack([cos(towards), sin(towards)], axis=-1)
    line: Array = xy_m[:, None] + along_m[..., None] * away[:, None]
    return line
