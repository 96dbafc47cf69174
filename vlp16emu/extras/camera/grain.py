"""Grain of ground and bark: colour that varies in the world, finer than the lidar's texture."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.types import F4, F8, U4, PlantPart, Semantic


class Grain(NamedTuple):
    """Grain of a kind of surface: by eye, from photographs of stems and forest floors."""

    across: float  # refinement across the stem, and along it
    up: float
    brightness: float  # factor on the palette's colour
    strength: float  # relative change of brightness, up and down
    marks: float  # share of the blackest spots that are nearly black


_NONE = Grain(1.0, 1.0, 1.0, 0.0, 0.0)
_GROUND = Grain(1.0, 1.0, 0.7, 1.3, 0.0)
_BARK = Grain(2.0, 0.35, 0.85, 1.3, 0.0)  # furrows along the stem
_SMOOTH = Grain(0.7, 1.4, 0.9, 0.5, 0.0)
_BIRCH = Grain(0.8, 3.0, 0.95, 0.35, 1.0)  # black bars across the stem
_OF_SPECIES = {"silver_birch": _BIRCH, "european_beech": _SMOOTH, "red_maple": _SMOOTH}
_WOOD = (PlantPart.STEM, PlantPart.ROOT_FLARE)
_SIZES_M = np.array([1.6, 0.55, 0.19, 0.065, 0.022])
_MARK_FROM = 0.33  # noise from which on birch bark is black, up to the next number
_MARK_FULL = 0.45
_BLACK = 0.06


def grain_table(surfaces: NDArray[np.void], species: Mapping[int, str]) -> F8:
    """Return the grain (m, 5) of a table of surfaces (m,) `SURFACE`; `species` are names by number."""
    table = np.tile(np.array(_NONE), (len(surfaces), 1))
    table[surfaces["semantic"] == Semantic.GROUND] = _GROUND
    wood = np.isin(surfaces["part"], _WOOD)
    table[wood] = _BARK
    for number, name in species.items():
        if name in _OF_SPECIES:
            table[wood & (surfaces["species"] == number)] = _OF_SPECIES[name]
    return table


@inline_kernel
def _lattice(x: np.int64, y: np.int64, z: np.int64, octave: int) -> float:
    """Return a number in -1..1 for a corner of the lattice: MurmurHash3's finaliser, as for voxels."""
    h = np.uint32(
        np.uint32(x) * np.uint32(0x9E3779B1)
        ^ np.uint32(y) * np.uint32(0x85EBCA77)
        ^ np.uint32(z) * np.uint32(0xC2B2AE3D)
        ^ np.uint32(octave) * np.uint32(0x27D4EB2F)
    )
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(0x7FEB352D))
    h = np.uint32((h ^ (h >> np.uint32(15))) * np.uint32(0x846CA68B))
    h = np.uint32(h ^ (h >> np.uint32(16)))
    return np.float64(h >> np.uint32(8)) / 8388607.5 - 1.0


@inline_kernel
def _noise(x: float, y: float, z: float, octave: int) -> float:
    """Return smooth noise in -1..1: the corners of a cell, blended by a cubic (Perlin, SIGGRAPH 1985)."""
    i = np.int64(np.floor(x))
    j = np.int64(np.floor(y))
    k = np.int64(np.floor(z))
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v), w * w * (3.0 - 2.0 * w)
    total = 0.0
    for corner in range(8):
        a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
        share = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
        total += share * _lattice(i + a, j + b, k + c, octave)
    return total


@kernel
def fill_grain(place_m: F8, pixel_m: F8, surface: U4, table: F8, sizes_m: F8, out: F4) -> None:
    """Fill factors (n,) on the colours at places (n, 3) in the world; parts finer than a pixel fade."""
    for n in range(len(out)):
        across, up, brightness, strength, marks = table[surface[n]]
        out[n] = brightness
        if strength == 0.0:
            continue
        total = 0.0
        for octave in range(len(sizes_m)):
            size_m = sizes_m[octave]
            scale = 1.0 / size_m
            fine_m = size_m / (2.0 * pixel_m[n] * max(across, up))
            seen = fine_m * fine_m / (1.0 + fine_m * fine_m)
            if seen > 0.02:
                x = place_m[n, 0] * across * scale
                y = place_m[n, 1] * across * scale
                z = place_m[n, 2] * up * scale
                total += 0.45 * seen * _noise(x, y, z, octave)
        black = min(max((total - _MARK_FROM) / (_MARK_FULL - _MARK_FROM), 0.0), 1.0) * marks
        out[n] = brightness * max(1.0 + strength * total, 0.1) * (1.0 - black * (1.0 - _BLACK))


def grain(place_m: F8, pixel_m: F8, surface: U4, table: F8) -> F4:
    """Return factors (n,) on the colours of n places.

    Parameters
    ----------
    place_m : (n, 3) in the world
    pixel_m : (n,) width of a pixel there
    surface : (n,) rows of `table`
    table : (m, 5) from `grain_table`
    """
    out = np.empty(len(place_m), np.float32)
    fill_grain(place_m, pixel_m, surface, table, _SIZES_M, out)
    return out
