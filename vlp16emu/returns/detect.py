"""From hits to what the detector reports.

Kernels make no arrays of their own, so numba need not count references (`_nrt=False`): a sixth of the time.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.random import Purpose, normal_pair
from vlp16emu.returns.detector import Detector
from vlp16emu.returns.echoes import (
    AMPLITUDE,
    COLUMNS,
    OPEN,
    RANGE,
    add_node,
    find_peaks,
    gather,
    lone_node,
)
from vlp16emu.returns.law import Law
from vlp16emu.returns.noise import range_sigma_m
from vlp16emu.returns.owners import find_owners
from vlp16emu.returns.reflectivity import reflectivity_byte
from vlp16emu.returns.weather import clutter_echo
from vlp16emu.types import Firings, Hits, Returns

__all__ = ["detect"]

_STRONGEST, _LAST, _SECOND = 0, 1, 2  # columns of Returns
_PEAKS_PER_NODE = 3  # at most: one at it, and one at either side
_CERTAIN_SIGMAS = 6.0  # noise does not reach so far: 2e-9
_DETECTION, _RANGE_NOISE = int(Purpose.DETECTION), int(Purpose.RANGE_NOISE)
_LANE_BITS = 16  # a random number's lane: the laser, and above it the echo's rank or column


def detect(
    firings: Firings, hits: Hits, surfaces: NDArray[np.void], detector: Detector, *, truth: bool
) -> Returns:
    """Turn the hits of each pulse into its returns.

    Echoes are the peaks of the pulse's waveform (`vlp16emu.returns.echoes`); within the resolution of a stronger
    one, one is lost. The strongest return has the highest peak, the last return is the farthest, and a lone echo is
    both (63-9243 Rev D, section 6.2). In strongest return nothing else is looked for: no last, no second.

    What is measured nearer than the least range is blanked: distance 0, with its reflectivity kept, as real units
    send it. A second strongest return of distance 0 and some reflectivity is such a one.

    Reflectivity is the height of the peak, corrected for range as the sensor does: of a target that fills the
    beam, reflectance times cosine of incidence in percent; of one that is partly hit, less.

    Parameters
    ----------
    surfaces : (m,) `SURFACE`, the window's table
    truth : whether to keep the surface of the sub-ray that gave most of the light of each return
    """
    shape = (*firings.t_ns.shape, 3)
    distance_m, reflectivity = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    most = int(hits.count.max(initial=1)) + 1  # the air's own echo is one more
    reflectance = np.ascontiguousarray(surfaces["reflectance"])
    room = np.empty((most, COLUMNS)), np.empty((_PEAKS_PER_NODE * most, COLUMNS)), np.empty(3, np.int64)
    rays = (hits.count, hits.range_m, hits.surface, hits.cos_incidence, reflectance)
    _detect(
        detector.law,
        firings.index,
        detector.range_bias_m,
        detector.drift_m(firings.t_ns[:, 0]),
        detector.gain,
        *rays,
        *room,
        distance_m,
        reflectivity,
    )
    if detector.no_return is not None:
        silent = ~(distance_m.any(axis=-1) | reflectivity.any(axis=-1))
        reflectivity[silent, :_SECOND] = np.broadcast_to(detector.no_return, silent.shape)[silent, None]
    if not truth:
        return Returns(firings, distance_m, reflectivity, None, None)
    surface = np.empty(shape, np.uint32)
    find_owners(detector.law, firings.index, *rays, distance_m, surface)
    return Returns(firings, distance_m, reflectivity, surface, surfaces)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _detect(
    law: Law,
    first: int,
    bias_m: NDArray[np.float64],
    drift_m: NDArray[np.float64],
    gain: NDArray[np.float64],
    count: NDArray[np.uint16],
    range_m: NDArray[np.float32],
    met: NDArray[np.uint32],
    cos_incidence: NDArray[np.float32],
    reflectance: NDArray[np.float32],
    nodes: NDArray[np.float64],
    peaks: NDArray[np.float64],
    chosen: NDArray[np.int64],
    distance_m: NDArray[np.float32],
    reflectivity: NDArray[np.uint8],
) -> None:
    """Fill the returns (k, L, 3), pulse by pulse; one node takes the short way."""
    stop = 0
    for i in range(count.shape[0]):
        for j in range(count.shape[1]):
            start, stop, n, error_m = stop, stop + int(count[i, j]), first + i, bias_m[j] + drift_m[i]
            lit, at_m, light = lone_node(law, start, stop, range_m, met, cos_incidence, reflectance)
            air_m, air = 0.0, 0.0
            if law.extinction_per_m > 0.0:
                air_m, air = clutter_echo(law, n, j, start, stop, range_m)
            if lit > 1 or air > 0.0:
                lit = gather(law, start, stop, range_m, met, cos_incidence, reflectance, nodes)
                if air > 0.0:
                    lit = add_node(nodes, lit, air_m, air)
                _choose(law, n, j, peaks, find_peaks(nodes, lit, law.sigma_m, peaks), chosen)
                _write(law, n, i, j, error_m, gain[j], peaks, chosen, distance_m, reflectivity)
            elif lit == 1 and _is_seen(law, n, j, at_m, light):
                measured_m, code = _measure(law, n, j, at_m, light, error_m, gain[j])
                for column in range(_LAST if law.strongest_only else _SECOND):
                    distance_m[i, j, column], reflectivity[i, j, column] = measured_m, code


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _is_seen(law: Law, n: int, lane: int, range_m: float, amplitude: float) -> bool:
    """Whether an echo is within reach, and its peak with the noise upon it above the threshold."""
    excess, certain = amplitude - law.threshold, _CERTAIN_SIGMAS * law.amplitude_noise
    if -certain < excess < certain:
        excess += law.amplitude_noise * normal_pair(law.seed, _DETECTION, n, lane)[0]
    return excess >= 0.0 and range_m <= law.max_range_m


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _measure(
    law: Law, n: int, lane: int, range_m: float, amplitude: float, error_m: float, gain: float
) -> tuple[np.float32, np.uint8]:
    """Distance and reflectivity as the unit reads them; distance 0 where that is out of its limits."""
    reflectance = amplitude * range_m * range_m
    measured_m, counts = range_m + error_m, 0.0
    if law.range_noise_m > 0.0 or law.reflectivity_noise > 0.0:
        drawn, other = normal_pair(law.seed, _RANGE_NOISE, n, lane)
        measured_m += drawn * range_sigma_m(law, reflectance, amplitude)
        counts = other * law.reflectivity_noise
    if not law.min_range_m <= measured_m <= law.max_range_m:
        measured_m = 0.0
    return np.float32(measured_m), reflectivity_byte(100.0 * reflectance, gain, counts)


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _choose(
    law: Law, n: int, laser: int, peaks: NDArray[np.float64], found: int, chosen: NDArray[np.int64]
) -> None:
    """Tell which peaks are the strongest, last and second strongest return, -1 where there is none."""
    chosen[:] = -1
    for rank in range(found):
        best = -1
        for peak in range(found):
            if peaks[peak, OPEN] > 0.0 and (best < 0 or peaks[peak, OPEN] > peaks[best, OPEN]):
                best = peak
        if best < 0:
            return
        peaks[best, OPEN] = 0.0
        if not _is_seen(law, n, laser | rank << _LANE_BITS, peaks[best, RANGE], peaks[best, AMPLITUDE]):
            continue
        if chosen[_STRONGEST] < 0:
            chosen[_STRONGEST] = best
            if law.strongest_only:
                return
        elif chosen[_SECOND] < 0:
            chosen[_SECOND] = best
        if chosen[_LAST] < 0 or peaks[best, RANGE] > peaks[chosen[_LAST], RANGE]:
            chosen[_LAST] = best
        for peak in range(found):
            if abs(peaks[peak, RANGE] - peaks[best, RANGE]) < law.resolution_m:
                peaks[peak, OPEN] = 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _write(
    law: Law,
    n: int,
    i: int,
    j: int,
    error_m: float,
    gain: float,
    peaks: NDArray[np.float64],
    chosen: NDArray[np.int64],
    distance_m: NDArray[np.float32],
    reflectivity: NDArray[np.uint8],
) -> None:
    """Measure the chosen peaks, each once."""
    for column in range(3):
        peak = chosen[column]
        if column > 0 and peak == chosen[column - 1]:
            distance_m[i, j, column] = distance_m[i, j, column - 1]
            reflectivity[i, j, column] = reflectivity[i, j, column - 1]
        elif peak >= 0:
            distance_m[i, j, column], reflectivity[i, j, column] = _measure(
                law, n, j | column << _LANE_BITS, peaks[peak, RANGE], peaks[peak, AMPLITUDE], error_m, gain
            )
