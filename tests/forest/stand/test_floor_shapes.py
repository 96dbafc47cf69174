"""Shapes of what lies on the ground."""

import numpy as np
import pytest
import trimesh
from forest.kit import areas_m2, corners, section_m2
from scipy.spatial import ConvexHull

from vlp16emu.forest.stand.floor_shapes import FLOOR_VARIANTS, FloorKey, FloorKind, floor, floor_meshes
from vlp16emu.forest.stand.scatter import _LAYERS
from vlp16emu.types import PlantPart, Semantic

KEYS = [FloorKey(kind, variant) for kind in FloorKind for variant in (0, 5)]
KEYS += [FloorKey(FloorKind.STONE, variant, large=True) for variant in (0, 5)]
WOOD = (FloorKind.LOG, FloorKind.STUMP, FloorKind.BROKEN_LOG, FloorKind.BROKEN_STUMP, FloorKind.ROOT_PLATE)
SOLID = [key for key in KEYS if key.kind in (FloorKind.STONE, *WOOD)]
LOW = [key for key in KEYS if key not in SOLID and key.kind is not FloorKind.TUFT]


def of_kind(kind):
    return [key for key in KEYS if key.kind is kind]


def solid(key):
    (mesh,) = floor_meshes(8, key)
    return trimesh.Trimesh(mesh.vertices_m.astype(np.float64), mesh.faces, process=False)


def test_stones_and_dead_wood_are_closed_and_show_their_outside():
    """Every edge has two faces that run against each other, and the enclosed volume is positive."""
    for key in SOLID:
        body = solid(key)
        assert body.is_watertight, key
        assert body.is_winding_consistent, key
        assert body.volume > 0.1, key


def test_a_stone_has_unit_height_and_the_outline_of_a_unit_circle():
    """Stones span -0.5 to 0.5 in z, and the convex outline from above has the area pi / 4; they are no
    spheres."""
    for key in of_kind(FloorKind.STONE):
        body = solid(key)
        assert body.bounds[:, 2] == pytest.approx([-0.5, 0.5], abs=1e-6), key
        assert ConvexHull(body.vertices[:, :2]).volume == pytest.approx(np.pi / 4, rel=1e-5), key
        assert np.linalg.norm(body.vertices, axis=1).std() > 0.01, key


def test_a_log_has_unit_length_and_mean_diameter():
    """In its middle a log's cross-section has the area of a circle of diameter 1 within 1 %; it is thicker
    at -x."""
    for key in of_kind(FloorKind.LOG):
        body = solid(key)
        assert body.bounds[:, 0] == pytest.approx([-0.5, 0.5], abs=0.03), key
        areas = [section_m2(body, [1, 0, 0], [x, 0, 0]) for x in (-0.3, 0.001, 0.3)]
        assert areas[1] == pytest.approx(np.pi / 4, rel=0.01), key
        assert areas[0] > areas[1] > areas[2], key
        middle = [body.vertices[np.abs(body.vertices[:, 0] - x) < 0.05, 1].mean() for x in (-0.5, 0, 0.5)]
        assert 0.02 < abs(middle[1] - (middle[0] + middle[2]) / 2) < 3, key


@pytest.mark.parametrize(
    ("kind", "low", "high", "off"),
    [
        (FloorKind.STUMP, (-0.8, -0.8, -0.5), (0.8, 0.8, 1.0), 0.17),
        (FloorKind.BROKEN_STUMP, (-0.8, -0.8, -0.5), (0.8, 0.8, 1.4), 0.17),
        (FloorKind.ROOT_PLATE, (-1.25, -0.55, -0.55), (0.22, 0.55, 0.55), 0.35),
    ],
)
def test_stumps_and_root_plates_reach_as_far_as_they_should(kind, low, high, off):
    """A stump is 1 high, 1.6 wide at its buried foot; behind a plate of 1.1, flat towards its log at +x,
    roots reach out; a broken top is hollow."""
    for key in of_kind(kind):
        body = solid(key)
        np.testing.assert_allclose(body.bounds, [low, high], atol=off)
        if kind is FloorKind.BROKEN_STUMP:
            rim_m, middle_m = body.vertices[48:64, 2], body.vertices[-1, 2]
            assert np.ptp(rim_m) > 0.5
            assert middle_m < rim_m.mean() - 0.2


def test_a_tuft_has_its_leaf_area():
    """Blades reach a height of 1 and have their area together, within 3 %."""
    for key in of_kind(FloorKind.TUFT):
        (mesh,) = floor_meshes(8, key)
        assert areas_m2(corners(mesh)).sum() == pytest.approx(22 * 0.012, rel=0.03), key
        assert mesh.vertices_m[:, 2].max() == pytest.approx(1.0, abs=1e-6), key
        assert mesh.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-6), key


def test_what_covers_the_ground_has_unit_size():
    """Ferns, herbs, dwarf shrubs, moss and litter are 1 high and reach to 0.5 aside; only moss reaches
    into the ground."""
    for key in LOW:
        vertices_m = floor_meshes(8, key)[0].vertices_m
        assert vertices_m[:, 2].max() == pytest.approx(1.0, abs=1e-6), key
        assert np.hypot(*vertices_m[:, :2].T).max() == pytest.approx(0.5, abs=1e-6), key
        assert (vertices_m[:, 2].min() < -0.2) == (key.kind is FloorKind.MOSS_CUSHION), key
        assert vertices_m[:, 2].min() > -0.6, key


def test_variants_differ_and_depend_on_the_seed_alone():
    """Six variants have six forms, the same seed gives the same bytes, and another seed others."""

    def bytes_of(seed, kind, variant):
        return floor_meshes(seed, FloorKey(kind, variant))[0].vertices_m.tobytes()

    for kind in FloorKind:
        forms = {bytes_of(8, kind, variant) for variant in range(FLOOR_VARIANTS)}
        assert len(forms | {bytes_of(9, kind, 0)}) == FLOOR_VARIANTS + 1 == 7, kind
        assert bytes_of(8, kind, 2) == bytes_of(8, kind, 2), kind


def test_every_kind_and_layer_is_a_row_with_a_source():
    """`floor.toml` has a row for each kind, with labels that exist, and one for each layer; each says its
    source."""
    rows = floor()
    assert list(rows) == ["shapes", "layers"]
    assert set(rows["shapes"]) == {kind.value for kind in FloorKind}
    assert set(rows["layers"]) == {name for name, _ in _LAYERS.values()}
    assert all(row["source"] for section in rows.values() for row in section.values())
    for row in rows["shapes"].values():
        assert row["semantic"] in Semantic.__members__
        assert row["part"] in PlantPart.__members__
        assert 0.0 < row["reflectance"] < 1.0
