"""What the azimuths show: speed, errors that repeat with the turn, the tick of the reading, and its noise."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.packets.layout import AZIMUTH_CODES
from vlp16emu.units import US_NS

_TICK_US, _PHASES = 1.2, 48
"""Period of the clock at whose ticks the encoder is read, on four units; phases that are tried."""
_LEAST_STEP_CDEG, _AT_RPM = 38, (590.0, 610.0)
"""Least step between two blocks on real units at 600 rpm."""

Statistics = dict[str, float]


class Turning(NamedTuple):
    """Errors of the encoder against an even turn that changes its speed evenly."""

    once_cdeg: complex
    """Amplitudes of the sine (imaginary) and the cosine (real) of the azimuth."""
    twice_cdeg: complex
    rest_cdeg: NDArray[np.float64]
    """(b,) what is left."""


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


class Tick(NamedTuple):
    """The sawtooth of a reading that is as old as the last tick of a clock."""

    age_us: float
    """Age of the oldest reading less that of the newest: the period of the tick, if the sawtooth is one."""
    at_us: float
    """The sensor's clock modulo the period, at a tick."""


def tick_of(sequences: Sequences, rest_cdeg: NDArray[np.float64]) -> Tick:
    """Find the sawtooth that explains most of the residuals of the azimuth, by least squares for each of its phases."""
    since_us, packet = (sequences.clock_ns - sequences.clock_ns[0]) / US_NS, sequences.packet
    per_packet_us, first_us = np.polyfit(packet, since_us, 1)
    # Stamps are cut to whole microseconds: half of one is missing in the mean.
    per_block_us = per_packet_us * len(packet) / len(sequences.block)
    clock_us = sequences.clock_ns[0] / US_NS + first_us + 0.5 + sequences.block * per_block_us
    rest, speed_cdeg_us = local(rest_cdeg), sequences.rpm * AZIMUTH_CODES / 60e6
    best = 0.0, Tick(0.0, 0.0)
    for at_us in np.arange(_PHASES) * (_TICK_US / _PHASES):
        wave = local(-(((clock_us - at_us) / _TICK_US) % 1.0))
        product, square = wave @ rest, wave @ wave
        if (explained := product**2 / square) > best[0]:
            best = explained, Tick(float(product / square / speed_cdeg_us), float(at_us))
    return best[1]


def rotation(sequences: Sequences) -> Statistics:
    """Speed, errors that repeat with the turn, the tick, and the noise of readings."""
    azimuth, block = sequences.azimuth_cdeg, sequences.block
    rpm, (once, twice, rest) = sequences.rpm, turning_of(sequences)
    step, tick = np.diff(azimuth)[np.diff(block) == 1], tick_of(sequences, rest)
    part = step.mean() % 1.0
    out = {
        "rotation.speed_off_percent": abs(rpm / (60 * round(rpm / 60)) - 1) * 100,
        "rotation.once_cdeg": abs(once),
        "rotation.twice_cdeg": abs(twice),
        "rotation.tick_us": tick.age_us,
        "rotation.tick_at_us": tick.at_us,
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
