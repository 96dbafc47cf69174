"""Trees of the user's own in the place of grown ones."""

import numpy as np
import pytest
import trimesh
from forest.kit import section_diameter_m, trees_of

from vlp16emu import Emulator
from vlp16emu.errors import GeometryError
from vlp16emu.foliage.tiles import EXACT
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.settings import ModelPart, TreeModelFile
from vlp16emu.forest.stand.tree_models import Cutter, TreeModels
from vlp16emu.scenario import load
from vlp16emu.types import PlantPart, Semantic

BIRCH = flora().trees["silver_birch"]
PARTS = [ModelPart(name="crown", part="leaf"), ModelPart(name="bough", part="branch_first_order")]
FOOT_M = [5.0, -3.0]


def prism(points_m, radii_m, sides=24):
    """A tube through points (k, 3) with level sections, closed at both ends."""
    x, y, z = np.array(points_m).T
    solid = trimesh.creation.revolve(np.column_stack([[0, *radii_m, 0], [z[0], *z, z[-1]]]), sections=sides)
    aside_m = np.column_stack([np.interp(solid.vertices[:, 2], z, along) for along in (x, y)])
    return solid.vertices + np.column_stack([aside_m, np.zeros(len(aside_m))]), solid.faces


def write_obj(path, parts, factor=1.0):
    """Write objects by name, in the given order."""
    lines, first = [], 1
    for name, (vertices, faces) in parts.items():
        lines.append(f"o {name}")
        lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in factor * vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + first).tolist()]
        first += len(vertices)
    path.write_text("\n".join(lines), encoding="ascii")
    return path


def tree_parts(scale=1.0):
    """A leaning stem 12 m tall that reaches into the ground, a bough, and a crown of triangles; its foot
    is at `FOOT_M`."""
    x, y = FOOT_M
    stem = prism(
        [[x - 0.02, y, -0.2], [x, y, 0.0], [x + 0.3, y + 0.1, 3.0], [x + 0.5, y, 12.0]],
        scale * np.array([0.25, 0.2, 0.15, 0.02]),
    )
    bough = prism([[x + 0.4, y, 6.0], [x + 2.0, y, 7.0]], [0.05, 0.02], sides=6)
    rng = np.random.default_rng(4)
    middle = np.array([x + 0.5, y, 9.0]) + rng.uniform(-1, 1, (3000, 3)) * [2.0, 1.5, 2.9]
    corners = middle[:, None] + rng.uniform(-0.06, 0.06, (3000, 3, 3))
    crown = corners.reshape(-1, 3), np.arange(9000).reshape(-1, 3)
    return {"crown": crown, "bough": bough, "trunk": stem}


def section_of(path, unit="m", up="z", species="silver_birch", parts=PARTS):
    return TreeModelFile(file=str(path), unit=unit, up=up, species=species, parts=parts)


def some_trees(n=12):
    """Birches of many sizes, some leaning."""
    rng, number = np.random.default_rng(2), np.arange(n)
    place = {"id": 100 + number, "x_m": 10.0 * number, "y_m": 3.0, "z_m": 7.0, "lean_towards_deg": 40.0}
    size = {
        "height_m": rng.uniform(6, 25, n),
        "dbh_m": rng.uniform(0.08, 0.5, n),
        "lean_deg": 4.0 * (number % 2),
    }
    looks = {"crown_azimuth_deg": rng.uniform(0, 360, n), "bark_reflectance": 0.55, "leaf_reflectance": 0.45}
    return trees_of(["silver_birch"] * n, **place, **size, **looks)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_obj(tmp_path_factory.mktemp("trees") / "birch.obj", tree_parts())


@pytest.fixture(scope="module")
def models(path):
    return TreeModels([section_of(path)], flora())


def solids(models, trees):
    """All meshes of each tree, placed, by part."""
    for placed in models.place(trees):
        meshes = models.shape(placed.keys[0])
        for tree, transform in zip(placed.trees, placed.world_T_shape, strict=True):
            by_part = {}
            for part, mesh in zip(placed.surfaces["part"][0], meshes, strict=True):
                at_m = mesh.vertices_m @ transform[:, :3].T + transform[:, 3]
                by_part.setdefault(int(part), []).append(trimesh.Trimesh(at_m, mesh.faces, process=False))
            yield tree, transform, {part: trimesh.util.concatenate(own) for part, own in by_part.items()}


