"""Placements that are written out together."""

from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.raycast.baking import baked, lay_out
from vlp16emu.raycast.embree import EmbreeCaster
from vlp16emu.raycast.quads import faces_of
from vlp16emu.raycast.reference import ReferenceCaster
from vlp16emu.types import Mesh

SMALL = np.ones(3, np.bool_)


def renumbered(window, order):
    """The same window with its shapes numbered in another order."""
    shape = np.argsort(order)[window.shape].astype("i4")
    return replace(window, shapes=tuple(window.shapes[i] for i in order), shape=shape)


def test_every_placement_is_in_one_pile_or_an_instance(lab):
    """Small shapes are all gathered, large ones all left, and no placement is lost or doubled."""
    window = lab.placed(40)
    gathered = sum(len(pile.rows) for pile in lay_out(window, SMALL).piles)
    assert gathered == 40
    assert len(lay_out(window, SMALL).instances) == 0
    layout = lay_out(window, np.array([True, False, False]))
    assert set(window.shape[layout.instances]) == {1, 2}
    assert sum(len(pile.rows) for pile in layout.piles) + len(layout.instances) == 40


def test_what_stands_once_and_unturned_is_written_out(lab):
    """A large shape goes into a pile where it is placed once without turn or scale, and only there."""
    window = lab.placed(40)
    once = np.append(np.zeros(39, "i4"), np.int32(2))
    world_T_shape = window.world_T_shape.copy()
    world_T_shape[:, :, :3] = np.eye(3)
    layout = lay_out(replace(window, shape=once, world_T_shape=world_T_shape), ~SMALL)
    assert [pile.keys for pile in layout.piles] == [(3,)]
    turned = lay_out(replace(window, shape=once), ~SMALL)
    assert turned.piles == ()


def test_a_pile_has_the_same_name_in_every_window(lab):
    """Piles are equal whatever number a window gives to shapes and surfaces, and wherever its origin is."""
    window = lab.placed(40)
    other = replace(
        renumbered(window, [2, 0, 1]),
        origin_m=window.origin_m + 17.0,
        first_surface=(window.first_surface + 1000).astype("u4"),
    )
    ours, theirs = lay_out(window, SMALL), lay_out(other, SMALL)
    assert ours.piles == theirs.piles
    assert len(ours.piles) > 1
    assert np.array_equal(ours.first_surface + 1000, theirs.first_surface)


def test_baked_vertices_are_where_the_placements_put_them(lab):
    """Written out, each surface has the vertices of its mesh in the world, to a micrometre, and the same faces."""
    window = lab.placed(12)
    layout = lay_out(window, SMALL)
    seen = 0
    for pile, origin_m, first in zip(layout.piles, layout.origin_m, layout.first_surface, strict=True):
        faces = [[faces_of(mesh) for mesh in lab.soup(key)] for key in pile.keys]
        for row, (vertices_m, quads) in baked(pile, faces).items():
            placement, mesh = divmod(int(first) + row, 2)
            grown = lab.soup(window.shapes[window.shape[placement]])[mesh]
            place = window.world_T_shape[placement]
            there_m = grown.vertices_m @ place[:, :3].T + place[:, 3]
            assert np.abs(vertices_m[:-1] + origin_m - there_m).max() < 2e-6
            assert np.array_equal(quads, faces_of(grown)[1])
            seen += 1
    assert seen == 24


@pytest.mark.parametrize("few", [0, 10**6], ids=["instances", "piles"])
def test_hits_are_those_of_the_slow_twin_either_way(lab, workers, monkeypatch, few):
    """Turned, mirrored and scaled things hit the same, as instances and written out, also on one surface."""
    monkeypatch.setattr("vlp16emu.raycast.embree.FEW_QUADS", few)
    shared = lab.placed(30)
    shared = replace(shared, first_surface=(shared.first_surface // 4 * 2).astype("u4"))
    firings = lab.pulses(64)
    fast = EmbreeCaster(lab.soup, workers).open(shared).cast(firings, lab.near_m, lab.far_m)
    slow = ReferenceCaster(lab.soup).open(shared).cast(firings, lab.near_m, lab.far_m)
    hit = np.isfinite(slow.range_m)
    assert 0.5 < hit.mean() < 1.0
    assert np.array_equal(fast.surface, slow.surface)
    assert np.abs(fast.range_m[hit] - slow.range_m[hit]).max() < 5e-6
    assert np.abs(fast.cos_incidence - slow.cos_incidence).max() < 1e-5


def test_a_pile_is_kept_while_a_window_holds_it(lab, workers, monkeypatch):
    """A second window of the same place builds nothing; where one thing has moved, only its own pile."""
    made = []

    def counted(pile, faces):
        made.append(pile)
        return baked(pile, faces)

    monkeypatch.setattr("vlp16emu.raycast.embree.baked", counted)
    monkeypatch.setattr("vlp16emu.raycast.embree.FEW_QUADS", 10**6)
    caster, window = EmbreeCaster(lab.soup, workers), lab.placed(40)
    first = caster.open(window)
    piles = len(made)
    second = caster.open(renumbered(window, [1, 2, 0]))
    assert len(made) == piles > 1
    moved = window.world_T_shape.copy()
    moved[0, 2, 3] += 0.25
    third = caster.open(replace(window, world_T_shape=moved))
    assert len(made) == piles + 1
    assert first.surfaces is window.surfaces
    assert len({id(scene) for scene in (first, second, third)}) == 3


def test_an_empty_mesh_does_not_matter(lab, workers):
    """Meshes without faces in piles and instances are no obstacle, and hit nothing."""
    empty = Mesh(np.zeros((0, 3), "f4"), np.zeros((0, 3), "u4"))
    window, firings = lab.placed(30), lab.pulses(8)
    scene = EmbreeCaster(lambda _: (empty, empty), workers).open(window)
    assert np.isinf(scene.cast(firings, lab.near_m, lab.far_m).range_m).all()
