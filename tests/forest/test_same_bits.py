"""What grows has the same bits on every processor: what stands in for libraries gives what they give."""

import numpy as np
import pytest
from scipy import special
from scipy.spatial import ConvexHull

from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.stand.floor_shapes import _outline_m2, floor
from vlp16emu.forest.stand.scatter import normal_quantile
from vlp16emu.forest.stand.stand import class_scale
from vlp16emu.random import _EXPONENTIAL_TAIL, _NORMAL_TAIL, generator


def _plain() -> np.random.Generator:
    """Numpy's own generator in the state of a new one of ours."""
    return np.random.Generator(generator(7, Growth.TREE, 3, -4).bit_generator)


@pytest.mark.parametrize(
    ("name", "arguments", "edge"),
    [("standard_normal", (200_000,), _NORMAL_TAIL), ("standard_exponential", (200_000,), _EXPONENTIAL_TAIL)],
)
def test_tails_are_rounded_and_nothing_else(name: str, arguments: tuple[int], edge: float) -> None:
    """Numbers of a ziggurat are numpy's own; its tails, and they alone, are numpy's to the nearest 2**-24."""
    own = getattr(generator(7, Growth.TREE, 3, -4), name)(*arguments)
    true = getattr(_plain(), name)(*arguments)
    tail = np.abs(true) > edge
    assert 20 < tail.sum() < 200
    assert (own[~tail] == true[~tail]).all()
    assert np.abs(own[tail] - true[tail]).max() <= 2.0**-25
    assert (own[tail] * 2.0**24 % 1 == 0).all()


def test_what_follows_from_ziggurats_is_that_of_numpy() -> None:
    """Normal, Rayleigh and beta numbers are numpy's own to a step of 2**-24, one by one and from the same
    state on."""
    own, true = generator(7, Growth.TREE, 3, -4), _plain()
    modes = np.linspace(0.1, 2.0, 5000)
    for name, arguments in (
        ("normal", (1.0, 0.4, (2, 5000))),
        ("rayleigh", (modes,)),
        ("beta", (0.95, 3.76, 5000)),
    ):
        assert np.abs(getattr(own, name)(*arguments) - getattr(true, name)(*arguments)).max() < 2.0**-24, name
    assert own.poisson(30.0, 1000).tolist() == true.poisson(30.0, 1000).tolist()
    assert isinstance(own.normal(), float)


def test_quantiles_are_those_of_scipy() -> None:
    """Normal quantiles are within 2e-15 of scipy's, relatively, in the middle, in the tails and where they
    meet."""
    share = np.concatenate([np.linspace(1e-6, 1 - 1e-6, 20_001), np.geomspace(1e-13, 0.5, 500), [np.exp(-2)]])
    assert normal_quantile(share) == pytest.approx(special.ndtri(share), rel=2e-15, abs=1e-15)


def test_shares_of_stones_are_those_of_their_distribution() -> None:
    """The shares of stones that are too short and too long are those of the log-normal distribution."""
    stones = floor()["layers"]["stones"]
    at = np.log(np.array(stones["length_m"]) / stones["median_m"]) / stones["sigma"]
    assert special.ndtr(at) == pytest.approx(stones["shares"], rel=1e-15)


def test_outlines_are_those_of_hulls() -> None:
    """The area of an outline is that of the convex hull, of points at random and in rows."""
    rng = np.random.default_rng(1)
    for points in (rng.normal(size=(300, 2)), np.argwhere(np.ones((5, 7))) * 1.0):
        assert _outline_m2(points) == pytest.approx(ConvexHull(points).volume, rel=1e-12)


def test_sizes_of_classes_are_powers() -> None:
    """The sizes of classes are whole powers of their ratio to the last bit, those of 3 / 2 exactly."""
    assert [class_scale(1.5, n) for n in (-1, 0, 1, 4)] == [1 / 1.5, 1.0, 1.5, 5.0625]
    assert class_scale(1.4, -3) == pytest.approx(1.4**-3, rel=1e-15)
