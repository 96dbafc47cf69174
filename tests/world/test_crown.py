"""Crown prototypes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from vlp16emu.world.crown import CrownKey, crown_meshes
from vlp16emu.world.species import species_table, taper_radius_m

BIRCH = CrownKey("silver_birch", 0, 0, 0.18, 19.0, 9.5, 3.42, 42.0)
SPRUCE = CrownKey("norway_spruce", 0, 0, 0.24, 21.0, 12.0, 3.84, 98.0)
BOTH = pytest.mark.parametrize("key", [BIRCH, SPRUCE], ids=["birch", "spruce"])
LEVELS = pytest.mark.parametrize("level", [0, 1, 2])


def corners(mesh):
    return mesh.vertices_m[mesh.faces].astype(np.float64)


def quad_areas_m2(mesh):
    a, b, c, d = np.moveaxis(corners(mesh), 1, 0)
    return np.linalg.norm(np.cross(c - a, d - b), axis=1) / 2


@BOTH
@LEVELS
def test_leaf_area_is_kept_at_every_level(key, level):
    """Quads have the tree's leaf area, over the clumping of its shoots, within 0.1 % at each level of detail."""
    leaves = crown_meshes(4, replace(key, level=level))[2]
    target = key.leaf_area_m2 / species_table()[key.species].foliage.clumping
    assert quad_areas_m2(leaves).sum() == pytest.approx(target, rel=1e-3)


@BOTH
def test_leaves_are_planar_and_as_large_as_in_nature(key):
    """Corners of a quad lie in one plane to a micrometre, and a mean blade or shoot has its species' length."""
    leaves = corners(crown_meshes(4, key)[2])
    a, b, c, d = np.moveaxis(leaves, 1, 0)
    normal = np.cross(c - a, d - b)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(((b - a) * normal).sum(axis=1)).max() < 2e-6
    length = np.linalg.norm(c - a, axis=1) if key is BIRCH else np.linalg.norm(d - a, axis=1)
    assert length.mean() == pytest.approx(species_table()[key.species].foliage.length_m, rel=0.03)


@LEVELS
def test_birch_leaves_are_inclined_as_measured(level):
    """Leaf inclination passes a Kolmogorov-Smirnov test against its beta distribution; mean 55.6 degrees."""
    a, b, c, d = np.moveaxis(corners(crown_meshes(4, replace(BIRCH, level=level))[2]), 1, 0)
    normal = np.cross(c - a, d - b)
    zenith = np.arccos(np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1))
    assert np.degrees(zenith.mean()) == pytest.approx(55.6, abs=1.0)
    assert stats.kstest(zenith[:4000] / (np.pi / 2), stats.beta(2.34, 1.45).cdf).pvalue > 0.01


@BOTH
@LEVELS
def test_crown_fills_its_width_and_length(key, level):
    """Foliage spans the crown width within a fifth, and reaches from about the crown base to about the tip."""
    vertices = crown_meshes(4, replace(key, level=level))[2].vertices_m
    width = np.ptp(vertices[:, :2], axis=0)
    assert width / key.crown_width_m == pytest.approx([1.1, 1.1], abs=0.2)
    assert vertices[:, 2].min() == pytest.approx(-0.4, abs=0.8)
    assert vertices[:, 2].max() == pytest.approx(key.crown_length_m + 0.2, abs=0.6)


@BOTH
def test_branches_begin_on_the_axis_inside_the_stem(key):
    """Each first-order tube begins with a ring around the axis that is narrower than the stem there."""
    first = crown_meshes(4, key)[0]
    sides, rings = 6, 8
    ring = first.vertices_m.reshape(-1, sides * rings + 1, 3)[:, :sides].astype(np.float64)
    middle = ring.mean(axis=1)
    assert np.abs(middle[:, :2]).max() < 1e-6
    at_m = key.crown_base_m + middle[:, 2]
    taper = np.array([species_table()[key.species].taper])
    stem = taper_radius_m(taper, np.array([key.dbh_m]), np.array([key.height_m]), at_m[None])[0]
    branch = np.linalg.norm(ring - middle[:, None], axis=2).max(axis=1)
    assert (branch < np.maximum(0.65 * stem, 0.0011)).all()
    assert (middle[:, 2] >= 0).all()


@BOTH
def test_branches_are_together_as_thick_as_the_stem(key):
    """Pipe model: first-order cross-sections add up to that of the stem at the crown base, within 15 %."""
    first = crown_meshes(4, key)[0]
    ring = first.vertices_m.reshape(-1, 49, 3)[:, :6].astype(np.float64)
    corner = np.linalg.norm(ring - ring.mean(axis=1, keepdims=True), axis=2).mean(axis=1)
    radius = corner * np.sin(np.pi / 6) / (np.pi / 6)
    taper = np.array([species_table()[key.species].taper])
    base = np.array([[key.crown_base_m]])
    stem = taper_radius_m(taper, np.array([key.dbh_m]), np.array([key.height_m]), base)[0, 0]
    assert (radius**2).sum() == pytest.approx(stem**2, rel=0.15)


@BOTH
def test_coarser_levels_keep_the_branches(key):
    """First-order tips are at the same places at every level, and each level has at most half the faces."""
    levels = [crown_meshes(4, replace(key, level=level)) for level in range(3)]
    tips = [m[0].vertices_m[n - 1 :: n] for m, n in zip(levels, (49, 17, 7), strict=True)]
    assert np.array_equal(tips[0], tips[1])
    assert np.array_equal(tips[0], tips[2])
    faces = [sum(len(mesh.faces) for mesh in meshes) for meshes in levels]
    assert faces[1] < faces[0] / 2
    assert faces[2] < faces[1] / 2


@BOTH
def test_tubes_show_their_outside(key):
    """Faces of a branch are turned outwards: it encloses a volume between a thin cone and a cylinder."""
    first = crown_meshes(4, key)[0]
    vertices, faces = first.vertices_m[:49].astype(np.float64), first.faces[:90]
    assert (faces < 49).all()
    assert (first.faces[90:] >= 49).all()
    # About the middle of the open end the missing lid has no volume.
    a, b, c = np.moveaxis((vertices - vertices[:6].mean(axis=0))[faces], 1, 0)
    radius, length = (
        np.linalg.norm(vertices[0] - vertices[:6].mean(axis=0)),
        np.linalg.norm(vertices[48] - vertices[0]),
    )
    volume = (a * np.cross(b, c)).sum() / 6
    assert 0.2 * np.pi * radius**2 * length < volume < np.pi * radius**2 * length


@BOTH
def test_a_crown_depends_on_seed_and_key_alone(key):
    """The same seed and key give the same bytes; another seed or variant gives another crown."""

    def bytes_of(seed, which):
        return b"".join(m.vertices_m.tobytes() + m.faces.tobytes() for m in crown_meshes(seed, which))

    assert bytes_of(4, key) == bytes_of(4, replace(key))
    assert len({bytes_of(4, key), bytes_of(5, key), bytes_of(4, replace(key, variant=1))}) == 3
