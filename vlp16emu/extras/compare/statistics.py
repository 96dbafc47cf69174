"""Statistics of a unit, from its packets alone; most depend little on what stood before it."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.surfaces import Statistics, codes, gains, range_noise, reflectivity_noise, stretches_of
from vlp16emu.packets.layout import AZIMUTH_CODES
from vlp16emu.units import US_NS

_LEAST, _LEAST_EDGES, _LEAST_PACKETS = 500, 15, 250
"""Codes of a laser, records at edges and packets, from which on a statistic is worth its name."""
_FLAT_LSB, _EQUAL_LSB, _STEPS_LSB = 20, 15, (150, 700)
"""Most change of range on either side of a record, and across it, to be of one surface; least steps that are near and far."""
_CODE_STEP = 20
_RAISED = 1.5  # code of a no-return over the commonest of its laser, from which on it is raised
_DARK, _BRIGHT = (0, 5), (40, 100)  # codes of returns beside which raised no-returns are counted
_TICK_US, _PHASES = 1.2, 48
"""Period of the clock at whose ticks the encoder is read, on four units; phases that are tried."""
_LEAST_STEP_CDEG, _AT_RPM = 38, (590.0, 610.0)  # least step between two blocks on real units at 600 rpm


def statistics_of(sequences: Sequences) -> Statistics:
    """Find all statistics that a capture has, by name; what it has too little of is left out."""
    stretches = stretches_of(sequences)
    every = {} if stretches is None else range_noise(stretches) | reflectivity_noise(stretches)
    for of in (codes, gains, lost_records, no_returns, dual_returns, rotation, _residues, _clocks):
        every |= of(sequences)
    return {name: float(value) for name, value in every.items() if math.isfinite(value)}


def lost_records(sequences: Sequences) -> Statistics:
    """Share of records without a return between two pairs of returns of one laser, by what changes across it.

    Two equal ranges; steps of 0.3 to 1.4 m, and of more; 20 codes of reflectivity and more on one surface.
    """
    d, r = sequences.distance_lsb, sequences.reflectivity
    before, a, middle, c, after = (d[i : len(d) - 4 + i] for i in range(5))
    in_row = (sequences.number[4:] - sequences.number[:-4] == 4)[:, None]
    is_edge = in_row & (np.minimum(np.minimum(before, a), np.minimum(c, after)) > 0)
    is_edge &= (np.abs(a - before) < _FLAT_LSB) & (np.abs(c - after) < _FLAT_LSB)
    step_lsb, (near, far) = np.abs(c - a), _STEPS_LSB
    same = is_edge & (step_lsb < _EQUAL_LSB)
    places = {
        "lost.on_a_surface": same,
        "lost.at_steps_below_1.4_m": is_edge & (step_lsb >= near) & (step_lsb < far),
        "lost.at_steps_above_1.4_m": is_edge & (step_lsb >= far),
        "lost.at_code_steps": same & (np.abs(r[3:-1] - r[1:-3]) >= _CODE_STEP),
    }
    return {name: float((middle[at] == 0).mean()) for name, at in places.items() if at.sum() >= _LEAST_EDGES}


def no_returns(sequences: Sequences) -> Statistics:
    """Codes of records without a return: what they carry, and where they are raised above that of their laser."""
    silent, r = sequences.distance_lsb == 0, sequences.reflectivity
    both = silent[1:] & silent[:-1]
    if both.sum() < _LEAST:
        return {}
    out = {
        "no_return.above_0": (r[silent] > 0).mean(),
        "no_return.equal": (r[1:] == r[:-1])[both].mean(),
        "no_return.mean": r[silent].mean(),
    }
    return out | _raised(silent, r)


def commonest(silent: NDArray[np.bool_], r: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the commonest code (16,) of each laser's records without a return, 0 where there are too few."""
    each = [column[of] for column, of in zip(r.T, silent.T, strict=True)]
    return np.array([np.bincount(own).argmax() if len(own) >= _LEAST_EDGES else 0 for own in each])


def _raised(silent: NDArray[np.bool_], r: NDArray[np.int64]) -> Statistics:
    """Share of raised codes beside bright returns less that beside dark ones, and of raised runs that are one record long."""
    mode = commonest(silent, r)
    raised = silent & (r > _RAISED * mode) & (mode > 0)
    neighbour = np.maximum(*(np.where(silent[side], -1, r[side]) for side in (slice(None, -2), slice(2, None))))
    beside, shares = silent[1:-1] & (neighbour >= 0), []
    for low, high in (_DARK, _BRIGHT):
        at = silent[1:-1] & (neighbour >= low) & (neighbour < high) & (mode > 0)
        shares.append(raised[1:-1][at].mean() if at.sum() >= _LEAST_EDGES else np.nan)
    begins = ~silent[:-2] & raised[1:-1]
    return {
        "no_return.above_100": (r[1:-1][beside] > 100).mean() if beside.sum() >= _LEAST_EDGES else np.nan,
        "no_return.raised_beside_bright": shares[1] - shares[0],
        "no_return.raised_once": (~raised[2:])[begins].mean() if begins.sum() >= _LEAST_EDGES else np.nan,
    }


def dual_returns(sequences: Sequences) -> Statistics:
    """Share of pairs with one return where the other block has none, and of unequal codes in pairs without a return."""
    if sequences.last is None:
        return {}
    (d_last, r_last), d, r = sequences.last, sequences.distance_lsb, sequences.reflectivity
    none = (d == 0) & (d_last == 0)
    unequal = (r != r_last)[none].mean() if none.any() else np.nan
    return {"dual.one_without": ((d == 0) ^ (d_last == 0)).mean(), "dual.unequal_no_returns": unequal}


