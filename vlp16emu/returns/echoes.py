"""Echoes of one pulse: the peaks of the waveform that its sub-rays reflect.

A pulse is a Gaussian in time, so the waveform is a sum of equal Gaussians, one per sub-ray, and a detector
that searches peaks reports its modes. Surfaces closer than the pulse width give one peak between them: the
mixed pixel.

Sub-rays within `NODE_M` are merged at their energy-weighted mean. The mode of Gaussians within a span s
differs from their mean by at most s**3 / (12 sqrt(3) sigma**2) to leading order, because their third moment
is at most s**3 / (6 sqrt(3)): 1.1 mm for a node and a pulse of 6 ns with the most asymmetric light; and the
peak is lower than the node by 2 % at most. Nodes of a shorter pulse are shorter in proportion. Most pulses
are one node and need no waveform.

Light that passes through a leaf, some 45 % at 903 nm, is scattered over the half-space behind it. The part
that comes back has passed the leaf twice and is spread both times, so it is weaker than direct light by the
share of the half-space that the receiver sees, and makes no echo. Sub-rays model the light that passes beside
a leaf.

Kernels allocate no arrays, so numba need not count references (`_nrt=False`). They are compiled into their
callers (`forceinline`): a call passes each array as seven numbers, which takes as long as a node.

`find_source_surfaces` gives ground truth: the surface of each return.
"""

from typing import NamedTuple

import numpy as np

from vlp16emu.elementary import exp
from vlp16emu.kernels.compiler import array_kernel, inline_kernel
from vlp16emu.kernels.eight import lowest_bit, sum_near, weigh_eight
from vlp16emu.returns.clutter import clutter_echo
from vlp16emu.returns.settings import DetectorConstants
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, F8, NO_SURFACE, U2, U4

COLUMNS = 5  # columns of a table of nodes, or of peaks
RANGE = 0  # columns of both: in metres, and as in `DetectorConstants`
AMPLITUDE = 1
OPEN = 2  # column of peaks: the amplitude, or 0 after the peak is processed
# columns of nodes during gathering: sub-rays without a node, and their light
_RAY = 2
_PART = 3
_EIGHT = 8
# columns of nodes after gathering: result of `_waveform` at each node
_HEIGHT = 2
_MEAN = 3
_VARIANCE = 4
NODE_M = 0.15  # greatest span of sub-rays that are merged
_NODE_SIGMAS = 0.4  # its limit in sigmas of the pulse: 0.382 m at 6 ns
_LN2 = 0.6931471805599453
_Light = tuple[float, float, float]
"""Mean and variance of the range of light, and height of the waveform, as `_waveform` returns them."""
_FAINTEST = 1e-9  # reflectance of black or edge-on surfaces, so that they still have a range
_OVERLAP_SIGMAS = 5.0  # sigmas at which an equally bright neighbour moves a peak by less than 0.01 mm
_LAST_STEP_M = 1e-3  # last step of Newton's method; the remaining error is about its square over sigma


class SubRays(NamedTuple):
    """Hits of sub-rays, as in `Hits`."""

    counts: U2
    range_m: F4
    surface: U4
    cos_incidence: F4
    reflectance: F4  # (m,) by surface


@inline_kernel
def amplitude_of(constants: DetectorConstants, energy: float, range_m: float) -> float:
    """Return the amplitude of an energy at the detector: range equation and two-way extinction.

    Parameters
    ----------
    energy : reflectance times cosine of incidence times the share of the pulse
    """
    amplitude = max(energy, _FAINTEST) / (range_m * range_m)
    if constants.extinction_per_m > 0.0:
        amplitude *= exp(-2.0 * constants.extinction_per_m * range_m)
    return amplitude


