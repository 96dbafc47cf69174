"""Records that real units lose, and the codes of no-returns beside returns: rates of the captures."""

from dataclasses import replace

import numpy as np
import pytest
from returns.kit import ELEVATION_DEG, LASERS, detector, firings, table

from vlp16emu.kernels.compiler import kernel
from vlp16emu.returns import Noise
from vlp16emu.returns.detect import detect
from vlp16emu.returns.lost import _NEAREST_SPOT_M, _SPOT_RAD, _spot_m, loss_rates
from vlp16emu.types import NO_SURFACE, Hits, PlantPart, Semantic

LOSSES = {"unit_spread": 0.15, "records_lost": 1.0, "no_return_reflectivity": True, "no_return_level": 5.0}


def turning(k, index=0):
    """Firings of a sensor at rest, 0.2 deg from one to the next, 1800 in a revolution."""
    at = np.radians(0.2 * np.arange(index, index + k))[:, None]
    up = np.radians(ELEVATION_DEG)
    direction = np.stack(
        [np.cos(up) * np.cos(at), -np.cos(up) * np.sin(at), np.broadcast_to(np.sin(up), (k, LASERS))], axis=2
    )
    return replace(firings(k, index), direction=direction)


def seen(surfaces, range_m, surface, noise=LOSSES, *, index=0, block=None, **unit):
    """Detect (k, L, s) sub-rays at right angles."""
    k, lasers, s = np.shape(range_m)
    hits = Hits(
        np.full((k, lasers), s, np.uint16),
        np.asarray(range_m, np.float32).reshape(-1),
        np.broadcast_to(surface, np.shape(range_m)).astype(np.uint32).reshape(-1),
        np.ones(k * lasers * s, np.float32),
    )
    return detect(turning(k, index), hits, surfaces, detector(noise, **unit), truth=False, block=block)


def lost(out):
    return out.distance_m[..., 0] == 0


def runs(of):
    """Lengths of the runs of True along each laser of (k, L)."""
    edge = np.diff(np.pad(of, ((1, 1), (0, 0))).astype(int), axis=0).T
    return np.nonzero(edge == -1)[1] - np.nonzero(edge == 1)[1]


def test_a_calm_wall_is_whole_where_it_is_not_dark_or_near():
    """From 1 m on and at codes of 20 and more no record is lost: none of 244 000 on six real units.

    Black walls lose 0.4 to 3 % of their records, near ones 0.1 to 2 %, those at 20 m few.
    """
    shares = []
    for reflectance, away_m in ((0.25, 1.1), (0.7, 3.0), (0.02, 3.0), (0.7, 0.7), (0.02, 20.0)):
        range_m = np.full((3600, LASERS, 1), away_m)
        shares.append(np.mean([lost(seen(table(reflectance), range_m, 0, seed=s)).mean() for s in range(8)]))
    assert shares[:2] == [0.0, 0.0]
    assert 0.004 < shares[2] < 0.03
    assert 0.001 < shares[3] < 0.02
    assert shares[4] < 0.1 * shares[2]


@kernel
def spots_m(range_m, out):
    for n in range(len(range_m)):
        out[n] = _spot_m(range_m[n])


def test_spots_double_until_they_are_as_wide_as_the_angle():
    """The size of a spot is the least one, doubled until it is no smaller than its angle at the range."""
    range_m = np.concatenate(
        [0.5 * 2.0 ** np.arange(9.0), np.random.default_rng(1).uniform(0.1, 130.0, 5000)]
    )
    found = np.empty(len(range_m))
    spots_m(range_m, found)
    for at_m, size_m in zip(range_m, found, strict=True):
        expected = _SPOT_RAD * _NEAREST_SPOT_M
        while expected < _SPOT_RAD * at_m:
            expected *= 2.0
        assert size_m == expected


def test_spots_have_a_place():
    """A laser loses the same records of a dark wall in each revolution, in runs, with others beside them;
    another laser others."""
    out = lost(seen(table(0.02), np.full((3600, LASERS, 1), 3.0), 0, LOSSES | {"records_lost": 2.0}))
    first, again = out[:1800], out[1800:]
    assert (first & again).sum() / first.sum() > 0.6
    assert 0.3 < (runs(out) > 1).sum() / (runs(out) == 1).sum() < 3.0
    beside = np.stack([np.convolve(first[:, laser], np.ones(61), "same") for laser in range(LASERS)], axis=1)
    assert (beside[first] > 1.0).mean() > 0.9
    assert (beside > 0.0).mean() < 0.75 * (1.0 - (1.0 - first.mean()) ** 61)  # of losses strewn evenly
    assert abs(np.corrcoef(first.T)[np.triu_indices(LASERS, 1)]).max() < 0.2


