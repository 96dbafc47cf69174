"""Lists of measured stems, and a stand of them."""

import csv
from itertools import product

import numpy as np
import pytest

from vlp16emu.errors import GeometryError
from vlp16emu.foliage.polyline import Corridor
from vlp16emu.forest.plants.prototypes import CrownKey, crown_meshes
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.plants.stem import stem_meshes
from vlp16emu.forest.settings import Plot
from vlp16emu.forest.stand.given_stand import GivenStand, read_stem_list
from vlp16emu.forest.stand.inventory import INVENTORY, far_stems, write_csv
from vlp16emu.forest.stand.points import Land
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.raycast.pieces import faces_of, split_into_pieces

LIST = """\
x,y,species,dbh_cm,height_m,crown_base_m,crown_width_m,lean_deg,lean_azimuth_deg,remark
1.5,2.5,Picea abies,30,25,10,4.5,2,90,old
-3,4,silver birch,20.5,21,8,4,,,
10,-7.25, NORWAY-SPRUCE ,40,28,,,0,0,forked
"""
NO_ORIGIN = (0.0, 0.0, 0.0)


def read(tmp_path, text=LIST, origin_m=NO_ORIGIN):
    path = tmp_path / "stems.csv"
    path.write_text(text, encoding="utf-8")
    return read_stem_list(path, flora().trees, origin_m)


def test_a_list_is_read_as_it_stands(tmp_path):
    """Place less the origin, species in any spelling, diameter, height, crown and lean come from the list,
    in its order; others are ignored."""
    trees, table = read(tmp_path), flora().trees
    moved = read(tmp_path, origin_m=(1.0, 2.0, 300.0))
    assert (moved["x_m"].tolist(), moved["y_m"].tolist()) == ([0.5, -4, 9], [0.5, 2, -9.25])
    columns = ["x_m", "y_m", "height_m", "lean_deg", "lean_towards_deg", "list_line"]
    rows = [(1.5, 2.5, 25, 2, 0, 2), (-3, 4, 21, 0, 0, 3), (10, -7.25, 28, 0, 90, 4)]  # azimuth 90 is east
    assert trees[columns].tolist() == rows
    names = ["norway_spruce", "silver_birch", "norway_spruce"]
    assert trees["species"].tolist() == [table[name].number for name in names]
    assert trees["dbh_m"] == pytest.approx([0.30, 0.205, 0.40])
    assert trees["crown_base_m"][:2].tolist() == [10, 8]
    assert trees["crown_width_m"][:2].tolist() == [4.5, 4]


def test_diameters_in_millimetres_are_refused(tmp_path):
    """A list whose middle tree is less than 12 times as high as thick is one of millimetres; a single such
    tree is not."""
    rows = "x,y,species,dbh_cm,height_m\n"
    rows += "1,2,silver_birch,{},21\n5,2,silver_birch,{},22\n9,2,silver_birch,{},20\n"
    message = (
        "line 4, column dbh_cm: found 222 cm at a height of 20 m; half of all trees are less than 10 times"
    )
    with pytest.raises(GeometryError, match=message):
        read(tmp_path, rows.format(205, 210, 222))
    assert read(tmp_path, rows.format(20.5, 150, 22.2))["dbh_m"].max() == 1.5


DBHS_CM, HEIGHTS_M = (1, 12, 40, 150, 200, 350, 481, 500), (2, 6, 15, 36, 45, 62, 100, 130)
CHAMPIONS = {  # height in m and DBH in cm of the tallest and of the thickest known tree
    "scots_pine": (46.6, 200.0),  # Ootsipalu, Estonia: 46.6 m
    "european_beech": (49.3, 280.0),  # Gruendau, Germany: over 49 m
    "english_oak": (48.4, 481.0),  # Kvilleken, Sweden: girth 15.1 m
    "douglas_fir": (100.3, 485.0),  # Doerner Fir: 100.3 m in 1991; Queets Fir: 4.85 m
    "red_maple": (43.9, 226.0),  # Great Smoky Mountains: 144 feet, girth of 23 feet 4 inches
    "white_oak": (45.1, 309.0),  # Great Smoky Mountains: 148 feet
}


