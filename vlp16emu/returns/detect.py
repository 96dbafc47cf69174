"""Returns from hits.

Kernels allocate no arrays, so numba need not count references (`_nrt=False`): this saves a sixth of the time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.kernels.compiler import inline_kernel, kernel
from vlp16emu.once import once_per_array
from vlp16emu.random import Purpose, box_muller, normal_pair, normal_pairs, uniform_pair
from vlp16emu.returns.clutter import clutter_echo
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.returns.echoes import (
    AMPLITUDE,
    COLUMNS,
    OPEN,
    RANGE,
    SubRays,
    brightest_group,
    find_peaks,
    find_source_surfaces,
    gather,
    highest_peak,
)
from vlp16emu.returns.lost import AREA, MEAN_CODE, STATE, UNEVENNESS, Sight, lose, raised_code
from vlp16emu.returns.noise import (
    NO_RETURN_KNOTS,
    REFLECTIVITY_TAIL,
    range_sigma_m,
    reflectivity_byte,
    with_heavy_tails,
)
from vlp16emu.returns.settings import DetectorConstants
from vlp16emu.returns.strength import at_range, change_parities, count_of, excess_m, strength, with_parity
from vlp16emu.sensor.laws import law, span
from vlp16emu.trig import ZERO
from vlp16emu.types import F4, F8, I8, U1, U4, Firings, Hits, PlantPart, Returns, Semantic

_STRONGEST = 0  # columns of Returns
_LAST = 1
_SECOND = 2
_PEAKS_PER_NODE = 3  # at most: one at the node, and one on each side
_CERTAIN_SIGMAS = 6.0  # noise does not exceed this: probability 2e-9
_DETECTION = ZERO + Purpose.DETECTION
_RANGE_NOISE = ZERO + Purpose.RANGE_NOISE
_MOST_NO_RETURN = law("no_return.most")
_UNSTEADY = law("range.unsteady")
_EVEN_CHANGE = law("range.even_change")
_BLIND_M, _SEEN_FROM_M = span("near.overlap_m")
_UNSHIFTED_CODE = 40.0  # code at which reflectivity does not change the range
_Pair = tuple[float, float]
_Laser = tuple[float, float, float, U1, F8, float, U1, F8, float, float]
"""Range error of a laser in metres, its factor on the white range noise, its gain, codes as in `sent_codes`,
its tables, its greatest code and the unit's counts as in `Strength`, 1 if its parities are changed, and the
mean change of code of its last pulses."""
_LANE_BITS = 16  # lane of a random number: the laser in the lower bits, rank or column of the echo above them


def detect(
    firings: Firings,
    hits: Hits,
    surfaces: NDArray[np.void],
    detector: UnitDetector,
    *,
    truth: bool,
    block: int | None = None,
) -> Returns:
    """Return the returns of each pulse from its hits.

    Echoes are the peaks of the pulse's waveform (`vlp16emu.returns.echoes`); an echo within the resolution of
    a stronger one is lost. The strongest return has the highest peak, the last return is the farthest, and a
    single echo is both (63-9243 Rev D, section 6.2). In strongest return mode the last and second returns are
    not searched.

    An echo below the least range counts only if there is no other: what stands in front of the lens takes
    light away, and hides nothing else. It is blanked: distance 0, with the reflectivity kept, as real units
    send it. A second strongest return of distance 0 and nonzero reflectivity is such an echo, by noise.

    Reflectivity is the height of the peak, corrected for range as the sensor does: for a target that fills
    the beam, reflectance times cosine of incidence in percent; less for a target that is partly hit.

    Parameters
    ----------
    surfaces : (m,) `SURFACE`, the window's table
    truth : True to keep the range of each return before errors, and the surface of the sub-ray that gave most
        of its light
    block : firing sequences after which the state of each laser is reset, so that the result does not depend
        on how a run is divided; None for all of them
    """
    shape = (*firings.t_ns.shape, 3)
    constants = detector.constants
    first = firings.index
    lasers = shape[1]
    distance_m = np.zeros(shape, np.float32)
    reflectivity = np.zeros(shape, np.uint8)
    exact_m = np.zeros(shape if truth else (0, 0, 3), np.float32)
    most_nodes = int(hits.count.max(initial=1)) + 1  # the air's own echo is one more
    peaks = np.empty((COLUMNS, _PEAKS_PER_NODE * most_nodes))
    of_lasers = np.zeros((3, lasers)), np.zeros((lasers, STATE)), np.zeros(lasers)
    room = np.empty((COLUMNS, most_nodes)), peaks, np.empty(3, np.int64), *of_lasers
    reflectance, sheet = _columns_of(surfaces)
    rays = SubRays(hits.count, hits.range_m, hits.surface, hits.cos_incidence, reflectance)
    errors = _Errors(
        detector.range_bias_m,
        detector.range_noise_share,
        detector.range_beat_m,
        detector.drift_m(firings.t_ns[:, 0]),
        detector.gain,
        detector.codes,
        np.zeros(lasers) if detector.no_return is None else detector.no_return,
        sheet,
        detector.near_lost,
        *detector.strength,
    )
    sight = Sight(firings.origin_m, firings.direction)
    block = block or max(shape[0], 1)
    _detect(constants, first, block, errors, (rays, sight), room, distance_m, reflectivity, exact_m)
    if detector.no_return is not None:
        place = firings.azimuth_deg[:, 0] % 360.0 * (NO_RETURN_KNOTS / 360.0)
        _fill_no_returns(
            constants, detector.no_return, detector.multiples, place, first, block, distance_m, reflectivity
        )
    if not truth:
        return Returns(firings, distance_m, reflectivity, mode=detector.mode)
    surface = np.empty(shape, np.uint32)
    share = np.empty(shape, np.float32)
    source_m = np.where(distance_m > 0.0, exact_m, np.float32(0.0))
    find_source_surfaces(constants, first, rays, source_m, surface, share)
    return Returns(firings, distance_m, reflectivity, surface, surfaces, exact_m, share, detector.mode)


@once_per_array
def _columns_of(surfaces: NDArray[np.void]) -> tuple[F4, U4]:
    """Return reflectance and sheet number (m,) of each surface; one reflectance if there is none.

    All tiles of the ground are one sheet without gaps; plants have 0.
    """
    number = np.where(surfaces["semantic"] == Semantic.GROUND, 1, np.arange(2, len(surfaces) + 2))
    sheet = np.where(surfaces["part"] == PlantPart.NONE, number, 0).astype(np.uint32)
    reflectance = surfaces["reflectance"].copy() if len(surfaces) else np.zeros(1, np.float32)
    return reflectance, sheet


class _Errors(NamedTuple):
    """Properties of a unit, as in `UnitDetector`.

    `drift_m` (k,) by firing sequence, `sheet` (m,) by surface.
    """

    bias_m: F8
    noise_share: F8
    beat_m: F8
    drift_m: F8
    gain: F8
    codes: U1
    no_return: F8
    sheet: U4
    near_lost: F8
    by_range: F8
    top: F8
    parity: U1
    counts: F8
    changed: F8


@kernel
def _detect(
    constants: DetectorConstants,
    first: int,
    block: int,
    errors: _Errors,
    pulses: tuple[SubRays, Sight],
    room: tuple[F8, F8, I8, F8, F8, F8],
    distance_m: F4,
    reflectivity: U1,
    exact_m: F4,
) -> None:
    """Fill the returns (k, L, 3), pulse by pulse; pulses of one node skip the search for peaks.

    Parameters
    ----------
    block : as in `detect`; the first block begins with row 0
    room : scratch arrays for nodes, peaks, chosen peaks, what `lose` takes of each pulse, its state, and
        lasers with changed parities
    exact_m : output, ranges before errors; may be empty
    """
    nodes, peaks, chosen, noise, before, changed = room
    rays, _ = pulses
    stop = ZERO
    keeps_exact = exact_m.shape[0] > 0
    lasers = rays.counts.shape[1]
    columns = _LAST if constants.strongest_only else _SECOND  # columns that a single echo fills
    for i in range(rays.counts.shape[0]):
        n = first + i
        slot = 24 * n % 5
        if i % block == 0:
            _begin_block(before)
        if _draws_noise(constants):
            normal_pairs(constants.seed, _RANGE_NOISE, n, noise[0], noise[1])
        if errors.parity.shape[1] > 0:
            change_parities(constants.seed, n, i == 0, errors.changed, changed)
        first_ray = stop
        for j in range(lasers):
            start, stop = stop, stop + int(rays.counts[i, j])
            error_m = errors.bias_m[j] + errors.drift_m[i] + errors.beat_m[(slot + j) % 5]
            laser_errors = (
                error_m,
                errors.noise_share[j],
                errors.gain[j],
                errors.codes[j],
                errors.by_range[j],
                errors.top[j],
                errors.parity[j],
                errors.counts,
                changed[j],
                before[j, UNEVENNESS],
            )
            lit = _gather_with_air(constants, n, j, rays, start, stop, nodes)
            lit = _without_near(nodes, lit, constants.min_range_m - error_m)
            at_m, light = _only_echo(constants, n, j, nodes, lit, peaks)
            if light > 0.0 and _is_seen(constants, n, j, at_m, light):
                measured = _measure(constants, (noise[0, j], noise[1, j]), at_m, light, laser_errors)
                for column in range(columns):
                    distance_m[i, j, column], reflectivity[i, j, column] = measured
                    if keeps_exact:
                        exact_m[i, j, column] = at_m
            elif lit > 1 and light >= 0.0:  # also if the highest peak is not detected: another may be
                _choose(constants, n, j, peaks, find_peaks(nodes, lit, constants.sigma_m, peaks), chosen)
                _write(constants, n, j, laser_errors, peaks, chosen, distance_m[i, j], reflectivity[i, j])
                if chosen[_STRONGEST] >= 0:
                    at_m = peaks[RANGE, chosen[_STRONGEST]]
                for column in range(3 if keeps_exact else 0):
                    if chosen[column] >= 0:
                        exact_m[i, j, column] = peaks[RANGE, chosen[column]]
            noise[2, j] = at_m
        if constants.lost.step + constants.lost.dark > 0.0:
            dual = not constants.strongest_only
            of_lasers = errors.near_lost, errors.no_return
            unit = constants.seed, dual, errors.sheet, *of_lasers, constants.min_range_m
            lose(constants.lost, unit, pulses, i, first_ray, noise, before, distance_m[i], reflectivity[i])


@inline_kernel
def _begin_block(before: F8) -> None:
    """Set the state of all lasers, as in `lose`, to that before the first pulse of a block."""
    before[:] = 0.0
    before[:, MEAN_CODE] = -1.0
    before[:, AREA] = np.inf


@inline_kernel
def _gather_with_air(
    constants: DetectorConstants, n: int, laser: int, rays: SubRays, start: int, stop: int, nodes: F8
) -> int:
    """Fill the nodes of pulse (n, laser) from its sub-rays and from the air; return their number."""
    lit = gather(constants, rays, start, stop, nodes)
    if constants.extinction_per_m > 0.0:
        air_m, air = clutter_echo(constants, n, laser, start, stop, rays.range_m)
        if air > 0.0:
            nodes[RANGE, lit] = air_m
            nodes[AMPLITUDE, lit] = air
            lit += 1
    return lit


@inline_kernel
def _without_near(nodes: F8, lit: int, from_m: float) -> int:
    """Remove the nodes nearer than a range, unless all are; return the number of nodes."""
    if lit < 2:  # most pulses
        return lit
    far = 0
    for node in range(lit):
        far += nodes[RANGE, node] >= from_m
    if not 0 < far < lit:
        return lit
    left = 0
    for node in range(lit):
        range_m = nodes[RANGE, node]
        amplitude = nodes[AMPLITUDE, node]
        nodes[RANGE, left] = range_m
        nodes[AMPLITUDE, left] = amplitude
        left += range_m >= from_m
    return far


@kernel
def _fill_no_returns(
    constants: DetectorConstants,
    no_return: F8,
    knots: F8,
    place: F8,
    first: int,
    block: int,
    distance_m: F4,
    reflectivity: U1,
) -> None:
    """Fill in the reflectivity of pulses without a return: a constant of the laser, or a multiple of it.

    Near a return in the same block it may be raised. Elsewhere the multiple is interpolated between knots
    (m, L) at `place` (k,), in knots.
    """
    rates = constants.lost
    key = constants.seed
    for i in range(distance_m.shape[0]):
        knot = min(int(place[i]), NO_RETURN_KNOTS - 1)
        fraction = place[i] % 1.0
        for j in range(distance_m.shape[1]):
            if distance_m[i, j, 0] > 0.0:  # nearly all
                continue
            silent = True
            for column in range(3):
                silent &= distance_m[i, j, column] == 0.0 and reflectivity[i, j, column] == 0
            if silent:
                code = no_return[j]
                higher = -1.0
                if rates.raise_code > 0.0:
                    rows = i, i // block * block, min((i // block + 1) * block, distance_m.shape[0])
                    higher = raised_code(rates, (key, first, j), rows, no_return[j], distance_m, reflectivity)
                if higher < 0.0 and knots.shape[0] > 0:
                    wandered = knots[knot, j] + fraction * (knots[knot + 1, j] - knots[knot, j])
                    code = min(code * max(1.0, np.floor(wandered)), _MOST_NO_RETURN)
                reflectivity[i, j, :_SECOND] = np.uint8(higher if higher > 0.0 else code)


@inline_kernel
def _draws_noise(constants: DetectorConstants) -> bool:
    """Return True if the errors of a pulse, or its loss, need random numbers."""
    reflectivity_noise = constants.reflectivity_noise + constants.reflectivity_noise_share
    losses = constants.lost.step + constants.lost.dark
    return constants.range_noise_m + reflectivity_noise + losses > 0.0


@inline_kernel
def _only_echo(
    constants: DetectorConstants, n: int, laser: int, nodes: F8, lit: int, peaks: F8
) -> tuple[float, float]:
    """Return range and amplitude of a single node, or of the highest peak in strongest return mode.

    The amplitude is 0 if there may be more echoes, or if the highest peak is not found this way; -1 if no
    echo is detected.
    """
    if lit == 0:
        return 0.0, -1.0
    if lit == 1:
        return nodes[RANGE, 0], nodes[AMPLITUDE, 0]
    first, last, brightest, second = brightest_group(nodes, lit, constants.sigma_m)
    if _none_is_seen(constants, n, laser, brightest, lit):
        return 0.0, -1.0
    if constants.strongest_only and brightest > constants.threshold:
        range_m, amplitude = highest_peak(nodes, first, last, constants.sigma_m, peaks)
        if amplitude > second:
            return range_m, amplitude
    return 0.0, 0.0


@inline_kernel
def _is_seen(constants: DetectorConstants, n: int, lane: int, range_m: float, amplitude: float) -> bool:
    """Return True if an echo is within range and its peak, with noise, is above the threshold."""
    excess = amplitude - constants.threshold
    certain = _CERTAIN_SIGMAS * constants.amplitude_noise
    if -certain < excess < certain and range_m <= constants.max_range_m:
        a, b = uniform_pair(constants.seed, _DETECTION, n, lane)
        if _falls_short(constants, a, excess):
            return False
        excess += constants.amplitude_noise * box_muller(a, b)[0]
    return excess >= 0.0 and range_m <= constants.max_range_m


@inline_kernel
def _falls_short(constants: DetectorConstants, a: float, excess: float) -> bool:
    """Return True if noise from the uniform number a stays below the threshold for any second number.

    The radius of a normal pair is below t if 1 - a > exp(-t**2 / 2); the test uses an upper bound of this
    exponential, so it needs no logarithm.
    """
    t = excess / constants.amplitude_noise
    x = 0.5 * t * t
    return excess < 0.0 and (1.0 - a) * (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0)))) > 1.0


@inline_kernel
def _none_is_seen(constants: DetectorConstants, n: int, laser: int, brightest: float, count: int) -> bool:
    """Return True if none of up to `count` echoes with amplitudes up to `brightest` is detected.

    Most faint pulses end here.
    """
    excess = brightest - constants.threshold
    if excess >= 0.0:
        return False
    if excess > -_CERTAIN_SIGMAS * constants.amplitude_noise:
        for rank in range(count):
            a, _ = uniform_pair(constants.seed, _DETECTION, n, laser | rank << _LANE_BITS)
            if not _falls_short(constants, a, excess):
                return False
    return True


@inline_kernel
def _white_m(constants: DetectorConstants, laser: _Laser, reflectance: float, amplitude: float) -> float:
    """Return the white range noise of an echo, one sigma; larger on surfaces of uneven brightness."""
    uneven = _UNSTEADY * max(laser[9] - _EVEN_CHANGE, 0.0)
    return laser[1] * range_sigma_m(constants, reflectance, amplitude, uneven)


@inline_kernel
def _measure(
    constants: DetectorConstants, noise: _Pair, range_m: float, amplitude: float, laser_errors: _Laser
) -> tuple[np.float32, np.uint8]:
    """Return measured distance and reflectivity.

    The distance is 0 below the least range, where the receiver sees less of the light the nearer it is; both
    are 0 where it sees none, and beyond the greatest range.
    """
    (range_noise, other_noise) = noise
    (error_m, _, own_gain, codes, by_range, top, parity, counts_of_code, changed, _) = laser_errors
    reflectance = amplitude * range_m * range_m
    shown = min(100.0 * reflectance, 100.0)
    measured_m = range_m + error_m + constants.range_walk_m * (shown - _UNSHIFTED_CODE)
    sigma = constants.reflectivity_noise + constants.reflectivity_noise_share * shown
    if constants.heavy_tails:
        other_noise = with_heavy_tails(other_noise, REFLECTIVITY_TAIL)
    counts = sigma * other_noise
    eighths, gain_at_range = at_range(by_range, range_m)
    gain = own_gain * gain_at_range
    percent = 100.0 * reflectance
    if range_m < _SEEN_FROM_M:
        seen = (range_m - _BLIND_M) * (1.0 / (_SEEN_FROM_M - _BLIND_M))
        if seen <= 0.0:
            return np.float32(0.0), np.uint8(0)
        percent *= seen
    code = max(percent * gain + counts, 0.0)
    exact = strength(min(code, 100.0), eighths)
    if constants.range_noise_m > 0.0:
        measured_m += range_noise * _white_m(constants, laser_errors, reflectance, amplitude)
    if measured_m > constants.max_range_m:
        return np.float32(0.0), np.uint8(0)
    if not measured_m >= constants.min_range_m:
        measured_m = 0.0
    elif eighths > 0.0:
        measured_m = min(measured_m + excess_m(measured_m, exact), constants.max_range_m)
    if parity.shape[0] > 0 and measured_m > 0.0:
        count = count_of(counts_of_code, code)
        measured_m = with_parity(parity, changed, count, measured_m, constants.max_range_m)
    scale = eighths, top
    return np.float32(measured_m), reflectivity_byte(percent, gain, counts, exact, scale, codes)


@kernel
def _choose(constants: DetectorConstants, n: int, laser: int, peaks: F8, found: int, chosen: I8) -> None:
    """Find the peaks of the strongest, last and second strongest return; -1 for none."""
    chosen[:] = -1
    for rank in range(found):
        best = -1
        for peak in range(found):
            if peaks[OPEN, peak] > 0.0 and (best < 0 or peaks[OPEN, peak] > peaks[OPEN, best]):
                best = peak
        if best < 0:
            return
        peaks[OPEN, best] = 0.0
        if not _is_seen(constants, n, laser | rank << _LANE_BITS, peaks[RANGE, best], peaks[AMPLITUDE, best]):
            continue
        if chosen[_STRONGEST] < 0:
            chosen[_STRONGEST] = best
            if constants.strongest_only:
                return
        elif chosen[_SECOND] < 0:
            chosen[_SECOND] = best
        if chosen[_LAST] < 0 or peaks[RANGE, best] > peaks[RANGE, chosen[_LAST]]:
            chosen[_LAST] = best
        for peak in range(found):
            if abs(peaks[RANGE, peak] - peaks[RANGE, best]) < constants.resolution_m:
                peaks[OPEN, peak] = 0.0


@kernel
def _leave_out(peaks: F8, chosen: I8, lost: int) -> None:
    """Remove a lost peak from the chosen ones, and let others take its columns."""
    for column in range(3):
        if chosen[column] == lost:
            chosen[column] = -1
    if chosen[_STRONGEST] < 0:
        chosen[_STRONGEST] = chosen[_SECOND]
        chosen[_SECOND] = -1
    if chosen[_LAST] < 0:
        first = chosen[_STRONGEST]
        second = chosen[_SECOND]
        is_second = second >= 0 and peaks[RANGE, second] > peaks[RANGE, first]
        chosen[_LAST] = second if is_second else first


@kernel
def _write(
    constants: DetectorConstants,
    n: int,
    j: int,
    laser_errors: _Laser,
    peaks: F8,
    chosen: I8,
    distance_m: F4,
    reflectivity: U1,
) -> None:
    """Fill the returns (3,) of a pulse.

    Each chosen peak is measured once, and dropped if measured beyond `max_range_m`.
    """
    for column in range(3):
        peak = chosen[column]
        if peak < 0 or (column > 0 and peak == chosen[column - 1]):  # an echo in two columns has one error
            continue
        at_m = peaks[RANGE, peak]
        light = peaks[AMPLITUDE, peak]
        shown = min(100.0 * light * at_m * at_m, 100.0)
        error_m = laser_errors[0] + constants.range_walk_m * (shown - _UNSHIFTED_CODE)
        sigma_m = 0.0
        if constants.range_noise_m > 0.0:
            sigma_m = _white_m(constants, laser_errors, light * at_m * at_m, light)
        # Noise may put it beyond the greatest range.
        if at_m + error_m + 2.0 * _CERTAIN_SIGMAS * sigma_m > constants.max_range_m:
            drawn, _ = normal_pair(constants.seed, _RANGE_NOISE, n, j | column << _LANE_BITS)
            if at_m + error_m + drawn * sigma_m > constants.max_range_m:
                _leave_out(peaks, chosen, peak)
    for column in range(3):
        peak = chosen[column]
        if column > 0 and peak == chosen[column - 1]:
            distance_m[column] = distance_m[column - 1]
            reflectivity[column] = reflectivity[column - 1]
        elif peak >= 0:
            pair = normal_pair(constants.seed, _RANGE_NOISE, n, j | column << _LANE_BITS)
            at_m = peaks[RANGE, peak]
            light = peaks[AMPLITUDE, peak]
            distance_m[column], reflectivity[column] = _measure(constants, pair, at_m, light, laser_errors)
