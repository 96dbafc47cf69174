"""Figures of the stand near a path."""

import numpy as np
import pytest

from vlp16emu.extras.survey import CELL_M, cells_near, clark_evans, relief, stand_rows

TREES = np.array(
    [(1, 0.10, 8.0, 0.05, 10.0), (1, 0.30, 20.0, 0.70, 60.0), (7, 0.50, 25.0, 2.00, 130.0)],
    [("species", "u2"), ("dbh_m", "f8"), ("height_m", "f8"), ("stem_m3", "f8"), ("leaf_m2", "f8")],
)


def test_rows_add_up_to_sums_by_hand():
    """Density, quadratic mean diameter, basal area, volume and leaf area follow from the trees and the
    area."""
    birch, oak, together = stand_rows(TREES, {1: "silver_birch", 7: "english_oak"}, 500.0)
    assert (birch["species"], oak["species"], together["species"]) == ("silver_birch", "english_oak", "all")
    assert (birch["stems"], birch["stems_per_ha"]) == (2, 40.0)
    assert birch["dbh_mean_cm"] == pytest.approx(100 * np.sqrt((0.01 + 0.09) / 2))
    assert (birch["dbh_min_cm"], birch["dbh_max_cm"]) == (10.0, 30.0)
    assert birch["basal_area_m2_per_ha"] == pytest.approx(np.pi / 4 * 0.10 * 20)
    assert together["stem_m3_per_ha"] == pytest.approx(2.75 * 20)
    assert together["leaf_area_index"] == pytest.approx(200 / 500)
    assert together["height_max_m"] == 25.0
    # A pure stand has one row, and a bare plain has none.
    assert [row["species"] for row in stand_rows(TREES[:2], {1: "silver_birch"}, 500.0)] == ["silver_birch"]
    assert stand_rows(TREES[:0], {}, 500.0) == []


def test_clark_evans_knows_lattices_and_rain():
    """A square lattice has index 2, a triangular one 2.149, and points that fall like rain 1."""
    square = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    inner = square[((square > 9.5) & (square < 29.5)).all(axis=1)]
    assert clark_evans(inner, square, 400.0) == pytest.approx(2.0)
    triangle = square * [1.0, np.sqrt(3) / 2] + np.where(square[:, 1:] % 2 == 1, [0.5, 0.0], [0.0, 0.0])
    inner = triangle[((square > 9.5) & (square < 29.5)).all(axis=1)]
    assert clark_evans(inner, triangle, 400 * np.sqrt(3) / 2) == pytest.approx(2.1491, abs=1e-4)
    rain = np.random.default_rng(3).uniform(0, 100, (10_000, 2))
    inner = rain[((rain > 10) & (rain < 90)).all(axis=1)]
    assert clark_evans(inner, rain, 6400.0) == pytest.approx(1.0, abs=0.02)  # sigma 0.26 / sqrt(6400) / 0.5


def test_cells_cover_the_surroundings_of_a_way():
    """Cells within 20 m of a straight way of 50 m cover a rectangle and two half circles."""
    way = np.array([[0.0, 0.0], [50.0, 0.0]])
    cells = cells_near(way, 20.0)
    assert len(cells) * CELL_M**2 == pytest.approx(50 * 40 + np.pi * 400, rel=2e-3)


def test_relief_of_a_plane_is_its_slope():
    """On a plane that rises 3 in 4 the slope is 36.87 degrees everywhere, whichever way it faces."""
    cells = cells_near(np.zeros((1, 2)), 10.0)
    found = relief(cells, lambda x, y: 0.75 * (0.6 * x + 0.8 * y))
    assert found["slope_mean_deg"] == pytest.approx(np.degrees(np.arctan(0.75)))
    assert found["slope_max_deg"] == pytest.approx(found["slope_mean_deg"])
    assert found["high_m"] == pytest.approx(7.5, abs=0.3)
    assert found["low_m"] == pytest.approx(-found["high_m"])