class Turning(NamedTuple):
    """Errors of the encoder against an even turn that changes its speed evenly."""

    once_cdeg: complex  # amplitudes of the sine (imaginary) and the cosine (real) of the azimuth
    twice_cdeg: complex
    rest_cdeg: NDArray[np.float64]  # (b,) what is left


def turning_of(sequences: Sequences) -> Turning:
    """Find speed and errors that repeat with the turn."""
    azimuth, block = sequences.azimuth_cdeg, sequences.block
    span = block / block[-1]
    turn = 2.0 * np.pi * azimuth / AZIMUTH_CODES
    waves = [wave(k * turn) for k in (1, 2) for wave in (np.cos, np.sin)]
    basis = np.stack([np.ones(len(block)), span, span**2, *waves], axis=1)
    found, *_ = np.linalg.lstsq(basis, azimuth.astype(float), rcond=None)
    return Turning(complex(*found[3:5]), complex(*found[5:7]), azimuth - basis @ found)


def local(series: NDArray[Any]) -> NDArray[Any]:
    """Take a series without its ends, less the mean of nine around each value."""
    return np.asarray(series[9:-9] - np.convolve(series, np.ones(9) / 9, "same")[9:-9])


def tick_of(sequences: Sequences, rest_cdeg: NDArray[np.float64]) -> float:
    """Return the height in us of the sawtooth of a reading that is as old as the last tick of a clock.

    It is the one that explains most of the residuals of the azimuth, by least squares for each of its phases.
    """
    since_us, packet = (sequences.clock_ns - sequences.clock_ns[0]) / US_NS, sequences.packet
    per_packet_us, first_us = np.polyfit(packet, since_us, 1)
    # Stamps are cut to whole microseconds: half of one is missing in the mean.
    per_block_us = per_packet_us * len(packet) / len(sequences.block)
    clock_us = sequences.clock_ns[0] / US_NS + first_us + 0.5 + sequences.block * per_block_us
    rest, speed_cdeg_us = local(rest_cdeg), sequences.rpm * AZIMUTH_CODES / 60e6
    best = 0.0, 0.0
    for at_us in np.arange(_PHASES) * (_TICK_US / _PHASES):
        wave = local(-(((clock_us - at_us) / _TICK_US) % 1.0))
        product, square = wave @ rest, wave @ wave
        if (explained := product**2 / square) > best[0]:
            best = explained, float(product / square / speed_cdeg_us)
    return best[1]


def rotation(sequences: Sequences) -> Statistics:
    """Speed, errors that repeat with the turn, the tick, and the noise of readings."""
    azimuth, block = sequences.azimuth_cdeg, sequences.block
    rpm, (once, twice, rest) = sequences.rpm, turning_of(sequences)
    step = np.diff(azimuth)[np.diff(block) == 1]
    part = step.mean() % 1.0
    out = {
        "rotation.speed_off_percent": abs(rpm / (60 * round(rpm / 60)) - 1) * 100,
        "rotation.once_cdeg": abs(once),
        "rotation.twice_cdeg": abs(twice),
        "rotation.tick_us": tick_of(sequences, rest),
        "rotation.reading_cdeg": local(rest).std(),
        "rotation.excess_variance": step.var() - part * (1 - part),
        "rotation.rarest_of_five": (np.bincount(azimuth % 5, minlength=5) / len(azimuth)).min(),
        "rotation.uneven_of_twenty": (20.0 * np.bincount(azimuth % 20, minlength=20) / len(azimuth)).std(),
    }
    if _AT_RPM[0] < rpm < _AT_RPM[1]:
        out["rotation.short_steps"] = (step < _LEAST_STEP_CDEG).mean()
    turns = (azimuth - azimuth[0]) // AZIMUTH_CODES
    if turns[-1] >= 3:
        starts = np.searchsorted(turns, np.arange(turns[-1] + 1))
        each = np.diff(azimuth[starts]) / np.diff(block[starts])
        out["rotation.speed_sd_percent"] = (each / each.mean()).std() * 100
    return out


def _residues(sequences: Sequences) -> Statistics:
    d = sequences.distance_lsb
    odd = [(codes[codes > 0] % 2).mean() for codes in d.T if (codes > 0).sum() >= _LEAST]
    if len(odd) < 5:
        return {}
    by_four = np.bincount(d[d > 0] % 4, minlength=4) / (d > 0).sum()
    return {"residue.odd_spread": np.std(odd), "residue.mod_4": np.abs(by_four - 0.25).max()}


def _clocks(sequences: Sequences) -> Statistics:
    """Rates of the sensor's clock against its firings and of the host's against it, and how evenly packets arrive."""
    clock_us, stamp_us = ((of - of[0]) / US_NS for of in (sequences.clock_ns, sequences.stamp_ns))
    arrival_us = (np.diff(stamp_us) - np.diff(clock_us)).std()
    if len(clock_us) < _LEAST_PACKETS:
        return {"clock.arrival_us": arrival_us}
    return {
        "clock.error_ppm": (np.polyfit(sequences.packet, clock_us, 1)[0] / sequences.packet_us - 1) * 1e6,
        "clock.host_ppm": (np.polyfit(clock_us, stamp_us, 1)[0] - 1) * 1e6,
        "clock.arrival_us": arrival_us,
    }
