"""Every model of a beam, by the caster and its slow twin."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from raycast import lab
from raycast.reference import ReferenceCaster

from vlp16emu.raycast.near import EmbreeCaster

WIDE = ["fixed", "adaptive", "angle", "offset"]  # all but the line, of which `test_embree` says the same of more pulses


def cast(caster, firings, beam, count=30):
    return caster.open(lab.placed(count)).cast(firings, lab.NEAR_M, lab.FAR_M, beam)


def assert_same(ours, other, *, range_m):
    """Both have the same number of sub-rays for each pulse, and each met the same."""
    assert (ours.count == other.count).all()
    hit = np.isfinite(ours.range_m)
    assert hit.mean() > 0.2
    assert (ours.surface == other.surface).mean() > 0.9999
    same = hit & (ours.surface == other.surface)
    assert np.abs(ours.range_m[same] - other.range_m[same]).max() < range_m


def apart(model, **changed):
    """A beam, if adaptive so narrow that pulses are far apart: twins do not judge by neighbours (see `test_adaptive`)."""
    narrow = {"divergence_mrad": (1.0, 0.5)} if model == "adaptive" else {}
    return lab.beam(model, **narrow, **changed)


@pytest.mark.parametrize("model", WIDE)
def test_hits_are_those_of_the_slow_twin(workers, model):
    """Sub-rays, rounds and displaced hits of the fast caster equal those of brute force in float64."""
    firings, beam = lab.pulses(8), apart(model, rays=4 if model == "fixed" else 12)
    fast = cast(EmbreeCaster(lab.world(lab.soup), workers), firings, beam)
    slow = cast(ReferenceCaster(lab.soup), firings, beam)
    assert_same(fast, slow, range_m=2e-5)


@pytest.mark.parametrize("model", ["none", *WIDE])
def test_threads_do_not_matter(workers, model):
    """Eight casts at once on a shared scene give the bits of one cast alone."""
    scene, firings = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.pulses(320)
    beam = lab.beam(model)
    alone = scene.cast(firings, lab.NEAR_M, lab.FAR_M, beam)
    with ThreadPoolExecutor(8) as pool:
        for hits in pool.map(lambda _: scene.cast(firings, lab.NEAR_M, lab.FAR_M, beam), range(8)):
            lab.assert_same_bits(hits, alone)


@pytest.mark.parametrize(("size", "count"), [(8, 8), (1920, 2)])
@pytest.mark.parametrize("model", ["none", *WIDE])
def test_batches_do_not_matter(workers, model, size, count):
    """Cast by eights, or two blocks in one go and sector by sector over all of them, pulses meet what they meet alone, bit by bit."""
    scene, beam = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.beam(model)
    pieces = [lab.pulses(size, first=n * size) for n in range(count)]
    alone = lab.joined([scene.cast(piece, lab.NEAR_M, lab.FAR_M, beam) for piece in pieces])
    lab.assert_same_bits(scene.cast(lab.pulses(count * size), lab.NEAR_M, lab.FAR_M, beam), alone)


def test_a_fan_of_sub_rays_may_have_any_number(workers):
    """Counts that fill no packet lose nothing: s sub-rays are the first s of more."""
    scene, firings = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.pulses(8)
    many = scene.cast(firings, lab.NEAR_M, lab.FAR_M, lab.beam("fixed", rays=19))
    for rays in (2, 7, 13):
        few = scene.cast(firings, lab.NEAR_M, lab.FAR_M, lab.beam("fixed", rays=rays))
        assert (few.range_m.reshape(-1, rays) == many.range_m.reshape(-1, 19)[:, :rays]).all()
