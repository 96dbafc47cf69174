"""Random numbers: the published generator, its distributions, and that order never matters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from vlp16emu.forest.purpose import Growth
from vlp16emu.random import Purpose, generator, normal, philox4x32, uniform

# Known answers of the authors of Philox: Random123 distribution, file kat_vectors, lines "philox4x32 10".
KNOWN_ANSWERS = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN_ANSWERS)
def test_philox_gives_its_authors_answers(counter, key, answer):
    """Philox 4x32-10 gives the words that its authors publish."""
    assert philox4x32(*(np.uint32(word) for word in (*counter, *key))) == answer


@pytest.mark.parametrize(("draw", "law"), [(uniform, "uniform"), (normal, "norm")])
def test_numbers_follow_their_law(draw, law):
    """100 000 numbers pass a Kolmogorov-Smirnov test against the uniform distribution on [0, 1), or the
    standard normal one."""
    assert stats.kstest(draw(1, Purpose.AZIMUTH_READING, 0, 100_000), law).pvalue > 0.001


@pytest.mark.parametrize("draw", [uniform, normal])
@given(first=st.integers(0, 2**62), cut=st.integers(0, 200), lane=st.integers(0, 2**32 - 1))
def test_a_number_does_not_depend_on_its_neighbours(draw, first, cut, lane):
    """A run of numbers drawn in two pieces has the same bits as in one."""
    whole = draw(7, Growth.TERRAIN, first, 200, lane)
    pieces = np.concatenate(
        [draw(7, Growth.TERRAIN, first, cut, lane), draw(7, Growth.TERRAIN, first + cut, 200 - cut, lane)]
    )
    np.testing.assert_array_equal(whole, pieces)


def test_seed_purpose_and_lane_each_make_another_sequence():
    """Changing any one part of the key gives numbers without correlation to the others."""
    keys = [
        (1, Growth.STAND, 0),
        (2, Growth.STAND, 0),
        (1, Growth.TREE, 0),
        (1, Growth.STAND, 1),
        (1 + 2**32, Growth.STAND, 0),
    ]
    drawn = [uniform(seed, purpose, 0, 10_000, lane) for seed, purpose, lane in keys]
    correlation = np.corrcoef(drawn) - np.eye(len(keys))
    assert np.abs(correlation).max() < 0.05  # five sigma of 10 000 independent pairs


def test_a_generator_is_named_by_its_key():
    """The same key gives the same generator, another key (a negative one too) another."""
    first = generator(1, Growth.TREE, 3, -4).random(4)
    np.testing.assert_array_equal(first, generator(1, Growth.TREE, 3, -4).random(4))
    for other in (
        generator(1, Growth.TREE, 3, 4),
        generator(1, Growth.TREE, -4, 3),
        generator(2, Growth.TREE, 3, -4),
    ):
        assert not np.array_equal(first, other.random(4))


def test_purposes_keep_their_numbers():
    """The number of a purpose is part of every recording: it is never changed, only appended to."""
    kept = ["AZIMUTH_READING", "TERRAIN", "STAND", "TREE", "CROWN", "POSITION_PACKET"]
    names = {int(purpose): purpose.name for purpose in (*Purpose, *Growth)}
    assert [names[number] for number in range(1, 7)] == kept
    assert len(names) == len(Purpose) + len(Growth)