def test_a_trees_dbh_is_that_of_its_mesh(models):
    """The section of the placed stem across its axis, where trimesh cuts it, has the tree's DBH within 0.1
    mm."""
    for tree, transform, meshes in solids(models, some_trees()):
        axis = transform[:, 2] / np.linalg.norm(transform[:, 2])
        at_m = transform[:, 3] + axis * 1.3 / axis[2]
        assert section_diameter_m(meshes[PlantPart.STEM], axis, at_m) == pytest.approx(
            tree["dbh_m"], abs=1e-4
        )


def test_rows_of_the_inventory_are_those_of_the_meshes(models):
    """Height, box, crown, volumes and leaf area are what numpy and trimesh find on the placed meshes;
    upright trees have their height."""
    trees = some_trees()
    rows = {row["id"]: row for row in models.inventory(trees)}
    for tree, _, meshes in solids(models, trees):
        row = rows[tree["id"]]
        corners_m = np.concatenate([mesh.vertices for mesh in meshes.values()])
        assert (row["dbh_m"], row["height_m"]) == (tree["dbh_m"], tree["height_m"])
        assert row["top_m"] == pytest.approx(corners_m[:, 2].max() - 7.0, abs=1e-4)
        assert tree["lean_deg"] or row["top_m"] == pytest.approx(row["height_m"], abs=1e-4)
        for axis, name in enumerate("xy"):
            box_m = row[f"{name}_min_m"], row[f"{name}_max_m"]
            assert box_m == pytest.approx((corners_m[:, axis].min(), corners_m[:, axis].max()), abs=1e-4)
        leaves = meshes[PlantPart.LEAF]
        assert row["crown_base_m"] == pytest.approx(leaves.vertices[:, 2].min() - 7.0, abs=1e-4)
        assert row["leaf_m2"] == pytest.approx(leaves.area, rel=1e-5)
        stem, bough = meshes[PlantPart.STEM], meshes[PlantPart.BRANCH_FIRST_ORDER]
        stem.merge_vertices()
        assert stem.is_watertight
        assert row["stem_m3"] == pytest.approx(stem.volume, rel=1e-4)
        assert row["wood_m3"] - row["stem_m3"] == pytest.approx(bough.volume, rel=1e-3)
        assert np.hypot(row["x_breast_m"] - tree["x_m"], row["y_breast_m"] - tree["y_m"]) > 0.01


def test_circles_run_through_the_middle_of_the_stem(models):
    """Every vertex of a stem above ground lies within 2 cm of the circle at its height, in the size of a
    tree of 12 m."""
    trees = some_trees(1)
    trees["height_m"], trees["lean_deg"] = 12.0, 0.0
    circles = models.circles(trees)
    ((_, _, meshes),) = solids(models, trees)
    corners_m = meshes[PlantPart.STEM].vertices
    corners_m = corners_m[(corners_m[:, 2] > 6.99)]
    x, y, r = (np.interp(corners_m[:, 2], circles["z_m"], circles[n]) for n in ("x_m", "y_m", "radius_m"))
    away_m = np.hypot(corners_m[:, 0] - x, corners_m[:, 1] - y)
    rim = away_m > 1e-3  # without the middle of the ends
    assert rim.sum() == 72
    np.testing.assert_allclose(away_m[rim], r[rim], atol=0.02)
    assert (circles["tree"] == 100).all()


def test_a_bough_within_the_stems_part_is_no_bole(tmp_path):
    """What bears away from the stem in the stem's own part is labelled as it, but stays a medium from
    afar."""
    parts = tree_parts()
    (bole, faces), (bough, more) = parts["trunk"], parts["bough"]
    together = np.concatenate([bole, bough]), np.concatenate([faces, more + len(bole)])
    file = write_obj(tmp_path / "oak.obj", {"crown": parts["crown"], "wood": together})
    models = TreeModels([section_of(file, parts=PARTS[:1])], flora())
    (placed,) = models.place(some_trees(1))
    assert placed.surfaces["part"].tolist() == [[PlantPart.LEAF, PlantPart.STEM, PlantPart.STEM]]
    assert models.far_parts(placed.keys[0]) == (PlantPart.LEAF, EXACT, PlantPart.STEM)
    _, exact, rest = models.shape(placed.keys[0])
    assert len(rest.faces) == pytest.approx(len(more), abs=8)  # one end is within the stem
    assert len(exact.faces) + len(rest.faces) == len(faces) + len(more)


