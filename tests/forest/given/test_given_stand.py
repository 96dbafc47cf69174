"""A stand of given trees."""

import numpy as np
import pytest

from vlp16emu.errors import GeometryError
from vlp16emu.forest.given.given_stand import GivenStand
from vlp16emu.forest.plants.flora import flora, species_table
from vlp16emu.forest.stand.settings import Plot
from vlp16emu.world.polyline import Corridor

HEADER = "x,y,species,dbh_cm,height_m,crown_base_m,crown_width_m,lean_deg,lean_azimuth_deg\n"
ROWS = """\
3,4,silver_birch,20,20,9,4,0,0
-3,4,norway_spruce,30,25,12,4,0,0
21,4,norway_spruce,32,26,13,5,0,0
19.5,-0.5,silver_birch,50,27,13,8,0,0
4,5,silver_birch,21,21,9,5,0,0
"""
FAR_AWAY = np.array([[500.0, 500.0], [510.0, 500.0]])


@pytest.fixture
def make(tmp_path):
    def make_stand(rows=ROWS, path_xy_m=FAR_AWAY, path_clearance_m=0.8, on_conflict="refuse"):
        path = tmp_path / "stems.csv"
        path.write_text(HEADER + rows, encoding="utf-8")
        return GivenStand(
            Plot(kind="plot", stem_list=str(path), on_conflict=on_conflict),
            seed=1,
            height_m=lambda x, y: 0.1 * x + 0.01 * y,
            path=Corridor(path_xy_m, path_clearance_m),
            plants=flora(),
        )

    return make_stand


def test_each_tree_stands_on_its_own_tile_and_on_the_ground(make):
    """A tile has the trees whose foot lies in it, in the order of the list, and their feet are on the ground."""
    stand = make()
    found = {(i, j): stand.trees(i, j) for i in range(-2, 3) for j in range(-2, 3)}
    places = {tile: trees["x_m"].tolist() for tile, trees in found.items() if len(trees)}
    assert places == {(0, 0): [3, 4], (-1, 0): [-3], (1, 0): [21], (0, -1): [19.5]}
    trees = found[0, 0]
    assert trees["z_m"] == pytest.approx(0.1 * trees["x_m"] + 0.01 * trees["y_m"])
    assert (trees["id"] == 0).all()


def test_the_densest_tile_tells_how_dense_the_stand_is(make):
    """Two trees on 0.04 ha are 50 per hectare."""
    assert make().per_ha == pytest.approx(50)


def test_crowns_are_prototypes_of_the_lists_own_trees(make):
    """Trees of one species and class share the crown of their mean; its leaves are the species' LAI on its projection."""
    stand = make()
    one, other = stand.trees(0, 0)
    keys = [stand.crown(int(t["cohort"]), int(t["crown_class"]), 1) for t in (one, other)]
    assert keys[0] == keys[1]
    key = keys[0]
    assert key.species == "silver_birch"
    assert (key.dbh_m, key.height_m, key.crown_base_m, key.crown_width_m) == pytest.approx((0.205, 20.5, 9, 4.5))
    lai = species_table()["silver_birch"].leaf_area_index
    assert key.leaf_area_m2 == pytest.approx(lai * np.pi / 4 * 4.5**2)


def test_a_tree_more_at_the_end_changes_no_other(make):
    """What chance adds to a tree depends on its line alone."""
    short, long = make(), make(ROWS + "8,8,silver_birch,30,22,9,5,0,0\n")
    assert short.trees(0, 0).tolist() == long.trees(0, 0)[:2].tolist()
    assert len(long.trees(0, 0)) == 3


def test_trees_in_the_way_are_refused_all_at_once(make):
    """Stems whose surface comes nearer to the path than the clearance are named by line and place, with their distance."""
    path = np.array([[0.0, 4.7], [10.0, 4.7]])
    rows = ROWS + "8,5,silver_birch,20,20,9,4,0,0\n"
    message = r"2 of 6 trees nearer to the path than path_clearance_m = 0.3: line 6 at \(4, 5\) m, 0.1\d m away; line 7 at \(8, 5\) m, 0.1"
    with pytest.raises(GeometryError, match=message):
        make(rows, path_xy_m=path, path_clearance_m=0.3)
    make(rows, path_xy_m=path, path_clearance_m=0.1)


def test_trees_in_the_way_are_dropped_on_request(make, caplog):
    """They are left out with a warning that names them; the others are the same trees as without them."""
    path, rows = np.array([[0.0, 4.7], [10.0, 4.7]]), ROWS + "8,5,silver_birch,20,20,9,4,0,0\n"
    stand = make(rows, path, 0.3, on_conflict="drop")
    assert "left out 2 of 6 trees nearer to the path than path_clearance_m = 0.3: line 6 at" in caplog.text
    assert stand.trees(0, 0).tolist() == make(rows).trees(0, 0)[:1].tolist()


def test_a_leaning_stem_must_keep_clear_above_too(make):
    """A stem that leans over the path at the height of a head is in the way though its foot is not."""
    path = np.array([[4.0, -5.0], [4.0, 5.0]])
    row = "2,0,silver_birch,20,20,9,4,{},90\n"
    make(row.format(0), path)
    with pytest.raises(GeometryError, match="m away"):
        make(row.format(30), path)
