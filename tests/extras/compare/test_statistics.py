"""Recipes of the statistics, on arrays whose answer is known."""

import numpy as np
import pytest

from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.statistics import (
    beat_of,
    codes,
    dual_returns,
    gains,
    lost_records,
    no_returns,
    range_noise,
    reflectivity_noise,
    rotation,
    statistics_of,
    stretches_of,
)
from vlp16emu.extras.compare.table import REAL, Known
from vlp16emu.packets.layout import layout_of
from vlp16emu.types import ReturnMode, SensorModel

COUNT = 7200
NUMBER = np.arange(COUNT)
DRAW = np.random.default_rng(1)


def sequences_of(distance_lsb=None, reflectivity=None, **others):
    """A wall at 5 m, of reflectivity 30, before a rotor that turns evenly at 600 rpm."""
    block, packet = np.arange(COUNT // 2), np.arange(COUNT // 24)
    layout = layout_of(SensorModel.VLP_16, ReturnMode.STRONGEST)
    fields = {
        "layout": layout,
        "period_ns": layout.period_ns,
        "number": NUMBER,
        "distance_lsb": np.full((COUNT, 16), 2500) if distance_lsb is None else distance_lsb,
        "reflectivity": np.full((COUNT, 16), 30) if reflectivity is None else reflectivity,
        "azimuth_cdeg": np.floor(123.4 + 39.8131 * block).astype(int),
        "block": block,
        "clock_ns": np.floor(17.25 + 1327.104 * packet).astype(int) * 1000,
        "stamp_ns": 10**18 + 1_327_104 * packet,
        "packet": packet,
        "last": None,
    }
    return Sequences(**fields | others)


def noisy(sigma_mm, amplitude_mm=0.0):
    """Ranges of a wall with Gaussian noise and a beat of period five."""
    slot = (24 * NUMBER[:, None] + np.arange(16)) % 5
    exact_mm = (
        5000 + DRAW.normal(0, sigma_mm, (COUNT, 16)) + amplitude_mm * np.cos(2 * np.pi * slot / 5 + 1.0)
    )
    return np.rint(exact_mm / 2).astype(int)


def test_beat_and_white_noise_are_told_apart():
    """A beat of 6 mm with phase 1 rad, and Gaussian noise of 5 mm, whose kurtosis within 15 pulses less
    four degrees of freedom is -0.3."""
    stretches = stretches_of(sequences_of(noisy(5.0, 6.0), np.full((COUNT, 16), 20)))
    found = range_noise(stretches)
    sine = beat_of(stretches)[0]
    assert abs(sine) == pytest.approx(6.0, abs=0.15)
    assert np.angle(sine) == pytest.approx(1.0, abs=0.02)
    assert found["range.white_at_20_mm"] == pytest.approx(np.hypot(5.0, 2 / np.sqrt(12)), abs=0.05)
    # Normal numbers on a sphere of 11 dimensions: 3 x 11 / 13 for each coordinate; in 15 coordinates a little
    # more.
    assert -0.35 < found["range.kurtosis"] < -0.2


def test_heavy_tails_show_in_the_kurtosis():
    """Laplacian noise is above what real units show."""
    wall = np.rint((5000 + DRAW.laplace(0, 4.0, (COUNT, 16))) / 2).astype(int)
    kurtosis = range_noise(stretches_of(sequences_of(wall)))["range.kurtosis"]
    assert kurtosis > REAL["range.kurtosis"].limits[1] + 0.3


def test_texture_is_scatter_over_level():
    """Codes around 40 whose scatter is 2 % on three quarters of a wall and 10 % on the rest: P90 over P25
    is near five."""
    sigma = np.where(NUMBER % 1800 < 450, 4.0, 0.8)[:, None]

    def noise(level, sigma):
        wall = np.rint(DRAW.normal(level, sigma, (COUNT, 16))).astype(int)
        return reflectivity_noise(stretches_of(sequences_of(noisy(5.0), wall)))

    assert noise(40, sigma)["reflectivity.texture_spread"] == pytest.approx(5.0, abs=0.8)
    dark = noise(10, 1.0)
    assert dark["reflectivity.texture_4_15"] == pytest.approx(np.hypot(1.0, 12**-0.5) / 10, abs=0.005)


def test_gains_of_lasers_are_found_whatever_stands_there():
    """Gains of 10 %, one sigma, on a wall whose brightness changes with azimuth and from top to bottom;
    and none without."""
    shade = 40 + 15 * np.sin(NUMBER / 300)[:, None] + np.r_[0:16:2, 1:16:2].argsort()
    for spread in (0.1, 0.0):
        gain = np.exp(spread * np.random.default_rng(2).normal(size=16))
        r = np.rint(shade * gain * (1 + 0.03 * DRAW.normal(size=(COUNT, 16)))).astype(int)
        second = np.diff(np.log(gain)[np.r_[0:16:2, 1:16:2]], 2)
        found = gains(sequences_of(None, r))["reflectivity.gain_spread"]
        assert found == pytest.approx(second.std(ddof=1) / 2 / np.sqrt(1.5), abs=0.012)


def test_records_are_lost_where_they_are_taken_away():
    """One of ten at steps of 1 m, one of five at steps of 3 m, one of twenty at 30 codes, and none on a
    surface."""
    d, r = np.full((COUNT, 16), 2500), np.full((COUNT, 16), 30)
    d[NUMBER % 20 >= 10] = 3000
    d[COUNT // 2 :][NUMBER[: COUNT // 2] % 20 >= 10] = 4000
    edge = np.flatnonzero((NUMBER % 10 == 9) & (NUMBER < COUNT - 2))
    d[edge[edge < COUNT // 2][::10]] = 0
    d[edge[edge >= COUNT // 2][::5]] = 0
    found = lost_records(sequences_of(d, r))
    assert found["lost.at_steps_below_1.4_m"] == pytest.approx(0.05, abs=0.01)
    assert found["lost.at_steps_above_1.4_m"] == pytest.approx(0.1, abs=0.02)
    assert found["lost.on_a_surface"] == 0
    d, r = np.full((COUNT, 16), 2500), np.where(NUMBER % 20 >= 10, 60, 30)[:, None].repeat(16, axis=1)
    d[edge[::20]] = 0
    assert lost_records(sequences_of(d, r))["lost.at_code_steps"] == pytest.approx(1 / 40, abs=0.005)


def test_no_returns_are_raised_beside_bright_returns():
    """Codes of 10, and 50 in each record beside a return of 60; beside a return of 2 they stay."""
    d, r = np.full((COUNT, 16), 2500), np.full((COUNT, 16), 10)
    silent = NUMBER % 40 >= 10
    d[silent] = 0
    bright = (NUMBER // 40) % 2 == 0
    r[~silent & bright], r[~silent & ~bright] = 60, 2
    beside = silent & np.isin(NUMBER % 40, (10,))
    r[beside & bright] = 50
    found = no_returns(sequences_of(d, r))
    assert found["no_return.raised_beside_bright"] == pytest.approx(0.5, abs=0.01)
    assert found["no_return.raised_once"] == 1
    assert found["no_return.above_100"] == 0


def test_pairs_of_dual_return_are_compared():
    """One of 100 pairs has one return; of the pairs without, one half differ in their codes."""
    d, r = np.full((COUNT, 16), 2500), np.full((COUNT, 16), 9)
    d[::2] = 0
    d_last, r_last = d.copy(), r.copy()
    r_last[::4] = 18
    d_last[1::100] = 0
    found = dual_returns(sequences_of(d, r, last=(d_last, r_last)))
    assert found["dual.one_without"] == pytest.approx(0.01)
    assert found["dual.unequal_no_returns"] == pytest.approx(0.5)
    assert dual_returns(sequences_of(d, r)) == {}


def test_top_codes_are_counted_among_returns():
    """A tenth of the returns has 95; no-returns of 95 do not count, nor do retroreflectors."""
    d, r = np.full((COUNT, 16), 2500), np.full((COUNT, 16), 30)
    r[::10], r[1::10], r[2::10] = 95, 150, 95
    d[2::10] = 0
    assert codes(sequences_of(d, r))["reflectivity.top_codes"] == pytest.approx(1 / 9)


@pytest.mark.parametrize("age_us", [0.0, 1.2])
def test_the_tick_of_the_reading_is_found(age_us):
    """Azimuths as old as the last tick of 1.2 us, at 0.5 us of the sensor's clock: height within what
    chance gives."""
    block = np.arange(COUNT // 2)
    clock_us = 17.25 + 110.592 * block
    old_us = (clock_us - 0.5) % 1.2 * (age_us / 1.2)
    azimuth = np.floor(123.4 + 0.36 * (clock_us - old_us) + DRAW.normal(0, 0.2, len(block))).astype(int)
    found = rotation(sequences_of(azimuth_cdeg=azimuth))
    assert abs(found["rotation.tick_us"]) == pytest.approx(age_us, abs=0.25)


def test_steps_of_an_even_ruler_have_no_excess():
    """A floor of an even turn has just the variance of its two steps; a reading with an error of 0.5 cdeg
    has 0.5 more, and short steps."""
    even = rotation(sequences_of())
    assert even["rotation.excess_variance"] == pytest.approx(0.0, abs=0.01)
    assert even["rotation.short_steps"] == 0
    block = np.arange(COUNT // 2)
    read_cdeg = np.floor(9 + 39.8131 * block + DRAW.normal(0, 0.8, len(block))).astype(int)
    rough = rotation(sequences_of(azimuth_cdeg=read_cdeg))
    assert rough["rotation.excess_variance"] == pytest.approx(2 * 0.8**2, abs=0.1)
    assert rough["rotation.short_steps"] > 0.005


def test_clocks_are_held_against_each_other():
    """A sensor 20 ppm fast, and a host 5 ppm slow against it."""
    packet = np.arange(COUNT // 24)
    clock_ns = np.floor((17.25 + 1327.104 * packet) * (1 + 20e-6)).astype(int) * 1000
    found = statistics_of(
        sequences_of(clock_ns=clock_ns, stamp_ns=10**18 + (clock_ns * (1 - 5e-6)).astype(int))
    )
    assert found["clock.error_ppm"] == pytest.approx(20, abs=0.1)
    assert found["clock.host_ppm"] == pytest.approx(-5, abs=0.1)


def test_ranges_of_real_units_are_widened_by_half():
    """Limits are widened by ratios above 0, by a factor of two for one unit, and by differences elsewhere."""
    assert Known(0.01, 0.04, "").limits == pytest.approx((0.005, 0.08))
    assert Known(4.0, 4.0, "").limits == pytest.approx((2.0, 8.0))
    assert Known(-0.3, -0.2, "").limits == pytest.approx((-0.35, -0.15))
    assert not Known(0.0, 0.0, "").is_like(1.0)