def refusal(kind, dbh_cm, height_m):
    """Text of the refusal of a size, empty if it grows."""
    if dbh_cm > kind.champion.dbh_cm:
        most = f"{kind.champion.dbh_cm:.4g} cm at most"
        return f"found {dbh_cm} cm; expected {most}, the DBH of the thickest known"
    if height_m > kind.champion.height_m:
        most = f"{kind.champion.height_m:g} m at most"
        return f"found {height_m} m; expected {most}, the height of the tallest known"
    # With E = 12 GPa and 500 kg/m^3 (Greenhill 1881): 4.92 m at a DBH of 1 cm.
    buckles = height_m > 106 * (dbh_cm / 100) ** (2 / 3)
    return f"{height_m / dbh_cm * 100:.0f} times as high as thick.* where a stem buckles" if buckles else ""


def test_champions_are_those_of_the_lists():
    """Limits of six species are the sizes that lists of tall and thick trees have."""
    for name, (height_m, dbh_cm) in CHAMPIONS.items():
        champion = flora().trees[name].champion
        assert (champion.height_m, champion.dbh_cm) == (height_m, dbh_cm), name


@pytest.mark.parametrize("species", sorted(flora().trees))
def test_each_size_within_the_limits_grows_or_is_refused(tmp_path, species):
    """A tree of any DBH and height grows within a few diameters of its foot, all numbers finite, or is
    refused as higher or thicker than any known tree of its species, or as one that buckles."""
    header = "x,y,species,dbh_cm,height_m,crown_base_m\n"
    fillers = "".join(f"{x},0,{species},30,20,\n" for x in (5000, 5100))
    kind = flora().trees[species]
    grown = set()
    for dbh_cm, height_m, base in product(DBHS_CM, HEIGHTS_M, ("", 0)):
        text = f"{header}0,0,{species},{dbh_cm},{height_m},{base}\n{fillers}"
        if message := refusal(kind, dbh_cm, height_m):
            with pytest.raises(GeometryError, match=message):
                read(tmp_path, text)
            continue
        trees = read(tmp_path, text)[:1]
        grown.add((dbh_cm, height_m))
        trees["form"] = 12345
        sizes = [float(trees[name][0]) for name in ("dbh_m", "height_m", "crown_base_m", "crown_width_m")]
        assert all(np.isfinite(sizes))
        for mesh in stem_meshes(trees, np.zeros(3), lambda x, y: 0.3 * x + 0 * y):
            aside_m = np.abs(mesh.vertices_m[:, :2]).max()
            assert aside_m < 0.2 * height_m + 15 * dbh_cm / 100, (dbh_cm, height_m, base)
            assert np.abs(mesh.vertices_m[:, 2]).max() < height_m + 5 * dbh_cm / 100
            assert np.isfinite(split_into_pieces([faces_of(mesh)])[2]).all()
        for mesh in crown_meshes(1, CrownKey(species, 0, *sizes, 5.0)):
            assert np.isfinite(mesh.vertices_m).all(), (dbh_cm, height_m, base)
        assert np.isfinite(far_stems(trees, 0)["radius_m"]).all()
    assert grown.isdisjoint({(1, 6), (12, 45), (40, 130), (500, 130)})
    assert {(1, 2), (12, 15), (40, 36), (150, 36)} <= grown


@pytest.mark.parametrize("written", ["1,130", "1,60"])
def test_a_height_that_was_written_is_blamed_for_those_drawn_from_it(tmp_path, written):
    """Beside trees without a height, the line of the impossible one is named, and none without a number."""
    rows = f"x,y,species,dbh_cm,height_m\n1,2,norway_spruce,30,\n5,2,norway_spruce,{written}\n"
    with pytest.raises(GeometryError, match="line 3, column height_m: found"):
        read(tmp_path, rows)


def test_heights_drawn_from_a_curve_stay_below_the_tallest_known_tree(tmp_path):
    """Thick and thin trees without a height beside a tall one grow no higher than real ones, nor buckle."""
    sizes = (*(f"{dbh_cm}," for dbh_cm in (3, 5, 60, 150)), "30,45")
    rows = "".join(f"{5 * i},2,scots_pine,{size}\n" for i, size in enumerate(sizes))
    trees = read(tmp_path, f"x,y,species,dbh_cm,height_m\n{rows}")
    assert trees["height_m"].max() <= 46.6
    assert (trees["height_m"] <= 106 * trees["dbh_m"] ** (2 / 3) + 1e-9).all()


