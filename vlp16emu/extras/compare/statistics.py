"""Statistics of a unit, from its packets alone; most depend little on what stood before it."""

import math

import numpy as np

from vlp16emu.extras.compare.losses import dual_returns, lost_records, no_returns
from vlp16emu.extras.compare.rotation import rotation
from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.surfaces import Statistics, codes, gains, range_noise, reflectivity_noise, stretches_of
from vlp16emu.units import US_NS

_LEAST, _LEAST_PACKETS = 500, 250
"""Codes of a laser, and packets, from which on a statistic is worth its name."""
_NORTH_CDEG = 15
_VELOVIEW = bytes.fromhex("607688000000")
"""VeloView gives all packets that it saves one header, of this sender: its IP identification is not the sensor's."""
_DUE_US = 1000.0
"""Most difference of an arrival from one period after the stamp, to be that of two clocks that agree."""


def statistics_of(sequences: Sequences) -> Statistics:
    """Find all statistics that a capture has, by name; what it has too little of is left out."""
    stretches = stretches_of(sequences)
    of_surfaces = {} if stretches is None else range_noise(stretches) | reflectivity_noise(stretches)
    every = of_surfaces | codes(sequences) | gains(sequences) | lost_records(sequences) | no_returns(sequences)
    every |= (
        dual_returns(sequences) | rotation(sequences) | _residues(sequences) | _start(sequences) | _clocks(sequences)
    )
    return {name: float(value) for name, value in every.items() if math.isfinite(value)}


def _residues(sequences: Sequences) -> Statistics:
    """Evenness of the codes of distance."""
    d = sequences.distance_lsb
    odd = [(codes[codes > 0] % 2).mean() for codes in d.T if (codes > 0).sum() >= _LEAST]
    if len(odd) < 5:
        return {}
    by_four = np.bincount(d[d > 0] % 4, minlength=4) / (d > 0).sum()
    return {"residue.odd_spread": np.std(odd), "residue.mod_4": np.abs(by_four - 0.25).max()}


def _start(sequences: Sequences) -> Statistics:
    """Signs of a unit that was switched on as the capture began, each 0 or 1 but for the round values of its first packets."""
    first_us = sequences.clock_ns[0] / US_NS
    lag_us = (sequences.stamp_ns[0] - sequences.clock_ns[0]) / US_NS % 3.6e9
    counts_from_0 = sequences.first_position_id == 0 and sequences.mac != _VELOVIEW
    is_round = first_us % 1e6 == 0, sequences.azimuth_cdeg[0] <= _NORTH_CDEG, counts_from_0
    return {
        "start.stamps_count_from_it": on_lattice(sequences),
        "start.round_values": sum(is_round),
        "start.arrivals_are_due": abs(lag_us - sequences.packet_us) < _DUE_US,
    }


def on_lattice(sequences: Sequences) -> bool:
    """Return whether all stamps are a whole number of periods, cut to microseconds, since one whole second of the hour."""
    stamp_us, period_us = sequences.clock_ns[:, None] / US_NS % 3.6e9, sequences.packet_us
    since_us = (stamp_us[:1] - 1e6 * np.arange(3600)) % 3.6e9
    seconds = 1e6 * np.flatnonzero(_is_multiple(since_us[0], period_us))
    return bool(_is_multiple((stamp_us - seconds) % 3.6e9, period_us).all(axis=0).any())


def _is_multiple(since_us: np.ndarray, period_us: float) -> np.ndarray:
    return np.asarray(np.floor(np.ceil(since_us / period_us - 1e-9) * period_us + 1e-6) == since_us)


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
