"""What the truth of returns says of each stem."""

import numpy as np
import pytest

from vlp16emu.errors import InputError
from vlp16emu.extras.sheets.survey import stems_seen, tables_of_returns
from vlp16emu.extras.truth.slots import SLOT_COLUMNS
from vlp16emu.forest.plants.flora import species_table
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.types import PlantPart, Semantic

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def trees():
    """Two straight stems, the second leaning, with crowns from 5.3 m up: ten cells of 0.5 m over 0.3 m."""
    trees = np.zeros(2, TREE)
    trees["id"], trees["species"] = [900, 300], species_table()["silver_birch"].number
    trees["x_m"], trees["z_m"], trees["dbh_m"], trees["height_m"] = [10.0, 20.0], 2.0, 0.4, 18.0
    trees["crown_base_m"], trees["lean_deg"] = 5.3, [0.0, 5.0]
    return trees


def ring(tree, above_m, angle_deg, radius_m=0.2):
    """Places around a tree's axis."""
    axis_m = np.tan(np.radians(tree["lean_deg"])) * above_m
    angle = np.radians(angle_deg)
    x_m = tree["x_m"] + axis_m + radius_m * np.cos(angle)
    return np.column_stack(np.broadcast_arrays(x_m, radius_m * np.sin(angle), tree["z_m"] + above_m))


def write(path, parts):
    """Write a table of returns at places (n, 3), each with the labels of its part."""
    rows = [(at, semantic, part, number) for places, semantic, part, number in parts for at in places]
    columns = {name: np.zeros(len(rows), kind) for name, kind in SLOT_COLUMNS.items()}
    for axis in range(3):
        columns[f"world_{'xyz'[axis]}_m"] = np.array([row[0][axis] for row in rows])
    for i, name in enumerate(("semantic", "part", "instance"), 1):
        columns[name] = np.array([row[i] for row in rows]).astype(SLOT_COLUMNS[name])
    parquet.write_table(pa.table(columns), path, row_group_size=384)
    return path


def test_cells_with_returns_are_counted(tmp_path, trees):
    """Returns all around at breast height show 360 degrees and a tenth of the surface, from half of it half; others count nothing."""
    all_around, half = np.arange(36) * 10.0 + 5.0, np.arange(18) * 10.0 + 5.0
    tree = Semantic.TREE
    table = write(
        tmp_path / "returns.parquet",
        [
            (np.repeat(ring(trees[0], 1.2, all_around), 20, axis=0), tree, PlantPart.STEM, 900),
            (ring(trees[1], 1.2, half), tree, PlantPart.STEM, 300),
            (ring(trees[1], 4.9, half), tree, PlantPart.STEM, 300),
            (ring(trees[1], 0.1, half), tree, PlantPart.ROOT_FLARE, 300),
            (ring(trees[1], 9.0, half), tree, PlantPart.STEM, 300),
            (ring(trees[0], 3.0, half), tree, PlantPart.LEAF, 900),
            (ring(trees[0], 3.0, half), Semantic.DEADWOOD, PlantPart.STEM, 900),
            (ring(trees[0], 3.0, half), tree, PlantPart.STEM, 901),
        ],
    )
    rows = stems_seen(trees, [table])
    assert rows["returns_stem"].tolist() == [720, 72]
    assert rows["stem_seen"] == pytest.approx([0.1, 0.1])
    assert rows["breast_seen_deg"].tolist() == [360.0, 180.0]


def test_tables_of_several_units_add_up(tmp_path, trees):
    """What one unit sees from the east and another from the west is seen from both."""
    for name, turn in (("returns.parquet", 5.0), ("returns_2.parquet", 185.0)):
        places = ring(trees[0], 1.2, np.arange(18) * 10.0 + turn)
        write(tmp_path / name, [(places, Semantic.TREE, PlantPart.STEM, 900)])
    rows = stems_seen(trees, tables_of_returns(tmp_path))
    assert rows["breast_seen_deg"].tolist() == [360.0, 0.0]
    assert rows["returns_stem"].tolist() == [36, 0]


def test_truth_of_another_scene_is_refused(tmp_path, trees):
    """Returns that lie metres off the axes of their trees are of another world, and a folder without returns is named."""
    with pytest.raises(InputError, match=r"no returns\.parquet"):
        tables_of_returns(tmp_path)
    places = ring(trees[0], 1.2, np.arange(36) * 10.0, radius_m=4.0)
    table = write(tmp_path / "returns.parquet", [(places, Semantic.TREE, PlantPart.STEM, 900)])
    with pytest.raises(InputError, match=r"returns from stems 4\.0 m off the axes"):
        stems_seen(trees, [table])
