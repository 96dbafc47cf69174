"""Roots that run over the ground from the butts of old trees, half buried, until they dive."""

import numpy as np

from vlp16emu.elementary import cos, exp, sin
from vlp16emu.forest.plants.flora import Trees
from vlp16emu.forest.plants.stem_rings import StemRings
from vlp16emu.forest.purpose import Growth
from vlp16emu.random import uniform
from vlp16emu.types import Array, HeightField, IntArray
from vlp16emu.world.vectors import unit

_STATIONS = np.array([0.0, 0.08, 0.2, 0.4, 0.65, 1.0])
ROOT_SIDES, ROOT_RINGS = 6, len(_STATIONS)
"""Of a root's mesh, and where its rings are as shares of its length."""

_OLD_M = 0.3  # DBH from which trees have them; assumption
_MOST = 6  # roots of a tree: one to each lobe of its butt at most
_LENGTH, _LENGTH_M = (2.0, 4.5), (0.5, 2.0)  # over the DBH, and on the ground, least and most; assumptions
_RADIUS = (0.09, 0.15)  # at the butt over the DBH, least and most; assumption

_THINNER, _RISE, _RISE_M = 0.7, 1.5, 0.2
"""Share of its radius that a root loses on its way; how much higher than wide it leaves the butt, and over what length that
dies away by e; assumptions."""

_BURIED, _BEND, _ASIDE_RAD = 0.15, 0.12, 0.3
"""Of its height how far its middle lies in the ground before it dives; its bends over its length; range of its direction about
that of its lobe; assumptions."""

_TOP_M = 0.3
"""Over the foot above which no root reaches, lest it be part of a section at breast height: uphill it dives."""


def root_points(trees: Trees, rings: StemRings, height_m: HeightField) -> tuple[IntArray, Array]:
    """Roots of stems (n,), each from the seed of its stem's form.

    Of each (k,) the stem, and vertices (k, 1 + rings * sides + 1, 3) relative to its foot: the middle of the end in the butt,
    rings from there, and the tip.
    """
    number, _, phase = rings.forms.lobes.T
    seeds = [int(seed) for seed in trees["form"]]
    draws = np.array([uniform(seed, Growth.ROOT, 0, 5 * _MOST) for seed in seeds]).reshape(-1, _MOST, 5)
    is_there = (draws[..., 0] < rings.forms.surface_roots[:, None]) & (np.arange(_MOST) < number[:, None])
    stem, lobe = np.nonzero(is_there & (trees["dbh_m"] > _OLD_M)[:, None])
    turn, long, thick, bend = draws[stem, lobe, 1:].T
    dbh_m = trees["dbh_m"][stem]
    azimuth = (phase[stem] + 2 * np.pi * lobe) / number[stem] + _ASIDE_RAD * (turn - 0.5)
    length_m = np.clip(dbh_m * np.interp(long, (0, 1), _LENGTH), *_LENGTH_M)
    line_m = _lines(azimuth, length_m, bend) + 0.8 * rings.radius_m[stem, 1, None, None] * _unit(azimuth)
    wide_m = (dbh_m * np.interp(thick, (0, 1), _RADIUS))[:, None] * (1 - _THINNER * _STATIONS)
    high_m = wide_m * (1 + _RISE * exp(-_STATIONS * length_m[:, None] / _RISE_M))
    place = trees[stem]
    ground_m = height_m(place["x_m"][:, None] + line_m[..., 0], place["y_m"][:, None] + line_m[..., 1])
    sunk_m = high_m * (_BURIED + _STATIONS * _STATIONS * _STATIONS)
    z_m = np.minimum(ground_m - place["z_m"][:, None] - sunk_m, _TOP_M - high_m)
    return stem, _pipes(np.concatenate([line_m, z_m[..., None]], axis=2), wide_m, high_m)


def _unit(azimuth: Array) -> Array:
    """Level vectors (k, 1, 2) in directions (k,)."""
    return np.stack([cos(azimuth), sin(azimuth)], axis=-1)[:, None]


def _lines(azimuth: Array, length_m: Array, bend: Array) -> Array:
    """Middles (k, rings, 2) of roots seen from above, from where they begin; bends are draws (k,) from 0 to 1."""
    phase = 2 * np.pi * bend[:, None]
    aside_m = _BEND * length_m[:, None] * _STATIONS * (sin(5 * _STATIONS + phase) - sin(phase))
    along_m = length_m[:, None] * _STATIONS
    return along_m[..., None] * _unit(azimuth) + aside_m[..., None] * _unit(azimuth + np.pi / 2)


def _pipes(middle_m: Array, wide_m: Array, high_m: Array) -> Array:
    """Vertices of roots about middles (k, rings, 3), upright ellipses of half axes (k, rings) across them."""
    ahead = unit(np.gradient(middle_m[..., :2], axis=1))
    angle = (np.arange(ROOT_SIDES) + 0.5) * 2 * np.pi / ROOT_SIDES
    left_m = wide_m[..., None] * cos(angle)
    ring_m = np.repeat(middle_m[:, :, None], ROOT_SIDES, axis=2)
    ring_m[..., 0] -= ahead[..., None, 1] * left_m
    ring_m[..., 1] += ahead[..., None, 0] * left_m
    ring_m[..., 2] += high_m[..., None] * sin(angle)
    ring_m = ring_m.reshape(len(middle_m), ROOT_RINGS * ROOT_SIDES, 3)
    tip_m = middle_m[:, -1:].copy()
    tip_m[..., :2] += ahead[:, -1:] * wide_m[:, -1:, None]
    return np.concatenate([middle_m[:, :1], ring_m, tip_m], axis=1)
