"""Texture, shading, relief and gloss of surfaces.

Patches, smooth variation over metres, unevenness, and shine at normal incidence.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import exp
from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.once import once_per_array
from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.trig import ZERO, fold
from vlp16emu.types import F4, F8, I8, U2, U4, Firings, Hits, PlantPart

_GRID_M = 0.2
_BARK_GRID_M = 0.1
_RELIEF_GRID_M = 0.15
"""Patch sizes of walls and ground, of bark, and of relief; folds halve them. With these sizes neighbouring
returns are equal as often, and differ as much, as on real sensors, and relief correlates at pulses 0.2
degrees apart, not at 0.4 (protocol/README.md)."""
_RELIEF_FROM_M = 6.0
_FINEST = 32.0
"""Range from which on relief has patches of that size, which halve with the range, and the greatest
refinement: real surfaces are rough at all scales, and a pulse resolves its footprint, at 1 m as at 10 m
(units A and D of protocol/README.md)."""
_SAME_M = 0.1  # sub-rays of a pulse that end within this distance share a patch
_SPREAD = math.sqrt(3.0)  # half-width of a uniform distribution of variance one
_CELL_BITS = 3  # eight patches across share a contrast: a wall, a floor or bark consists of such areas
_LN_STRENGTH = 1.2
"""Spread of the logarithm of the contrast over areas: reflectivity scatter, with white errors, has 0.65 to
0.74 on real units."""
_NORMAL = np.array([0.078, 0.237, 0.402, 0.579, 0.776, 1.01, 1.318, 1.863])
_STRENGTH = exp(_LN_STRENGTH * np.concatenate([-_NORMAL, _NORMAL]) - _LN_STRENGTH * _LN_STRENGTH) * 1.4229
"""Midpoints of sixteen equal shares of a log-normal distribution, with a mean square of one."""
_FLATTEST = 0.15
"""Cosine of incidence below which the contrast no longer grows: unevenness changes the cosine more on slanted
surfaces."""
_STANDING_OUT = math.sqrt(11.0)
"""Half-width for the fifth power of a uniform distribution: most of a wall is flat, few parts stand out
far."""
_EVEN = 0.213
_UNEVEN = 0.8519
"""Least relief of an area over the setting, and the addition by its contrast: areas differ, with a mean
square of one."""
_WAVES_PER_M = np.array([[0.29, 0.13, 0.21], [-0.17, 0.31, 0.37], [0.53, -0.41, 0.11]])
"""Waves of the shading: two of 2.6 and 2 m and one of 1.5 m, each askew to the axes (assumption: light,
dirt and paint vary over metres along the walls of real captures, and through all rings)."""
_SMOOTHED = 0.8284
"""Factor of three smoothed waves for a variance of one: a cubic step of a uniform number has 13/35 - 1/4."""
_PHASE_PER_ROW = 0.618034
# Fresnel reflectance at normal incidence for a refractive index of 1.5, as of paint, varnish and wax
_COAT = 0.04
_TEXTURE = ZERO + Purpose.TEXTURE
_ONE = np.uint64(1)
_ALONE = 3  # columns of looks for texture alone
_KNOWN_BITS = 10
_MIX_COUNTER = np.uint64(0x9E3779B97F4A7C15)
_MIX_LANE = np.uint64(0xC2B2AE3D27D4EB4F)
_Known = tuple[I8, F8]
"""Cells (n, 2) that were hit last, as counters of their draws, and the draws (n,), n = 2**`_KNOWN_BITS`:
patches and areas, each at a place by its hash. Pulses side by side hit the same ones, in turns."""


class _Sequence(NamedTuple):
    """Scratch for the sub-rays of a firing sequence, and for the patches that they hit; n of each at most."""

    texture: F4  # (n,) of the surface that each sub-ray hits; `reflectance` likewise
    reflectance: F4
    patch: U4  # (n,) patch of each sub-ray
    x: F8
    """(n,) place of each patch in patches, then its cell in whole numbers; `y` and `z` likewise."""
    y: F8
    z: F8
    drawn: F8  # (n,) deviation of each patch, of variance one
    deviation: F8  # (n,) that of the patch of each sub-ray


def _sequence_of(n: int) -> _Sequence:
    """Make scratch for n sub-rays."""
    texture, reflectance = np.empty((2, n), np.float32)
    x, y, z, drawn, deviation = np.zeros((5, n))
    return _Sequence(texture, reflectance, np.zeros(n, np.uint32), x, y, z, drawn, deviation)


def add_texture(firings: Firings, hits: Hits, surfaces: NDArray[np.void], seed: int) -> None:
    """Add the texture, shading, relief and gloss of each surface to hits, in place.

    Brightness scales the cosine of incidence, up to the brightness of a white surface. Relief moves hits
    along the pulse. Both are taken on the axis of the pulse, at the range of the sub-ray. Gloss is the light
    that facets of a coat mirror back along the pulse (Walter et al., EGSR 2007, equations 20 and 25:
    Beckmann's distribution). It too ends at the brightness of a white surface: real units send hardly any
    codes between 100 and those of retroreflectors. A surface without reflectance stays black.

    Parameters
    ----------
    surfaces : (m,) `SURFACE`, the window's table
    seed : seed of the world
    """
    looks = _looks_of(surfaces)
    if looks is None:
        return
    rays = (hits.count, hits.range_m, hits.surface, hits.cos_incidence)
    known = np.full((1 << _KNOWN_BITS, 2), -1), np.empty(1 << _KNOWN_BITS)
    if looks.shape[1] > _ALONE:
        _texture(firings.origin_m, firings.direction, rays, looks, seed, known)
    else:
        most = int(hits.count.sum(axis=1, dtype=np.int64).max(initial=0))
        _texture_alone(firings.origin_m, firings.direction, rays, looks, seed, known, _sequence_of(most))


@once_per_array
def _looks_of(surfaces: NDArray[np.void]) -> F4 | None:
    """Return looks as `_texture` or `_texture_alone` takes them; None if all surfaces are even and matt."""
    is_alone = not any(surfaces[name].any() for name in ("shading", "relief_m", "roughness"))
    if is_alone and not surfaces["texture"].any():
        return None
    per_m = np.where(surfaces["part"] == PlantPart.NONE, 1.0 / _GRID_M, 1.0 / _BARK_GRID_M).astype(np.float32)
    columns = [surfaces["texture"], surfaces["reflectance"], per_m]
    if is_alone:
        return np.stack(columns, axis=1)
    steep = np.divide(1.0, surfaces["roughness"], out=np.zeros_like(per_m), where=surfaces["roughness"] > 0.0)
    return np.stack([*columns, surfaces["relief_m"], steep * steep, surfaces["shading"]], axis=1)


@kernel
def _texture(
    origin_m: F8, direction: F8, rays: tuple[U2, F4, U4, F4], looks: F4, seed: int, known: _Known
) -> None:
    """Add relief to the ranges of sub-rays of pulses (k, L); multiply their cosines by the texture.

    Parameters
    ----------
    looks : (m, 6) texture, reflectance, patches per metre, relief, inverse square of the roughness, and
        shading of each surface, in one line of the cache
    """
    (count, range_m, met, cosine) = rays
    stop = ZERO
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            start, stop = stop, stop + int(count[i, j])
            patch_m = -np.inf
            patch = 0.0
            for ray in range(np.uint64(start), np.uint64(stop)):  # signed indices might count from the end
                if not range_m[ray] < np.inf:
                    continue
                row = met[ray]
                at_m = np.float64(range_m[ray])
                texture = looks[row, 0]
                reflectance = looks[row, 1]
                per_m = looks[row, 2]
                relief_m = looks[row, 3]
                slope = max(np.float64(cosine[ray]), _FLATTEST)
                steepness = np.float64(looks[row, 4])
                if texture != 0.0:
                    if abs(range_m[ray] - patch_m) > _SAME_M:
                        patch_m = at_m
                        patch = _patch(seed, per_m, origin_m, direction, i, j, at_m, known)
                    slant = 0.5 + 0.5 / slope
                    more = texture * slant * patch
                    cosine[ray] *= np.float32(_factor(more, reflectance))
                shading = looks[row, 5]
                if shading != 0.0:
                    more = shading * _shade(origin_m, direction, i, j, at_m, _PHASE_PER_ROW * row)
                    cosine[ray] *= np.float32(_factor(more, reflectance))
                if steepness > 0.0 and reflectance > 0.0:
                    square = slope * slope
                    shine = (
                        0.25
                        * _COAT
                        * steepness
                        * exp((1.0 - 1.0 / square) * steepness)
                        / (square * square * slope)
                    )
                    white = max(cosine[ray], np.float32(1.0 / reflectance))
                    cosine[ray] = min(cosine[ray] + np.float32(shine / reflectance), white)
                if relief_m > 0.0:
                    finer = 1.0
                    while finer * at_m < _RELIEF_FROM_M and finer < _FINEST:
                        finer *= 2.0
                    place = _place(finer / _RELIEF_GRID_M, origin_m, direction, i, j, at_m)
                    drawn, strength = _draw_patch(seed, *_cell_at(*place), known)
                    even = 2.0 * drawn - 1.0
                    square = even * even
                    range_m[ray] += (
                        relief_m * _STANDING_OUT * (square * square * even) * (_EVEN + _UNEVEN * strength)
                    )


@kernel
def _texture_alone(
    origin_m: F8,
    direction: F8,
    rays: tuple[U2, F4, U4, F4],
    looks: F4,
    seed: int,
    known: _Known,
    sequence: _Sequence,
) -> None:
    """Multiply cosines by the texture as `_texture` does, where no surface has relief, gloss or shading.

    A firing sequence at a time: the places of its patches, and their cells, several at once; their draws;
    and the factors of its sub-rays, several at once.

    Parameters
    ----------
    looks : (m, 3) the first columns
    sequence : scratch
    """
    (count, range_m, met, cosine) = rays
    (textures, reflectance, patch_of, x, y, z, drawn, deviation) = sequence
    stop = np.uint64(0)
    for i in range(count.shape[0]):
        first = stop
        found = last = np.uint64(0)
        for j in range(count.shape[1]):
            start, stop = stop, stop + np.uint64(count[i, j])
            patch_m = -np.inf
            for ray in range(start, stop):
                is_hit = range_m[ray] < np.inf
                row = met[ray] if is_hit else np.uint32(0)
                texture = looks[row, 0] if is_hit else np.float32(0.0)
                if (texture != 0.0) & (abs(range_m[ray] - patch_m) > _SAME_M):
                    patch_m = np.float64(range_m[ray])
                    (x_at, y_at, z_at) = _place(np.float64(looks[row, 2]), origin_m, direction, i, j, patch_m)
                    x[found] = x_at
                    y[found] = y_at
                    z[found] = z_at
                    last = found
                    found += _ONE
                textures[ray - first] = texture
                reflectance[ray - first] = looks[row, 1]
                patch_of[ray - first] = last
        for patch in range(found):
            (u, v, w) = _cell_at(x[patch], y[patch], z[patch])
            x[patch] = u
            y[patch] = v
            z[patch] = w
        for patch in range(found):
            drawn[patch] = _texture_of(seed, x[patch], y[patch], z[patch], known)
        for ray in range(stop - first):  # on its own, so that the next loop computes several at once
            deviation[ray] = drawn[patch_of[ray]]
        for ray in range(stop - first):
            slope = max(np.float64(cosine[first + ray]), _FLATTEST)
            slant = 0.5 + 0.5 / slope
            more = textures[ray] * slant * deviation[ray]
            cosine[first + ray] *= np.float32(_factor(more, reflectance[ray]))


@inline_kernel
def _patch(
    seed: int, per_m: float, origin_m: F8, direction: F8, i: int, j: int, at_m: float, known: _Known
) -> float:
    """Return the texture of a patch of variance one, at a range along a pulse (i, j)."""
    place = _place(np.float64(per_m), origin_m, direction, i, j, at_m)
    return _texture_of(seed, *_cell_at(*place), known)


@inline_kernel
def _texture_of(seed: int, u: float, v: float, w: float, known: _Known) -> float:
    """Return the texture of a cell of patches, of variance one."""
    drawn, strength = _draw_patch(seed, u, v, w, known)
    return _SPREAD * (2.0 * drawn - 1.0) * strength


@inline_kernel
def _factor(more: float, reflectance: float) -> float:
    """Return the factor of brightness for a deviation, at most up to white, and its inverse below 0.

    Without a branch: processors cannot predict the sign. One of the two factors is 1.
    """
    brighter = min(1.0 + max(more, 0.0), max(1.0, 1.0 / reflectance))
    return brighter / (1.0 - min(more, 0.0))


@inline_kernel
def _shade(origin_m: F8, direction: F8, i: int, j: int, at_m: float, phase: float) -> float:
    """Return the smooth deviation, of variance one, of a place at a range along a pulse (i, j)."""
    x = origin_m[i, j, 0] + at_m * direction[i, j, 0]
    y = origin_m[i, j, 1] + at_m * direction[i, j, 1]
    z = origin_m[i, j, 2] + at_m * direction[i, j, 2]
    total = 0.0
    for wave in range(len(_WAVES_PER_M)):
        turns = _WAVES_PER_M[wave, 0] * x + _WAVES_PER_M[wave, 1] * y + _WAVES_PER_M[wave, 2] * z
        step = fold(turns + (1 + wave) * phase)
        total += step * step * (6.0 - 4.0 * step) - 1.0
    return _SMOOTHED * total


@inline_kernel
def _place(
    per_m: float, origin_m: F8, direction: F8, i: int, j: int, at_m: float
) -> tuple[float, float, float]:
    """Return the place at a range along a pulse (i, j), in patches from the origin."""
    x = per_m * (origin_m[i, j, 0] + at_m * direction[i, j, 0])
    y = per_m * (origin_m[i, j, 1] + at_m * direction[i, j, 1])
    z = per_m * (origin_m[i, j, 2] + at_m * direction[i, j, 2])
    return x, y, z


@inline_kernel
def _cell_at(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the cell of a place in patches, whole numbers; folds make the borders of cells irregular."""
    u = np.floor(x + fold(0.37 * y + 0.61 * z) + 0.4 * fold(2.3 * z - 1.7 * y))
    v = np.floor(y + fold(0.53 * z - 0.41 * x) + 0.4 * fold(1.9 * x + 2.1 * z))
    w = np.floor(z + fold(0.43 * x + 0.57 * y) + 0.4 * fold(1.6 * y - 2.2 * x))
    return u, v, w


@inline_kernel
def _draw_patch(seed: int, u: float, v: float, w: float, known: _Known) -> tuple[float, float]:
    """Draw a number in [0, 1) for the patch of a cell, and the contrast of its area."""
    a, b, c = np.int64(u), np.int64(v), np.int64(w)
    drawn = _draw_cell(seed, a, b, c, 0, known)
    share = _draw_cell(seed, a >> _CELL_BITS, b >> _CELL_BITS, c >> _CELL_BITS, 1, known)
    return drawn, _STRENGTH[np.int64(share * len(_STRENGTH))]


@inline_kernel
def _draw_cell(seed: int, u: np.int64, v: np.int64, w: np.int64, of_area: int, known: _Known) -> float:
    """Draw the number of a patch, or with 1 of an area, unless it is known."""
    cells, values = known
    counter = (u & 0xFFFFFFFF) | (v << 32)
    lane = (w << 1 | of_area) & 0xFFFFFFFF
    mixed = np.uint64(counter) * _MIX_COUNTER + np.uint64(lane) * _MIX_LANE
    place = mixed >> np.uint64(64 - _KNOWN_BITS)
    if cells[place, 0] != counter or cells[place, 1] != lane:
        cells[place, 0] = counter
        cells[place, 1] = lane
        first, second = uniform_pair(seed, _TEXTURE, counter, lane)
        values[place] = second if of_area else first
    return values[place]