@inline_kernel
def gather(constants: DetectorConstants, rays: SubRays, start: int, stop: int, nodes: F8) -> int:
    """Sum the sub-rays start .. stop - 1 of a pulse into nodes (COLUMNS, n); return the number of nodes.

    Each node takes the sub-rays near the first remaining one. Processors cannot predict which are near, so
    the code does not branch. Nearly all pulses have eight.
    """
    if stop - start != _EIGHT:
        return _gather_some(constants, rays, start, stop, nodes)
    _, range_m, surface, cos_incidence, reflectance = rays
    reach_m = 0.5 * min(NODE_M, _NODE_SIGMAS * constants.sigma_m)
    room = np.uint64(nodes[_RAY].ctypes.data)
    offset = np.uint64(4) * np.uint64(start)
    left = weigh_eight(
        np.uint64(range_m.ctypes.data) + offset,
        np.uint64(cos_incidence.ctypes.data) + offset,
        np.uint64(surface.ctypes.data) + offset,
        np.uint64(reflectance.ctypes.data),
        _FAINTEST,
        room,
    )
    found = 0
    while left:
        first_m = nodes[_RAY, lowest_bit(left)]
        left, energy, moment = sum_near(room, left, first_m, reach_m)
        at_m = first_m + moment / energy
        nodes[RANGE, found] = at_m
        nodes[AMPLITUDE, found] = amplitude_of(constants, energy / _EIGHT, at_m)
        found += 1
    return found


@inline_kernel
def _gather_some(constants: DetectorConstants, rays: SubRays, start: int, stop: int, nodes: F8) -> int:
    """Sum any number of sub-rays as `gather` does."""
    _, range_m, surface, cos_incidence, reflectance = rays
    left = 0
    found = 0
    reach_m = 0.5 * min(NODE_M, _NODE_SIGMAS * constants.sigma_m)
    for ray in range(np.uint64(start), np.uint64(stop)):  # signed indices might count from the end
        if range_m[ray] < np.inf:
            nodes[_RAY, left] = range_m[ray]
            nodes[_PART, left] = np.float64(reflectance[surface[ray]]) * cos_incidence[ray] + _FAINTEST
            left += 1
    while left > 0:
        first_m = nodes[_RAY, 0]
        count = left
        energy = 0.0
        moment = 0.0
        left = 0
        for ray in range(count):
            ray_m = nodes[_RAY, ray]
            part = nodes[_PART, ray]
            nodes[_RAY, left] = ray_m
            nodes[_PART, left] = part
            away_m = ray_m - first_m
            near = abs(away_m) <= reach_m
            left += 1 - near
            part *= np.float64(near)  # the compiler would turn a condition into a branch
            energy += part
            moment += part * away_m
        at_m = first_m + moment / energy
        nodes[RANGE, found] = at_m
        nodes[AMPLITUDE, found] = amplitude_of(constants, energy / (stop - start), at_m)
        found += 1
    return found


@inline_kernel
def find_peaks(nodes: F8, count: int, sigma_m: float, peaks: F8) -> int:
    """Fill peaks (COLUMNS, n) in order of range from nodes, which are sorted; return the number of peaks."""
    _sort(nodes, count)
    found = start = ZERO
    for node in range(1, count + 1):
        if node == count or nodes[RANGE, node] - nodes[RANGE, node - 1] > _OVERLAP_SIGMAS * sigma_m:
            found = _peaks_of_group(nodes, start, node, sigma_m, peaks, found)
            start = node
    return found


@inline_kernel
def brightest_group(nodes: F8, count: int, sigma_m: float) -> tuple[int, int, float, float]:
    """Sort nodes, and find the group of overlapping nodes with the greatest sum of amplitudes.

    Returns
    -------
    first node of the group, and one past the last; its sum, which no peak exceeds; and the greatest sum of
    other groups
    """
    _sort(nodes, count)
    start = first = last = ZERO
    total = brightest = second = 0.0
    for node in range(count):
        total += nodes[AMPLITUDE, node]
        if node == count - 1 or nodes[RANGE, node + 1] - nodes[RANGE, node] > _OVERLAP_SIGMAS * sigma_m:
            if total > brightest:
                first, last, brightest, second = start, node + 1, total, brightest
            else:
                second = max(second, total)
            start = node + 1
            total = 0.0
    return first, last, brightest, second


@inline_kernel
def highest_peak(nodes: F8, start: int, stop: int, sigma_m: float, peaks: F8) -> tuple[float, float]:
    """Return range and amplitude of the highest peak of a group of nodes; the nearest of equal peaks."""
    found = _peaks_of_group(nodes, start, stop, sigma_m, peaks, ZERO)
    best = 0
    for peak in range(1, found):
        if peaks[AMPLITUDE, peak] > peaks[AMPLITUDE, best]:
            best = peak
    return peaks[RANGE, best], peaks[AMPLITUDE, best]


