"""Hits of a pulse become its returns."""

import numpy as np
import pytest
from returns.kit import detector, firings, pulses, table

from vlp16emu.returns.detect import detect
from vlp16emu.types import NO_SURFACE, Hits, ReturnMode

K = 8


def lone(range_m, reflectance=0.5, cosine=1.0, *, truth=False, **own):
    """Returns of pulses that are one ray each."""
    hits = pulses(K, [range_m], [NO_SURFACE if np.isinf(range_m) else 0], cosine)
    return detect(firings(K), hits, table(reflectance), detector(**own), truth=truth)


def split(range_m, reflectance, **own):
    """First pulse's distances and reflectivities, of sub-rays that meet surfaces of a reflectance each."""
    out = detect(firings(K), pulses(K, range_m), table(*reflectance), detector(**own), truth=True)
    return out.distance_m[0, 0], out.reflectivity[0, 0], out.surface[0, 0]


@pytest.mark.parametrize("max_range_m", [100.0, 131.07])
def test_range_limits(max_range_m):
    """What is nearer than the least range, farther than the greatest, or nowhere gives no return; what is
    just there does."""
    for range_m, is_seen in (
        (0.49, 0),
        (0.5, 1),
        (20, 1),
        (max_range_m, 1),
        (max_range_m + 0.001, 0),
        (np.inf, 0),
    ):
        distance_m = lone(range_m, 0.9, max_range_m=max_range_m).distance_m[..., :2]
        assert (distance_m == (np.float32(range_m) if is_seen else 0)).all()


BIASED = {"noise": {"range_bias_m": 0.02}}


def test_what_is_measured_beyond_the_greatest_range_is_lost():
    """An echo that a laser's bias puts beyond reach gives no return, and no reflectivity; noise does so as
    often to one surface as to two."""
    bias_m = lone(50.0, 0.7, **BIASED).distance_m[..., 0] - 50.0
    out = lone(99.99, 0.7, **BIASED)
    lost, kept = bias_m > 0.0101, bias_m < 0.0099
    assert lost.any()
    assert kept.any()
    assert not out.distance_m[lost].any()
    assert not out.reflectivity[lost].any()
    assert (out.distance_m[kept][:, :2] > 99.9).all()
    unit, surfaces = detector({"range_noise_m": 0.01}), table(0.5, 0.5)
    of = [
        detect(firings(500), pulses(500, m), surfaces, unit, truth=False) for m in ([99.999], [99.9, 100.098])
    ]
    one, two = ((each.distance_m[..., 1] > 0).mean() for each in of)
    assert one == pytest.approx(two, abs=0.03)


@pytest.mark.parametrize("far", [9.0, 0.9])
def test_without_a_lost_echo_the_others_are_what_they_would_be(far):
    """Where the farther of two echoes, stronger or not, is measured beyond reach, the nearer is strongest
    and last."""
    seen = []
    for seed in range(20):
        alone = split([30.0, 30.0, np.inf], [0.1, 0.1, 0.0], seed=seed, **BIASED)
        both = split([30.0, 30.0, 99.99], [0.1, 0.1, far], seed=seed, **BIASED)
        seen.append(bool(both[0][1] < 50.0))
        assert seen[-1] == (alone[0][0] > 30.01)
        if seen[-1]:
            assert (both[0] == alone[0]).all()
            assert (both[1][:2] == alone[1][:2]).all()
    assert {False, True} == set(seen)


def test_lone_echo_is_strongest_and_last():
    """One echo stands as both, without a second strongest; too near for a distance it shows part of its
    reflectivity, too far or none at all does not."""
    out = lone(7.0)
    assert (out.distance_m[..., 0] == out.distance_m[..., 1]).all()
    assert (out.distance_m[..., 2] == 0).all()
    assert (lone(0.46, 0.7).reflectivity[..., :2] == 42).all()
    assert not lone(120, 0.7).reflectivity.any()
    assert not lone(np.inf, 0.7).reflectivity.any()


@pytest.mark.parametrize(
    ("reflectance", "cosine", "byte"),
    [
        (0.5, 1.0, 50),
        (0.5, 0.5, 25),
        (1.0, 1.0, 100),
        (0, 1, 0),
        (1.2, 1, 105),
        (1000, 1, 255),
        (1e6, 1, 255),
    ],
)
def test_reflectivity_scale(reflectance, cosine, byte):
    """The byte is reflectance times cosine in percent up to 100, and grows to 255 at a thousand times
    white."""
    assert (lone(7.0, reflectance, cosine).reflectivity[..., 0] == byte).all()


def test_truth_is_kept_only_on_request():
    """Surfaces travel along only when asked for, whatever the noise of ranges, and are `NO_SURFACE` where
    there is no return."""
    assert lone(7.0).surface is None
    kept = lone(7.0, truth=True)
    assert (kept.surface[..., :2] == 0).all()
    assert (kept.surface[..., 2] == NO_SURFACE).all()
    assert (
        lone(7.0, 0.01, truth=True, noise={"range_noise_m": 0.1}, pulse_ns=1.0).surface[..., 0] == 0
    ).all()
    assert (lone(0.3, truth=True).surface == NO_SURFACE).all()