def test_an_inventory_is_a_stem_list(tmp_path):
    """The inventory that we write of some trees is read back as the same trees, to half its last decimal;
    what is unknown is empty."""
    trees = np.zeros(2, INVENTORY)
    for name in INVENTORY.names:
        trees[name] = [1.25, 1.5]
    trees["species"] = [flora().trees[name].number for name in ("european_beech", "scots_pine")]
    trees["height_m"], trees["lean_towards_deg"] = [20.0, 30.0], [200.0, 45.0]
    trees["list_line"], trees["biomass_kg"] = 0, np.nan
    with (tmp_path / "inventory.csv").open("wb") as file:
        write_csv(file, trees)
    with (tmp_path / "inventory.csv").open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            assert (line["list_line"], line["biomass_kg"]) == ("", "")
    back = read_stem_list(tmp_path / "inventory.csv", flora().trees, NO_ORIGIN)
    for name in set(INVENTORY.names) & set(TREE.names) - {"id", "z_m", "list_line"}:
        assert back[name] == pytest.approx(trees[name], abs=1e-4)


def test_missing_crowns_follow_species_and_neighbours(tmp_path):
    """Empty crown cells are filled by the species' equations, shorter among neighbours, with the spread of
    the species, by seed."""
    rows = [f"{3 * (i % 20)},{3 * (i // 20)},norway_spruce,28,24" for i in range(400)]
    rows += [f"{1000 + 30 * (i % 20)},{30 * (i // 20)},norway_spruce,28,24" for i in range(400)]
    file = tmp_path / "many.csv"
    file.write_text("\n".join(["x,y,species,dbh_cm,height_m", *rows]), encoding="utf-8")
    trees = read_stem_list(file, flora().trees, NO_ORIGIN, 3)
    ratio = (1 - trees["crown_base_m"] / trees["height_m"]).reshape(2, 400)
    dense, alone = np.median(ratio, axis=1)
    assert dense < 0.6 < 0.75 < alone
    spruce = flora().trees["norway_spruce"]
    assert np.log(ratio / (1 - ratio))[1].std() == pytest.approx(spruce.spread.crown_ratio, rel=0.12)
    assert np.log(trees["crown_width_m"]).std() == pytest.approx(spruce.spread.crown_width, rel=0.12)
    assert trees["crown_width_m"].mean() == pytest.approx(spruce.crown_width_m(np.array([28.0]))[0], rel=0.02)
    again, other = (read_stem_list(file, flora().trees, NO_ORIGIN, seed) for seed in (3, 4))
    assert np.array_equal(again, trees)
    assert not np.array_equal(other["crown_base_m"], trees["crown_base_m"])


def test_missing_heights_follow_the_measured_ones(tmp_path):
    """An empty height lies on the species' curve through the mean diameter and height of its measured
    trees."""
    rows = [f"{10 * i},0,silver_birch,{dbh},{h}" for i, (dbh, h) in enumerate([(20, 18), (26, 22), (31, "")])]
    trees = read(tmp_path, "\n".join(["x,y,species,dbh_cm,height_m", *rows]))
    birch = flora().trees["silver_birch"]
    assert trees["height_m"][:2].tolist() == [18, 22]
    expected = birch.height_curve(np.array([31.0]), np.sqrt((20**2 + 26**2) / 2), 20.0)[0]
    assert trees["height_m"][2] == pytest.approx(expected, abs=1e-9)
    assert 20.5 < expected < 22


HEADER = "x,y,species,dbh_cm,height_m,crown_base_m\n"
GOOD = "1,2,silver_birch,20,18,9\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "x,y,species,height_m\n",
            ("line 1: no column dbh_cm or dbh_m; expected it among x, y, species, height_m"),
        ),
        ("x,y,dbh_cm,height_m\n", "line 1: no column species"),
        (HEADER, "no tree below line 1"),
        (
            "x,y,species,dbh_cm,height_m,lean_azimuth_deg,lean_towards_deg\n",
            "line 1: found lean_azimuth_deg and lean_towards_deg; expected one of them",
        ),
        (
            HEADER + GOOD + "\n1,9,silver_brich,20,18,9\n",
            ("line 4, column species: unknown species 'silver_brich'; expected silver_birch, the nearest"),
        ),
        (
            HEADER + GOOD + "1,9,palm,20,18,9\n",
            ("line 3, column species: unknown species 'palm'; expected one of silver_birch"),
        ),
        (
            HEADER + "1,2,silver_birch,-20,18,9\n",
            ("line 2, column dbh_cm: found -20; expected a number from 1 to 500"),
        ),
        (
            HEADER + "1,2,silver_birch,20,180,9\n",
            ("line 2, column height_m: found 180; expected a number from 2 to 130"),
        ),
        (
            HEADER + "1,2,silver_birch,20,18,18\n",
            ("line 2, column crown_base_m: found 18; expected less than the height, 18"),
        ),
        (
            HEADER + GOOD + "5,5,silver_birch,20,18,9\n1.01,2,silver_birch,30,20,9\n",
            r"line 4: the place of line 2, \(1.01, 2\) m",
        ),
        (
            HEADER + "1,2,silver_birch,20,,9\n",
            ("height_m: no tree of silver_birch has a height; expected one at least"),
        ),
    ],
)
def test_a_bad_list_is_refused_in_one_line(tmp_path, text, message):
    """An error in a stem list names file, line and column, what was found and what was expected."""
    with pytest.raises(GeometryError, match=f"stems.csv[:,] {message}"):
        read(tmp_path, text)