@inline_kernel
def _add_peak(peaks: F8, found: int, range_m: float, amplitude: float) -> int:
    """Add a peak, unless it is the previous one again; return the number of peaks."""
    if found > 0 and range_m - peaks[RANGE, found - 1] < _LAST_STEP_M:
        return found
    peaks[RANGE, found] = range_m
    peaks[AMPLITUDE, found] = peaks[OPEN, found] = amplitude
    return found + 1


@inline_kernel
def _sort(nodes: F8, count: int) -> None:
    for i in range(1, count):
        range_m = nodes[RANGE, i]
        amplitude = nodes[AMPLITUDE, i]
        j = i
        while j > 0 and nodes[RANGE, j - 1] > range_m:
            nodes[RANGE, j], nodes[AMPLITUDE, j] = nodes[RANGE, j - 1], nodes[AMPLITUDE, j - 1]
            j -= 1
        nodes[RANGE, j] = range_m
        nodes[AMPLITUDE, j] = amplitude


@inline_kernel
def _quick_exp(x: float) -> float:
    """Return the exponential of x <= 0 with a relative error of 1e-10, at least 1e-300.

    It has half the cost of a library call.
    """
    x = max(x, -690.0)
    shifted = x * 1.4426950408889634 + 6755399441055744.0  # its last bits hold the power of 2
    r = x - (shifted - 6755399441055744.0) * _LN2
    z = r * r
    series = (
        0.500000006765061 + r * 0.16666665869323083 + z * (0.041666295063920514 + r * 0.00833349702096706)
    )
    series += z * z * (0.0013944650820433332 + r * 0.00019790350590949283)
    bits = np.float64(1.0 + (r + z * series)).view(np.int64) + (
        np.float64(shifted).view(np.int64) << np.int64(52)
    )
    return np.int64(bits).view(np.float64)


@inline_kernel
def _waveform(nodes: F8, start: int, stop: int, x_m: float, sigma_m: float) -> _Light:
    """Return mean and variance of ranges of light relative to x_m, and the height of the waveform."""
    height = first = second = 0.0
    sharpness = -0.5 / (sigma_m * sigma_m)
    for node in range(start, stop):
        away_m = nodes[RANGE, node] - x_m
        light = nodes[AMPLITUDE, node] * _quick_exp(sharpness * away_m * away_m)
        height += light
        first += light * away_m
        second += light * away_m * away_m
    mean_m = first / height
    return mean_m, second / height - mean_m * mean_m, height


@inline_kernel
def _waveform_at_nodes(nodes: F8, start: int, stop: int, sigma_m: float) -> None:
    """Fill in `_waveform` at each node; two nodes share one exponential."""
    sharpness = -0.5 / (sigma_m * sigma_m)
    for b in range(start, stop):
        nodes[_HEIGHT, b] = nodes[_MEAN, b] = nodes[_VARIANCE, b] = 0.0
        for a in range(start, b):
            away_m = nodes[RANGE, a] - nodes[RANGE, b]
            pulse = _quick_exp(sharpness * away_m * away_m)
            light = nodes[AMPLITUDE, a] * pulse
            nodes[_HEIGHT, b] += light
            nodes[_MEAN, b] += light * away_m
            nodes[_VARIANCE, b] += light * away_m * away_m
            light = nodes[AMPLITUDE, b] * pulse
            nodes[_HEIGHT, a] += light
            nodes[_MEAN, a] -= light * away_m
            nodes[_VARIANCE, a] += light * away_m * away_m
        nodes[_HEIGHT, b] += nodes[AMPLITUDE, b]
    for node in range(start, stop):
        mean_m = nodes[_MEAN, node] / nodes[_HEIGHT, node]
        nodes[_MEAN, node] = mean_m
        nodes[_VARIANCE, node] = nodes[_VARIANCE, node] / nodes[_HEIGHT, node] - mean_m * mean_m