def test_units_and_axes_are_those_of_the_section(path, tmp_path):
    """The same tree in centimetres with y up is the same mesh within what its numbers are rounded by."""
    turned = {n: (v[:, [0, 2, 1]] * [1, 1, -1], f) for n, (v, f) in tree_parts().items()}
    other = write_obj(tmp_path / "turned.obj", turned, factor=100.0)
    one, two = (TreeModels([own], flora()) for own in (section_of(path), section_of(other, "cm", "y")))
    trees = some_trees(1)
    for a, b in zip(*(m.shape(m.place(trees)[0].keys[0]) for m in (one, two)), strict=True):
        np.testing.assert_allclose(a.vertices_m, b.vertices_m, atol=1e-5)
        np.testing.assert_array_equal(a.faces, b.faces)


def test_each_tree_has_the_model_that_it_stretches_least(path, tmp_path):
    """Of a slim and a stout model, slim trees are the slim one and stout trees the stout one; alike ones
    are shared out."""
    stout = write_obj(tmp_path / "stout.obj", tree_parts(scale=3.0))
    trees = some_trees(60)
    trees["height_m"], trees["dbh_m"] = 12.0, np.where(np.arange(60) < 30, 0.35, 1.05)
    models = TreeModels([section_of(path), section_of(stout)], flora())
    found = {placed.keys[0].number: placed.trees["id"] for placed in models.place(trees)}
    np.testing.assert_array_equal(found[0], trees["id"][:30])
    np.testing.assert_array_equal(found[1], trees["id"][30:])
    alike = TreeModels([section_of(path), section_of(path)], flora())
    shares = [len(placed.trees) for placed in alike.place(trees)]
    assert sum(shares) == 60
    assert min(shares) > 15


def test_broadleaves_bear_no_leaves_in_winter(path):
    """With `leaf_off` a birch's part of leaves is empty and no area counts; a spruce keeps its needles."""
    trees = some_trees(1)
    winter = TreeModels([section_of(path)], flora(), "leaf_off")
    assert winter.inventory(trees)["leaf_m2"] == 0.0
    trees["species"] = flora().trees["norway_spruce"].number
    spruce = TreeModels([section_of(path, species="Picea abies")], flora(), "leaf_off")
    assert spruce.inventory(trees)["leaf_m2"] > 1.0


@pytest.mark.parametrize(
    ("parts", "change", "message"),
    [
        (tree_parts(), {"species": "silver brich"}, "silver_birch, the nearest"),
        (tree_parts(), {"parts": [ModelPart(name="leafs", part="leaf")]}, "found 'leafs'"),
        ({"trunk": tree_parts()["crown"]}, {"parts": [ModelPart(name="trunk", part="leaf")]}, "no stem"),
        ({"trunk": tree_parts()["crown"]}, {"parts": []}, "no closed section of the stem at"),
    ],
)
def test_a_model_that_cannot_be_is_refused(parts, change, message, tmp_path):
    """An unknown species or part, a tree without stem and a stem without closed sections are named with
    what is expected."""
    file = write_obj(tmp_path / "tree.obj", parts)
    with pytest.raises(GeometryError, match=message):
        TreeModels([section_of(file, **change)], flora())


def test_a_tree_too_short_for_its_model_is_refused(models):
    """Where breast height comes to lie above the model's stem, the file and the height in it are named."""
    trees = some_trees(1)
    trees["height_m"] = 1.29
    with pytest.raises(GeometryError, match=r"birch\.obj.*no closed section of the stem at 12\.09 m"):
        models.place(trees)


