"""`tools/unit_laws`: figures of made-up captures whose laws are known."""

import dataclasses
import sys

import numpy as np
import pytest
from scipy.special import ndtr

from vlp16emu import Emulator
from vlp16emu.extras.compare import read_sequences


@pytest.fixture(scope="module")
def sequences(tmp_path_factory):
    """Sequences of a short capture, whose columns tests replace."""
    path = tmp_path_factory.mktemp("unit_laws") / "bench.pcap"
    Emulator("static_bench").record(path, duration_s=0.15)
    return read_sequences(path)


def capture_of(tool, sequences, ranges_lsb, codes, step_cdeg=20.0):
    """Return a capture of ranges and codes (n, 16), with a rotor that turns by equal steps from sequence to
    sequence."""
    number = np.arange(len(codes))
    block = number[::2] // 2
    made = dataclasses.replace(
        sequences,
        number=number,
        distance_lsb=ranges_lsb,
        reflectivity=codes,
        block=block,
        azimuth_cdeg=2 * step_cdeg * block,
    )
    return tool.Capture(made, {})


def test_an_excess_of_range_is_found(tool_named):
    """Ranges of codes 1 and 2 that are 12 and 5 mm too far beside those of codes 30 to 44, with noise, come
    out within 1 mm, and a class with few pairs has none."""
    tool = tool_named("unit_laws")
    rng = np.random.default_rng(1)
    excess = np.zeros(len(tool.FAINT_CODES) - 1)
    excess[[1, 2]] = 12.0, 5.0
    before, after = rng.choice([1, 2, 5, tool.REFERENCE], (2, 20_000))
    change_mm = excess[after] - excess[before] + rng.normal(0.0, 6.0, 20_000)
    found = tool.excess_mm(before, after, change_mm)
    assert found[[1, 2, 5]] == pytest.approx([12.0, 5.0, 0.0], abs=1.0)
    assert np.isnan(found[3])


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_the_width_of_an_edge_is_found(sequences, tool_named, ratio):
    """Codes that fade as a beam of one or two times the width, on one side of a wall at 2 m, have that
    width."""
    tool = tool_named("unit_laws")
    edges = sys.modules["unit_laws_edges"]
    azimuth_cdeg = 19.7 * np.arange(14_400) % 36_000
    sigma_mrad = ratio * (edges.SPOT_MM / 2.0 + edges.DIVERGENCE_MRAD) / 4.0
    past_mrad = 1e3 * np.radians((azimuth_cdeg - 18_000) / 100.0)
    codes = np.zeros((14_400, 16), int)
    codes[:, 3] = np.rint(80.0 * ndtr(-past_mrad / sigma_mrad)) * (azimuth_cdeg > 9_000)
    one = capture_of(tool, sequences, np.where(codes > 0, 1000, 0), codes, 19.7)
    range_lsb, width = edges.widths_of(one)
    fading = range_lsb[width > 0.5], width[width > 0.5]  # the other side of the wall has no width
    assert fading[0] == pytest.approx([1000.0])
    assert fading[1] == pytest.approx([ratio], rel=0.1)


def test_a_laser_that_changes_its_parity_is_found(sequences, tool_named):
    """A laser whose ranges are odd in every other turn has the opposite parity a turn later, and one whose
    ranges are even the same."""
    tool = tool_named("unit_laws")
    turn = np.arange(7200) // 1800
    ranges_lsb = np.full((7200, 16), 2000)
    ranges_lsb[:, 3] += turn % 2
    one = capture_of(tool, sequences, ranges_lsb, np.full((7200, 16), 50))
    found = tool.turn_over_neighbours(one)
    assert found[3] == pytest.approx(-1.0, abs=0.01)
    assert np.delete(found, 3) == pytest.approx(1.0)


def test_samples_of_the_receiver_are_found(sequences, tool_named):
    """Faint echoes at multiples of 99.93 codes beside silence, at a place of each laser, are at samples, and
    none of those that differ from record to record."""
    tool = tool_named("unit_laws")
    ranges = sys.modules["unit_laws_ranges"]
    rng = np.random.default_rng(1)
    which = np.repeat(rng.integers(5, 40, 1200), 6)[:, None]
    ranges_lsb = np.rint(99.93 * which + rng.uniform(0, 99, 16)).astype(int)
    ranges_lsb[::6] = 0
    one = capture_of(tool, sequences, ranges_lsb, np.ones_like(ranges_lsb))
    on = ranges.on_samples(one)[ranges.PERIODS_LSB.index(99.93)]
    assert on.mean() > 0.98
    assert max(of.mean() for of in ranges.on_samples(one)[:3]) < 0.4
    near, *_, far = ranges.samples_near_silence(one)
    assert near.mean() > 0.98
    assert far.size == 0
    strewn = capture_of(tool, sequences, rng.integers(500, 4000, (7200, 16)), np.ones((7200, 16), int))
    assert sum(of.size for of in ranges.on_samples(strewn)) == 0


def test_rounds_of_16_sequences_are_found(sequences, tool_named):
    """A laser that draws its parity in each sequence that is 5 modulo 16, more often odd in one slot of the
    beat, has that place and the greatest share there."""
    tool = tool_named("unit_laws")
    parity = sys.modules["unit_laws_parity"]
    rng = np.random.default_rng(2)
    begin = 5 + 16 * ((np.arange(9600) - 5) // 16)
    slot = (24 * begin + 3) % 5
    drawn = rng.uniform(size=9700)[begin - begin.min()]
    ranges_lsb = np.full((9600, 16), 2000)
    ranges_lsb[:, 3] += drawn < np.where(slot == 2, 0.8, 0.2)
    one = capture_of(tool, sequences, ranges_lsb, np.full((9600, 16), 50))
    count, place, sharp = parity.place_in_round(one, 3)
    assert count > 100
    assert place == pytest.approx(5.0, abs=0.6)
    assert sharp > 0.9 * count
    shares, rounds = parity.by_slot(one, 3, place)
    assert rounds > 500
    assert shares == pytest.approx([0.2, 0.2, 0.8, 0.2, 0.2], abs=0.1)
    assert parity.place_in_round(one, 4)[0] == 0


def test_factors_of_strengths_are_found(tool_named):
    """Codes of strengths times 13 and 20 eighths show these factors, and all codes that of 8."""
    tool_named("unit_laws")
    codes = sys.modules["unit_laws_codes"]
    strengths = np.repeat(np.arange(1, 15), 5)
    assert codes.factor_of(strengths * 13 // 8) == 13.0
    assert codes.factor_of(strengths * 20 // 8) == 20.0
    assert codes.factor_of(np.repeat(np.arange(1, 40), 3)) == 8.0
    assert np.isnan(codes.factor_of(np.array([3, 4, 5])))