TREE_HEADER = "x,y,species,dbh_cm,height_m,crown_base_m,crown_width_m,lean_deg,lean_azimuth_deg\n"
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
        path.write_text(TREE_HEADER + rows, encoding="utf-8")
        return GivenStand(
            Plot(kind="plot", stem_list=str(path), on_conflict=on_conflict),
            Land(1, lambda x, y: 0.1 * x + 0.01 * y, Corridor(path_xy_m, path_clearance_m)),
        )

    return make_stand


def test_each_tree_stands_on_its_own_tile_and_on_the_ground(make):
    """A tile has the trees whose foot lies in it, in the order of the list, and their feet are on the
    ground; two on 0.04 ha are 50 per ha."""
    stand = make()
    assert stand.per_ha == pytest.approx(50)
    found = {(i, j): stand.trees(i, j) for i in range(-2, 3) for j in range(-2, 3)}
    places = {tile: trees["x_m"].tolist() for tile, trees in found.items() if len(trees)}
    assert places == {(0, 0): [3, 4], (-1, 0): [-3], (1, 0): [21], (0, -1): [19.5]}
    trees = found[0, 0]
    assert trees["z_m"] == pytest.approx(0.1 * trees["x_m"] + 0.01 * trees["y_m"])
    assert (trees["id"] == 0).all()


def test_crowns_are_prototypes_of_the_lists_own_trees(make):
    """Trees of one species, class and third of crown ratios share the crown of their mean; its leaves are
    the species' LAI on its projection."""
    stand = make()
    one, other = stand.trees(0, 0)
    keys = [stand.crown(*map(int, t[["cohort", "crown_class", "crown_variant"]])) for t in (one, other)]
    assert keys[0] == keys[1]
    key = keys[0]
    assert key.species == "silver_birch"
    assert (key.dbh_m, key.height_m, key.crown_base_m, key.crown_width_m) == pytest.approx(
        (0.205, 20.5, 9, 4.5)
    )
    lai = flora().trees["silver_birch"].leaf_area_index
    assert key.leaf_area_m2 == pytest.approx(lai * np.pi / 4 * 4.5**2)


def test_a_tree_more_at_the_end_changes_no_other(make):
    """What chance adds to a tree depends on its line alone."""
    short, long = make(), make(ROWS + "8,8,silver_birch,30,22,9,5,0,0\n")
    assert short.trees(0, 0).tolist() == long.trees(0, 0)[:2].tolist()
    assert len(long.trees(0, 0)) == 3


def test_trees_in_the_way_are_refused_all_at_once_or_dropped(make, caplog):
    """Stems whose surface comes nearer to the path than the clearance are named by line and place, with their
    distance.

    Dropped, they are left out with a warning that names them; the others are the same trees as without them.
    """
    path = np.array([[0.0, 4.7], [10.0, 4.7]])
    rows = ROWS + "8,5,silver_birch,20,20,9,4,0,0\n"
    message = "2 of 6 trees nearer to the path than path_clearance_m = 0.3: "
    message += r"line 6 at \(4, 5\) m, 0.1\d m away; line 7 at \(8, 5\) m, 0.1"
    with pytest.raises(GeometryError, match=message):
        make(rows, path_xy_m=path, path_clearance_m=0.3)
    make(rows, path_xy_m=path, path_clearance_m=0.1)
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
