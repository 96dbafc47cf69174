"""Every model of a beam, by the caster and its slow twin."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from raycast import lab
from raycast.reference import ReferenceScene

WIDE = [
    "fixed",
    "adaptive",
    "angle",
    "offset",
]  # all but the line, of which `test_embree` says the same of more pulses


@pytest.mark.parametrize("model", WIDE)
def test_hits_are_those_of_the_slow_twin(workers, model):
    """Sub-rays, rounds and displaced hits of the fast caster equal those of brute force in float64."""
    # An adaptive beam is so narrow that pulses are far apart: the twin does not judge by neighbours (see
    # `test_adaptive`).
    narrow = {"divergence_mrad": (1.0, 0.5)} if model == "adaptive" else {}
    beam = lab.beam(model, rays=4 if model == "fixed" else 12, **narrow)
    scenes = lab.opened(workers), ReferenceScene(lab.placed(30), lab.soup)
    fast, slow = (one.cast(lab.pulses(8, every=4), lab.NEAR_M[::4], lab.FAR_M, beam) for one in scenes)
    assert (fast.count == slow.count).all()
    hit = np.isfinite(fast.range_m)
    assert hit.mean() > 0.2
    assert (fast.surface == slow.surface).all()
    assert np.abs(fast.range_m[hit] - slow.range_m[hit]).max() < 2e-5


@pytest.mark.parametrize("model", ["none", *WIDE])
def test_threads_do_not_matter(workers, model):
    """Eight casts at once on a shared scene give the bits of one cast alone."""
    scene, firings, beam = lab.opened(workers), lab.pulses(160), lab.beam(model, rays=8)
    alone = scene.cast(firings, lab.NEAR_M, lab.FAR_M, beam)
    with ThreadPoolExecutor(8) as pool:
        for hits in pool.map(lambda _: scene.cast(firings, lab.NEAR_M, lab.FAR_M, beam), range(8)):
            lab.assert_same_bits(hits, alone)


@pytest.mark.parametrize(("size", "count"), [(8, 8), (1920, 2)])
@pytest.mark.parametrize("model", ["none", *WIDE])
def test_batches_do_not_matter(workers, model, size, count):
    """Cast by eights, or two blocks in one go and sector by sector over all of them, pulses meet what they
    meet alone, bit by bit."""
    scene, beam = lab.opened(workers), lab.beam(model, rays=8)
    pieces = [lab.pulses(size, first=n * size) for n in range(count)]
    alone = lab.joined([scene.cast(piece, lab.NEAR_M, lab.FAR_M, beam) for piece in pieces])
    lab.assert_same_bits(scene.cast(lab.pulses(count * size), lab.NEAR_M, lab.FAR_M, beam), alone)


def test_a_fan_of_sub_rays_may_have_any_number(workers):
    """Counts that fill no packet lose nothing: s sub-rays are the first s of more."""
    scene, firings = lab.opened(workers), lab.pulses(8)
    many = scene.cast(firings, lab.NEAR_M, lab.FAR_M, lab.beam("fixed", rays=19))
    for rays in (2, 7, 13):
        few = scene.cast(firings, lab.NEAR_M, lab.FAR_M, lab.beam("fixed", rays=rays))
        assert (few.range_m.reshape(-1, rays) == many.range_m.reshape(-1, 19)[:, :rays]).all()