@pytest.mark.parametrize("turn", [1, -1])
def test_sections_do_not_depend_on_which_way_faces_look(turn):
    """A tube of 24 sides has the area and girth of its polygon, its faces looking in or out; the largest
    outline counts."""
    tubes = [prism([[0, 0, 0], [0, 0, 2]], [r, r]) for r in (0.3, 0.1)]
    cutter = Cutter(
        [vertices for vertices, _ in tubes], [faces[:, ::turn].astype(np.uint32) for _, faces in tubes]
    )
    outline = cutter.cut(1.0)
    assert outline.diameter_m == pytest.approx(2 * 0.3 * np.sqrt(12 / np.pi * np.sin(np.pi / 12)), rel=1e-9)
    assert outline.tape_m == pytest.approx(48 * 0.3 * np.sin(np.pi / 24) / np.pi, rel=1e-9)
    assert cutter.cut(2.5) is None


SCENE = """\
schema = 1
title = "Measured birches with the looks of one"
seed = 8

[sensor]
max_range_m = 30.0

[motion]
kind = "static"

[world]
kind = "plot"
stem_list = "stems.csv"

[[world.tree_models]]
species = "silver birch"
file = "birch.obj"
unit = "m"
up = "z"
parts = [{ name = "crown", part = "leaf" }, { name = "bough", part = "branch_first_order" }]
"""


@pytest.fixture(scope="module")
def scene(path):
    """Birches and spruces all around, from 4 m to 28 m away."""
    away_m, towards = np.linspace(4.0, 28.0, 40), 2.4 * np.arange(40)
    rows = []
    for i, (r, a) in enumerate(zip(away_m, towards, strict=True)):
        species = "norway_spruce" if i % 3 else "silver_birch"
        rows.append(f"{r * np.cos(a):.3f},{r * np.sin(a):.3f},{species},{18 + i % 7},{14 + i % 5}")
    text = "\n".join(["x,y,species,dbh_cm,height_m", *rows])
    path.with_name("stems.csv").write_text(text, encoding="utf-8")
    path.with_name("plot.toml").write_text(SCENE, encoding="utf-8")
    return str(path.with_name("plot.toml"))


@pytest.mark.usefixtures("kept_woods")
def test_returns_name_the_trees_of_the_user(scene):
    """Points on stem, bough and crown have the species and numbers of trees of the list, near ones and those
    beyond 15 m.

    Each stem, a model's or a grown one, is met within 0.4 m of the foot of the tree whose number it has, in
    the median.
    """
    emulator, met, places_m, away_m = Emulator(load(scene)), [], [], []
    for returns in emulator.returns(0.0, 0.1, truth=True):
        there, firings = returns.distance_m[..., 0] > 0, returns.firings
        met.append(returns.surfaces[returns.surface[..., 0][there]])
        away_m.append(returns.distance_m[..., 0][there])
        places_m.append(firings.origin_m[there] + away_m[-1][:, None] * firings.direction[there])
    rows, places_m, away_m = (np.concatenate(of) for of in (met, places_m, away_m))
    trees = emulator.parts.world.trees(np.zeros((1, 3)))
    for number in np.unique(rows["instance"][rows["part"] == PlantPart.STEM]):
        (tree,), stem = (
            trees[trees["id"] == number],
            (rows["instance"] == number) & (rows["part"] == PlantPart.STEM),
        )
        assert (rows["species"][stem] == tree["species"]).all()
        assert np.median(np.hypot(places_m[stem, 0] - tree["x_m"], places_m[stem, 1] - tree["y_m"])) < 0.4
    birch = rows["species"] == BIRCH.number
    near, far = birch & (away_m < 14), birch & (away_m > 17)
    assert set(rows["part"][near].tolist()) == {PlantPart.STEM}  # crowns are above the highest beam
    assert set(rows["part"][far].tolist()) == {PlantPart.STEM, PlantPart.BRANCH_FIRST_ORDER, PlantPart.LEAF}
    assert len(set(rows["instance"][near].tolist())) >= 2
    assert len(set(rows["instance"][far].tolist())) >= 3
    assert (rows["semantic"][birch] == Semantic.TREE).all()


def test_threads_do_not_change_a_byte_of_a_run_with_models(scene):
    """One thread or two, in wind: the same packets."""
    wind = load(scene, ["world.season=leaf_off", "wind.speed_m_s=6.0", "sensor.max_range_m=20"])
    one, two = (list(Emulator(wind, threads=threads).packets(0.0, 0.1)) for threads in (1, 2))
    assert one == two