@inline_kernel
def _peaks_of_group(nodes: F8, start: int, stop: int, sigma_m: float, peaks: F8, found: int) -> int:
    """Find the peaks of a group of nodes, uphill from each node on both sides.

    The slope of the waveform has the sign of the mean in `_waveform`. A peak lies within sigma of a node,
    because the waveform is convex elsewhere.
    """
    if stop - start == 1:
        return _add_peak(peaks, found, nodes[RANGE, start], nodes[AMPLITUDE, start])
    _waveform_at_nodes(nodes, start, stop, sigma_m)
    a_m = nodes[RANGE, start]
    a = (nodes[_MEAN, start], nodes[_VARIANCE, start], nodes[_HEIGHT, start])
    rises = True  # also if all nodes have the same range
    for node in range(start + 1, stop):
        b_m = nodes[RANGE, node]
        b = (nodes[_MEAN, node], nodes[_VARIANCE, node], nodes[_HEIGHT, node])
        reach_m = min(b_m - a_m, sigma_m)
        has_one_peak = rises and b[0] <= 0.0 and b_m - a_m <= 2.0 * sigma_m
        if rises:
            end_m = b_m if has_one_peak else a_m + reach_m
            top_m, height = _climb(nodes, start, stop, sigma_m, a_m, end_m, has_one_peak, a)
            if height > 0.0:
                found = _add_peak(peaks, found, top_m, height)
        if b[0] <= 0.0 and not has_one_peak and b_m > a_m:
            top_m, height = _climb(nodes, start, stop, sigma_m, b_m, b_m - reach_m, b_m < a_m, b)
            if height > 0.0:
                found = _add_peak(peaks, found, top_m, height)
        a_m = b_m
        a = b
        rises = a[0] > 0.0 or (a[0] == 0.0 and a[1] > sigma_m * sigma_m)  # or the node is in a minimum
    return found


@inline_kernel
def _climb(
    nodes: F8, start: int, stop: int, sigma_m: float, x_m: float, end_m: float, closed: bool, light: _Light
) -> tuple[float, float]:
    """Return range and height of the peak between x_m, where the waveform rises towards end_m, and end_m.

    Without a peak the height is 0. Newton's method is applied to the mean, with bisection as fallback.
    `closed` is True if the waveform is known to fall at end_m; else this is evaluated when Newton's method
    fails. `light` is the waveform at x_m.
    """
    (mean_m, var_m2, height) = light
    low_m = min(x_m, end_m)
    high_m = max(x_m, end_m)
    uphill = mean_m > 0.0
    while True:
        curvature = 1.0 - var_m2 / (sigma_m * sigma_m)
        next_m = x_m + mean_m / curvature
        safe = curvature > 0.0 and low_m <= next_m <= high_m
        if not safe:
            next_m = 0.5 * (low_m + high_m) if closed else end_m
        if (safe or closed) and abs(next_m - x_m) < _LAST_STEP_M:
            return next_m, height
        x_m = next_m
        mean_m, var_m2, height = _waveform(nodes, start, stop, x_m, sigma_m)
        if (mean_m > 0.0) != uphill:
            closed = True
        elif x_m == end_m:
            return x_m, 0.0
        if mean_m > 0.0:
            low_m = x_m
        else:
            high_m = x_m


_REACH_SIGMAS = 5.0


@array_kernel
def find_source_surfaces(
    constants: DetectorConstants, first: int, rays: SubRays, distance_m: F4, surface: U4, share: F4
) -> None:
    """Fill the surface (k, L, 3) of the sub-ray that gives most of the light, and its share.

    The light is that at each distance before errors. The share (k, L, 3) is the fraction of the pulse's
    sub-rays that hit it at any range. Clutter and distance 0 have no surface.
    """
    count, range_m, met, cos_incidence, reflectance = rays
    stop = 0
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            start, stop = stop, stop + int(count[i, j])
            air_m = 0.0
            air = 0.0
            if constants.extinction_per_m > 0.0:
                air_m, air = clutter_echo(constants, first + i, j, start, stop, range_m)
            for column in range(3):
                at_m = np.float64(distance_m[i, j, column])
                surface[i, j, column] = NO_SURFACE
                brightest = air * _pulse(constants, air_m - at_m)
                for ray in range(start if at_m > 0.0 else stop, stop):
                    ray_m = np.float64(range_m[ray])
                    if abs(ray_m - at_m) < _REACH_SIGMAS * constants.sigma_m:
                        energy = np.float64(reflectance[met[ray]]) * cos_incidence[ray] / (stop - start)
                        light = amplitude_of(constants, energy, ray_m) * _pulse(constants, ray_m - at_m)
                        if light > brightest:
                            brightest = light
                            surface[i, j, column] = met[ray]
                on_surface = 0
                for ray in range(start if surface[i, j, column] != NO_SURFACE else stop, stop):
                    on_surface += met[ray] == surface[i, j, column]
                share[i, j, column] = on_surface / (stop - start)


@array_kernel
def _pulse(constants: DetectorConstants, away_m: float) -> float:
    away = away_m / constants.sigma_m
    return exp(-0.5 * away * away)
