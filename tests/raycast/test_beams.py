"""Every model of a beam, by the caster and its slow twin."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from raycast.reference import ReferenceCaster

from vlp16emu.raycast.beam import LINE
from vlp16emu.raycast.near import EmbreeCaster

WIDE = ["fixed", "adaptive", "angle", "offset"]
"""All but the line, of which `test_embree` says the same of more pulses."""


def cast(caster, lab, firings, beam, count=30):
    return caster.open(lab.placed(count)).cast(firings, lab.near_m, lab.far_m, beam)


def assert_same(ours, other, *, range_m):
    """Both have the same number of sub-rays for each pulse, and each met the same."""
    assert (ours.count == other.count).all()
    hit = np.isfinite(ours.range_m)
    assert hit.mean() > 0.2
    assert (ours.surface == other.surface).mean() > 0.9999
    same = hit & (ours.surface == other.surface)
    assert np.abs(ours.range_m[same] - other.range_m[same]).max() < range_m


def apart(lab, model, **changed):
    """A beam, if adaptive so narrow that pulses are far apart: twins do not judge by neighbours (see `test_adaptive`)."""
    narrow = {"divergence_mrad": (1.0, 0.5)} if model == "adaptive" else {}
    return lab.beam(model, **narrow, **changed)


@pytest.mark.parametrize("model", WIDE)
def test_hits_are_those_of_the_slow_twin(lab, workers, model):
    """Sub-rays, rounds and displaced hits of the fast caster equal those of brute force in float64."""
    firings, beam = lab.pulses(8), apart(lab, model, rays=12)
    fast = cast(EmbreeCaster(lab.world(lab.soup), workers), lab, firings, beam)
    slow = cast(ReferenceCaster(lab.soup), lab, firings, beam)
    assert_same(fast, slow, range_m=2e-5)


def test_a_line_is_the_default(lab, workers):
    """Without a word on the beam, each pulse is one ray along its middle."""
    scene, firings = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.pulses(64)
    plain, said = (scene.cast(firings, lab.near_m, lab.far_m, *beam) for beam in ((), (LINE,)))
    assert (plain.range_m == said.range_m).all()
    assert (plain.count == 1).all()


def test_a_fixed_beam_is_the_same_in_pieces(lab, workers):
    """Sub-rays belong to firing numbers: cast in one go or by eights, the same bits."""
    scene, beam = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.beam("fixed", rays=12)
    whole = scene.cast(lab.pulses(32), lab.near_m, lab.far_m, beam)
    pieces = [scene.cast(lab.pulses(8, first=n), lab.near_m, lab.far_m, beam) for n in range(0, 32, 8)]
    assert (np.concatenate([piece.range_m for piece in pieces]) == whole.range_m).all()
    assert (np.concatenate([piece.cos_incidence for piece in pieces]) == whole.cos_incidence).all()


@pytest.mark.parametrize("model", WIDE)
def test_threads_do_not_matter(lab, workers, model):
    """Four casts at once on a shared scene give the bits of one cast alone."""
    scene, firings, beam = (
        EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)),
        lab.pulses(320),
        lab.beam(model),
    )
    alone = scene.cast(firings, lab.near_m, lab.far_m, beam)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda _: scene.cast(firings, lab.near_m, lab.far_m, beam), range(4)))
    for hits in together:
        assert (hits.count == alone.count).all()
        assert (hits.range_m == alone.range_m).all()
        assert (hits.surface == alone.surface).all()


@pytest.mark.parametrize("model", ["none", *WIDE])
def test_revolutions_cast_at_once_are_those_cast_alone(lab, workers, model):
    """Five blocks in one go, sector by sector over all of them, meet what each meets by itself, bit by bit."""
    scene, beam = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.beam(model)
    whole = scene.cast(lab.pulses(5 * 1920), lab.near_m, lab.far_m, beam)
    alone = [scene.cast(lab.pulses(1920, first=n * 1920), lab.near_m, lab.far_m, beam) for n in range(5)]
    for name in ("count", "range_m", "surface", "cos_incidence"):
        assert (np.concatenate([getattr(hits, name) for hits in alone]) == getattr(whole, name)).all()


def test_a_fan_of_sub_rays_may_have_any_number(lab, workers):
    """Counts that fill no packet lose nothing: s sub-rays are the first s of more."""
    scene, firings = EmbreeCaster(lab.world(lab.soup), workers).open(lab.placed(30)), lab.pulses(8)
    many = scene.cast(firings, lab.near_m, lab.far_m, lab.beam("fixed", rays=19))
    for rays in (2, 7, 13):
        few = scene.cast(firings, lab.near_m, lab.far_m, lab.beam("fixed", rays=rays))
        assert (few.range_m.reshape(-1, rays) == many.range_m.reshape(-1, 19)[:, :rays]).all()


def test_nothing_in_sight_is_all_misses(lab, workers):
    """An adaptive beam in an empty window ends after its first round."""
    hits = cast(EmbreeCaster(lab.world(lab.soup), workers), lab, lab.pulses(8), lab.beam("adaptive"), count=0)
    assert (hits.count == 8).all()
    assert np.isinf(hits.range_m).all()