def test_a_step_of_brightness_costs_a_record():
    """Units lose 2 to 95 % of the records at a sharp step up by a factor of 9, as real ones at 4 to 9 across
    an edge, 40 to 95 % down, and 0.1 to 2 % at one of 1.5 by its height alone.

    Lost records up have high codes, few above 100; in dual return some are higher in the last return, as on
    nebula.
    """
    surface = (np.arange(8000) // 10 % 2)[:, None, None] + np.zeros((1, LASERS, 1), int)
    many, few = (
        [seen(table(low, 0.6), np.full((8000, LASERS, 1), 3.0), surface, seed=s) for s in range(10)]
        for low in (0.055, 0.4)
    )
    up, down = (np.array([lost(out)[first::20].mean() for out in many]) for first in (10, 20))
    assert 0.02 < up.min() < 0.2
    assert 0.4 < up.max() < 0.95
    assert 0.4 < down.min() < down.max() < 0.95
    assert 0.001 < np.mean([lost(out)[10::20].mean() for out in few]) < 0.02
    codes, last = (
        np.concatenate([out.reflectivity[10::20, :, i][lost(out)[10::20]] for out in many]) for i in (0, 1)
    )
    assert 40 < np.median(codes) <= 100
    assert 0.01 < (codes > 100).mean() < 0.06
    assert (last >= codes).all()
    assert 0.05 < (last > codes).mean() < 0.36


def test_lost_records_exceed_100_at_retroreflectors():
    """A fifth of the records that are lost where a pulse comes from a wall to a retroreflector, between
    all on mrpt and 3 of 20 on three units."""
    surface = (np.arange(8000) // 10 % 2)[:, None, None] + np.zeros((1, LASERS, 1), int)
    out = seen(table(0.5, 8.0), np.full((8000, LASERS, 1), 3.0), surface)
    codes = out.reflectivity[10::20, :, 0][lost(out)[10::20]]
    assert 0.15 < (codes > 100).mean() < 0.25


def test_what_is_nearer_than_the_least_range_is_no_step():
    """No record is lost where a thing at 0.3 m hides an eighth to three quarters of a wall's light."""
    surfaces = table(0.3, 0.9)
    surfaces["part"] = PlantPart.LEAF
    for hidden in (1, 3, 6):
        near = np.arange(8) < hidden
        range_m = np.broadcast_to(np.where(near, 0.3, 3.0), (500, LASERS, 8))
        assert not lost(seen(surfaces, range_m, np.where(near, 0, 1))).any()


def test_a_sensor_at_rest_loses_the_same_records_at_a_step_in_each_revolution():
    """A turn later a step of range loses at most half as many of the records that arrived as a draw for each
    pulse would; 20 degrees farther it loses as many."""
    surfaces = table(0.5, 0.5)
    surfaces["part"] = PlantPart.LEAF
    range_m = np.broadcast_to(np.repeat([3.0, 3.5], 4), (3600, LASERS, 8))
    for seed in range(3):
        found = lost(seen(surfaces, range_m, np.repeat([0, 0], 4), seed=seed))
        rate = found.mean()
        again = found[1800:][~found[:1800]].mean()
        assert again < 0.5 * rate
        beside = found[1900:3500][~found[:1600]].mean()
        assert beside == pytest.approx(rate, rel=0.2)


@pytest.mark.parametrize(
    ("sheet", "least", "most"), [("plants", 0.1, 0.5), ("one", 0.0, 0.004), ("ground", 0.0, 0.004)]
)
def test_two_surfaces_in_a_pulse_cost_it(sheet, least, most):
    """Half of the light each, half a metre apart, lose 0.1 to 0.5 of the records by unit, if the one before
    is not lost; a slanted surface none, nor two tiles of the ground."""
    surfaces = table(0.5, 0.5)
    surfaces["part"] = PlantPart.LEAF if sheet == "plants" else PlantPart.NONE
    surfaces["semantic"] = Semantic.GROUND if sheet == "ground" else Semantic.OTHER
    range_m = np.broadcast_to(np.repeat([3.0, 3.5], 4), (500, LASERS, 8))
    met = np.repeat([0, int(sheet == "ground")], 4)
    outs = [lost(seen(surfaces, range_m, met, seed=seed)) for seed in range(12)]
    rates = [out[1:][~out[:-1]].mean() for out in outs]  # after a lost one more are lost
    assert least - 0.02 <= min(rates) <= max(rates) <= most + 0.02


def test_an_echo_of_the_air_alone_has_one_surface():
    """In thick fog pulses whose sub-rays meet nothing have returns, and lose few: what is not met has no
    number to look up."""
    range_m = np.full((500, LASERS, 4), np.inf)
    here = [seen(table(0.5), range_m, NO_SURFACE, noise, visibility_m=10.0) for noise in (LOSSES, None)]
    least, most = ((~lost(out)).mean() for out in here)
    assert 0.9 * most < least <= most
    assert most > 0.05


def test_rough_places_lose_less():
    """Where ranges jump from pulse to pulse, as in trees, two surfaces in a pulse cost a fifth of what
    they do at an edge, as on real units."""
    surfaces = table(0.2, 0.2)
    surfaces["part"] = PlantPart.LEAF
    near_m = 20.0 + np.random.default_rng(1).uniform(0, 1.5, (2000, LASERS, 1))
    shares = []
    for first_m in (np.full_like(near_m, 20.0), near_m):
        range_m = np.concatenate([first_m, first_m, first_m, first_m + 0.6, first_m + 0.6], axis=2)
        shares.append([lost(seen(surfaces, range_m, 0, seed=seed)).mean() for seed in range(8)])
    assert 0.1 < np.mean(shares[1]) / np.mean(shares[0]) < 0.35


def test_blocks_make_the_whole():
    """A run in blocks has the same bytes wherever it is cut, between them."""
    rng = np.random.default_rng(3)
    surface = rng.integers(0, 2, (960, LASERS, 1))
    range_m = np.where(rng.random((960, LASERS, 1)) < 0.1, np.inf, 3.0)
    whole = seen(table(0.1, 0.6), range_m, surface, block=96)
    for first, stop in ((0, 480), (96, 192), (480, 960)):
        part = seen(table(0.1, 0.6), range_m[first:stop], surface[first:stop], index=first, block=96)
        np.testing.assert_array_equal(part.distance_m, whole.distance_m[first:stop])
        np.testing.assert_array_equal(part.reflectivity, whole.reflectivity[first:stop])


def test_no_returns_beside_returns_are_raised():
    """More often the brighter the return is (mrpt, nebula, 2014: 0.01 to 0.1 at 10, 0.33 to 0.82 at 70), by
    about its code, mostly alone.

    Few are above 100: on four units 0.5 % beside codes of 5 to 14, 2.2 to 4.6 % beside 40 to 79.
    """
    range_m = np.full((16_000, LASERS, 1), np.inf)
    range_m[::16] = 3.0
    share, ratio = [], []
    for reflectance in (0.1, 0.7):
        outs = [seen(table(reflectance), range_m, 0, LOSSES, seed=s) for s in range(8)]
        codes = np.concatenate([out.reflectivity[..., 0][1::16].ravel() for out in outs]).astype(float)
        base = np.concatenate([np.tile(out.reflectivity[8, :, 0], 1000) for out in outs])
        raised = codes > 1.5 * np.maximum(base, 1)
        share.append(raised.mean())
        ratio.append(np.quantile(codes[raised] / (100 * reflectance), [0.25, 0.5, 0.75]))
        few = (0.004, 0.009) if reflectance < 0.5 else (0.022, 0.08)
        assert few[0] < (codes > 100).mean() < few[1]
    assert 0.01 < share[0] < 0.15
    assert 0.3 < share[1] < 0.85
    np.testing.assert_allclose(ratio[1], [0.52, 0.78, 1.3], rtol=0.2)


def test_dual_return_loses_single_blocks():
    """Of pulses with two echoes some are without the odd block alone; pairs without range differ in code
    now and then."""
    range_m = np.broadcast_to(np.repeat([3.0, 9.0], 4), (4000, LASERS, 8))
    out = seen(table(0.2, 0.9), range_m, np.repeat([0, 1], 4))
    strongest, last = out.distance_m[..., 0] == 0, out.distance_m[..., 1] == 0
    alone = (strongest | ((out.distance_m[..., 2] == 0) & (out.reflectivity[..., 2] > 0))) & ~last
    assert 0.2 < alone.mean() / lost(out).mean() < 2.0
    assert 0 < (last & ~strongest).mean() < 0.3 * alone.mean()


def test_an_ideal_unit_loses_nothing():
    """All rates are 0 unless records are lost, so that nothing is drawn."""
    assert set(detector().constants.lost) == {0.0}
    assert set(loss_rates(5, Noise(preset="typical"))) == {0.0}


def test_smaller_steps_of_range_lose_fewer_records():
    """Pulses with half of their light on each of two surfaces are lost by the unit's rate from 0.4 m on, in
    proportion to the step below that, and not at all below 0.03 m; some more follow a lost one."""
    unit = LOSSES | {"spots_lost": 0.0}
    rates = loss_rates(1, Noise(preset="ideal", **unit))
    for step_m, share in ((0.02, 0.0), (0.1, 0.25), (0.2, 0.5), (0.4, 1.0), (1.2, 1.0)):
        range_m = np.broadcast_to([3.0, 3.0 + step_m], (3600, LASERS, 2))
        reflectance = 0.5, 0.5 * (3.0 + step_m) ** 2 / 9.0
        gone = lost(seen(table(*reflectance), range_m, [0, 1], unit)).mean()
        alone = share * rates.step
        assert 0.96 * alone <= gone <= 1.04 * alone / (1.0 - rates.again)