def test_two_surfaces_far_apart_are_two_returns():
    """A beam half on a bright plate and half on one behind gives each at its place; a brighter one behind
    is strongest and last."""
    distance_m, reflectivity, surface = split([4.0, 9.0], [0.6, 0.4])
    assert distance_m.tolist() == pytest.approx([4, 9, 9])
    assert reflectivity.tolist() == [30, 20, 20]
    assert surface.tolist() == [0, 1, 1]
    distance_m, _, surface = split([4.0, 9.0], [0.05, 0.9])
    assert distance_m.tolist() == pytest.approx([9, 9, 4])
    assert surface.tolist() == [1, 1, 0]


@pytest.mark.parametrize("mode", [ReturnMode.STRONGEST, ReturnMode.LAST, ReturnMode.DUAL])
def test_what_is_nearer_than_the_least_range_takes_light_and_hides_nothing(mode):
    """A beam half on a hand at 0.3 m gives the wall behind it alone, with half of its light; only the hand
    gives no range, and less of its light the nearer it is."""
    distance_m, reflectivity, surface = split([0.3, 5.0], [0.5, 0.5], mode=mode)
    assert distance_m[0] == np.float32(5.0)
    assert reflectivity[0] == 25
    assert surface[0] == 1
    for range_m, code in ((0.3, 0), (0.39, 0), (0.46, 30), (0.5, 50)):
        assert lone(range_m, 0.5, mode=mode).reflectivity[0, 0, 0] == code


@pytest.mark.parametrize(
    ("mode", "columns"),
    [(ReturnMode.STRONGEST, [4, 0, 0]), (ReturnMode.LAST, [4, 9, 6]), (ReturnMode.DUAL, [4, 9, 6])],
)
def test_only_what_the_mode_needs(mode, columns):
    """Strongest return leaves last and second strongest empty; the other modes have all three."""
    distance_m, _, _ = split([4.0, 6.0, 9.0], [0.9, 0.8, 0.7], mode=mode)
    assert distance_m.tolist() == pytest.approx(columns)


@pytest.mark.parametrize(("gap_m", "returns"), [(0.3, 1), (0.95, 1), (1.3, 1), (1.5, 2), (1.9, 2), (5.0, 2)])
def test_step_edge(gap_m, returns):
    """A beam half on each of two plates gives one return between or on them below the resolution of 1.4 m,
    and two above it."""
    distance_m, _, _ = split([10.0, 10.0 + gap_m], [0.5, 0.5])
    assert len(set(distance_m[:2].tolist())) == returns
    assert (distance_m[:2] >= 10).all()
    assert (distance_m[:2] <= np.float32(10 + gap_m)).all()
    if gap_m < 0.5:  # the range law makes the nearer plate the brighter one
        middle_m = np.average([10, 10 + gap_m], weights=[1 / 10**2, 1 / (10 + gap_m) ** 2])
        assert distance_m[0] == pytest.approx(middle_m, abs=0.002)
        short_m = split([10.0, 10.0, 10.0, 10.14], [0.5] * 4, pulse_ns=1.0)[0][0]
        assert short_m == pytest.approx(10.0046, abs=0.0005)  # the highest peak; the mean is at 10.035


def test_batches_do_not_matter():
    """A pulse gives the same whatever is detected with it: only its firing number counts."""
    unit = detector({"range_noise_m": 0.01, "weak_echoes_lost": True}, visibility_m=100.0)
    ranges, surfaces = [30, 30.1, 33, np.inf], table(0.1, 0.1, 0.1)
    kinds = [0, 1, 2, NO_SURFACE]
    whole = detect(firings(40, 7), pulses(40, ranges, kinds), surfaces, unit, truth=True)
    part = detect(firings(9, 19), pulses(9, ranges, kinds), surfaces, unit, truth=True)
    for name in ("distance_m", "reflectivity", "surface"):
        np.testing.assert_array_equal(getattr(whole, name)[12:21], getattr(part, name))


def test_sub_rays_may_differ_in_number():
    """Ragged hits are read pulse by pulse: each pulse shows the mean of its own sub-rays."""
    count = np.arange(1, K * 16 + 1, dtype=np.uint16).reshape(K, 16)
    n = int(count.sum())
    owner = np.repeat(np.arange(K * 16), count.ravel())
    range_m = (2 + 0.5 * owner + 0.01 * np.sin(np.arange(n))).astype(np.float32)
    hits = Hits(count, range_m, np.zeros(n, np.uint32), np.ones(n, np.float32))
    out = detect(firings(K), hits, table(0.5), detector(), truth=False)
    want_m = np.bincount(owner, range_m) / count.ravel()
    np.testing.assert_allclose(out.distance_m[..., 0].ravel(), want_m, atol=1e-5)
