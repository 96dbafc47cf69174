"""Meshes that the user brings, and a world with them in it."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from vlp16emu.errors import GeometryError
from vlp16emu.extras.meshes.files import UserMesh, load_mesh
from vlp16emu.extras.meshes.furnish import Furnished, MeshKey, surfaces_of
from vlp16emu.extras.meshes.settings import MeshFile, MeshPart, MeshPlace
from vlp16emu.types import FIRST_FREE_INSTANCE, Mesh, PlantPart, Semantic
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
TETRAHEDRON = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
PLY = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""


def write(tmp_path, content, name="thing.obj"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def load(tmp_path, content, name="thing.obj", unit="m", up="z"):
    return load_mesh(write(tmp_path, content, name), unit=unit, up=up)


def triangles(mesh):
    """All triangles in the file's frame, (f, 3, 3), in an order that depends on nothing but them."""
    corners = np.concatenate([part.vertices_m[part.faces] for _, part in mesh.parts]) + mesh.centre_m
    return corners[np.lexsort(np.round(corners.reshape(-1, 9), 5).T)]


@pytest.mark.parametrize("kind", ["obj", "ply", "glb", "stl"])
def test_every_kind_of_file_gives_the_same_solid(tmp_path, caplog, kind):
    """A box of 2 x 3 x 4 m off the origin keeps volume, place and twelve faces in every format, without a
    finding."""
    box = trimesh.creation.box((2, 3, 4), trimesh.transformations.translation_matrix([5, 6, 7]))
    mesh = load(tmp_path, box.export(file_type=kind), f"box.{kind}")
    ((_, part),) = mesh.parts
    solid = trimesh.Trimesh(part.vertices_m, part.faces)
    assert solid.volume == pytest.approx(24)
    assert len(part.faces) == 12
    assert mesh.centre_m == pytest.approx([5, 6, 7])
    assert mesh.radius_m == pytest.approx(np.sqrt(29) / 2)
    assert not caplog.records


@pytest.mark.parametrize(
    ("codec", "name"),
    [
        ("utf-8", "Kanzel_Süd"),
        ("utf-8-sig", "Kanzel_Süd"),
        ("cp1252", "Kanzel_Süd"),
        ("cp1252", "größe"),
        ("cp1252", "Plantações"),
        ("utf-16", "Kanzel_Süd"),
        ("gbk", "瞭望台"),
        ("gbk", "高座_1"),
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_text_mesh_may_have_any_usual_encoding(tmp_path, codec, name, newline):
    """Names and comments of OBJ files are those of the encoding, which `parts` can name, and the geometry is
    that of the ASCII file."""
    plain = f"o thing\n{CORNERS}{TETRAHEDRON}"
    text = f"# {name}\n" + plain.replace("thing", name)
    mesh = load(tmp_path, text.replace("\n", newline).encode(codec))
    assert [part for part, _ in mesh.parts] == [name]
    assert np.array_equal(triangles(mesh), triangles(load(tmp_path, plain)))


@pytest.mark.parametrize(
    "comment", ["# C:\\models\\", "# 表".encode("shift_jis"), "# 能 ".encode("shift_jis")]
)
def test_a_comment_ends_with_its_line(tmp_path, comment):
    """A backslash at the end of a comment, also as half of a character in Shift JIS, takes no vertex with
    it."""
    line = comment if isinstance(comment, bytes) else comment.encode()
    mesh = load(tmp_path, line + b"\n" + (CORNERS + TETRAHEDRON).encode())
    assert np.array_equal(triangles(mesh), triangles(load(tmp_path, CORNERS + TETRAHEDRON)))


@pytest.mark.parametrize("codec", ["cp1252", "gbk", "utf-16"])
def test_text_of_other_formats_may_have_any_usual_encoding(tmp_path, codec):
    """Comments of PLY, text and binary, and names of STL are read in any usual encoding; trimesh alone stops
    at them."""
    word = "高座" if codec == "gbk" else "Süd"
    text = PLY.replace("format ascii 1.0", f"format ascii 1.0\ncomment {word}")
    plain = triangles(load(tmp_path, PLY, "plain.ply"))
    assert np.array_equal(triangles(load(tmp_path, text.encode(codec), "thing.ply")), plain)
    box = trimesh.creation.box((1, 2, 3))
    stl = box.export(file_type="stl_ascii").replace("solid", f"solid {word}", 1)
    assert np.array_equal(
        triangles(load(tmp_path, stl.encode(codec), "thing.stl")),
        triangles(load(tmp_path, box.export(file_type="stl_ascii"), "plain.stl")),
    )
    if codec != "utf-16":
        binary = box.export(file_type="ply")
        named = binary.replace(b"end_header", b"comment " + word.encode(codec) + b"\nend_header", 1)
        assert np.array_equal(
            triangles(load(tmp_path, named, "thing.ply")), triangles(load(tmp_path, binary, "plain.ply"))
        )


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254), ("ft", 0.3048)]
)
def test_units_become_metres(tmp_path, unit, metres):
    """A length of 5 in the file's unit is that many metres."""
    mesh = load(tmp_path, CORNERS.replace("1", "5") + TETRAHEDRON, unit=unit)
    assert triangles(mesh).max(axis=(0, 1)) == pytest.approx([5 * metres] * 3)


def test_y_up_is_turned_upright_and_not_mirrored(tmp_path):
    """With y up, what pointed along y points up and what pointed along z points to -y; the solid stays
    right side out."""
    text = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\n" + TETRAHEDRON
    upright = triangles(load(tmp_path, text, up="y"))
    assert upright.min(axis=(0, 1)) == pytest.approx([0, -3, 0])
    assert upright.max(axis=(0, 1)) == pytest.approx([1, 0, 2])
    assert np.linalg.det(upright).sum() / 6 == pytest.approx(1.0)


def test_far_from_the_origin_nothing_is_lost(tmp_path):
    """A mesh at map coordinates keeps its shape to a micrometre, for it is held about its own centre."""
    text = "v 500000 5700000 200\nv 500000.125 5700000 200\nv 500000 5700000.125 200\nf 1 2 3\n"
    mesh = load(tmp_path, text)
    extent = np.ptp(mesh.parts[0][1].vertices_m, axis=0)
    assert extent == pytest.approx([0.125, 0.125, 0], abs=1e-6)
    assert mesh.centre_m == pytest.approx([500000.0625, 5700000.0625, 200])


def test_tabs_and_comments_change_nothing(tmp_path):
    """Each vertex and face of an OBJ file is read, whatever blanks are in its line and whatever is behind
    it."""
    odd = (
        (CORNERS + TETRAHEDRON)
        .replace("f 1 2", "f\t1  2")
        .replace("v 1 0", "  v\t1 0")
        .replace(" 3\n", " 3 # one\tof four\n")
    )
    np.testing.assert_array_equal(
        triangles(load(tmp_path, odd)), triangles(load(tmp_path, CORNERS + TETRAHEDRON))
    )


def test_objects_and_groups_are_parts(tmp_path):
    """Each object and group of an OBJ file is a part by its name, in alphabetical order."""
    text = CORNERS + "o b\nf 1 2 3\no a\ng two\nf 1 2 4\ng one\nf 1 3 4\nf 2 3 4\n"
    parts = load(tmp_path, text).parts
    assert [(name, len(part.faces)) for name, part in parts] == [("a_one", 2), ("a_two", 1), ("b", 1)]


def test_nodes_of_a_scene_stand_where_their_transforms_put_them(tmp_path):
    """A GLB scene gives one part for each node, with its transform applied, also where nodes share a
    geometry."""
    scene = trimesh.Scene()
    box = trimesh.creation.box()
    scene.add_geometry(box, geom_name="crate", node_name="low")
    turned = trimesh.transformations.rotation_matrix(np.pi / 4, [0, 0, 1], [0, 0, 0])
    turned[:3, 3] = [10, 0, 5]
    scene.graph.update(frame_to="high", frame_from=scene.graph.base_frame, matrix=turned, geometry="crate")
    mesh = load(tmp_path, scene.export(file_type="glb"), "crates.glb")
    assert [name for name, _ in mesh.parts] == ["high", "low"]
    high, low = (part.vertices_m + mesh.centre_m for _, part in mesh.parts)
    assert np.abs(low).max() == pytest.approx(0.5)
    assert high.mean(axis=0) == pytest.approx([10, 0, 5])
    assert np.ptp(high[:, 0]) == pytest.approx(np.sqrt(2))


@pytest.mark.parametrize(
    ("faces", "finding"),
    [
        ("f 1 1 2\n" + TETRAHEDRON, "thing: dropped 1 of 5 faces, which have no area"),
        ("v 0.5 0 0\nf 1 5 2\n" + TETRAHEDRON, "thing: dropped 1 of 5 faces, which have no area"),
        (TETRAHEDRON.replace("f 2 3 4\n", ""), "thing: is not closed: edges with one face only: 3"),
        (TETRAHEDRON.replace("2 3 4", "2 4 3"), "thing: has faces side by side that look opposite ways"),
        ("f 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n", "thing: is inside out: all its faces look inwards"),
    ],
)
def test_what_can_be_scanned_all_the_same_is_taken_and_said(tmp_path, caplog, faces, finding):
    """Faces without area are dropped, holes and inverted faces kept, and each is reported once by file and
    part."""
    mesh = load(tmp_path, CORNERS + faces)
    assert caplog.messages == [f"{tmp_path / 'thing.obj'}: {finding}"]
    assert len(mesh.parts[0][1].faces) == (3 if "closed" in finding else 4)


def test_welding_sees_through_split_corners(tmp_path, caplog):
    """An STL, which repeats each corner, is as closed as the solid it was made of, and a point cloud
    beside a mesh is left out aloud."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    load(tmp_path, ball.export(file_type="stl"), "ball.stl")
    assert not caplog.records
    scene = trimesh.Scene({"ball": ball, "dust": trimesh.PointCloud(np.eye(3))})
    load(tmp_path, scene.export(file_type="glb"), "ball.glb")
    assert caplog.messages == [f"{tmp_path / 'ball.glb'}: dust: left out, for it has no face"]


def glb_with_nan():
    box = trimesh.creation.box()
    content = trimesh.Scene({"crate": box}).export(file_type="glb")
    half = np.float32(0.5).tobytes()
    place = content.rindex(half)
    return content[:place] + np.float32(np.nan).tobytes() + content[place + 4 :]


def glb_of_two_files():
    """A GLB whose coordinates are in a file beside it."""
    text = trimesh.Scene(trimesh.creation.box()).export(file_type="gltf")["model.gltf"]
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<3I", 2, 20 + len(text), len(text)) + b"JSON" + text


CUT_SHORT = (
    b"",
    b"junk",
    b"solid caf\xe9\nendsolid\n",
    bytes(80) + struct.pack("<I", 10) + bytes(70),
    b"solid " + bytes(74) + struct.pack("<I", 1) + bytes(51),
)
"""STL files cut short, or longer than their header says."""


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", CORNERS.replace("v 0 1 0", "v nan 1 0") + TETRAHEDRON, (r"a.obj: a: found \[nan, 1.0, "
                                                                         r"0.0\] as vertex 2, counted "
                                                                         r"from 0; expected finite")),
        ("a.obj", CORNERS.replace("v 0 1 0", "v inf 1 0") + TETRAHEDRON, (r"a.obj: a: found \[inf, 1.0, "
                                                                         r"0.0\] as vertex 2")),
        ("a.obj", CORNERS + "f 1 2 3\nf 1 2 9\n", ("a.obj: cannot be read: index 8 is out of bounds .* "
                                                  "size 4; expected a mesh in OBJ")),
        ("a.obj", CORNERS + "f 1 2 -9\n", "a.obj: cannot be read: index -9 is out of bounds"),
        ("a.obj", CORNERS + "f 1 2 3\nf 0 1 2\n", ("a.obj, line 6: found the face 'f 0 1 2'; expected "
                                                  "three corners or more, counted from 1")),
        ("a.obj", CORNERS + "f 1 2 3\nf 1 2\n", ("a.obj, line 6: found the face 'f 1 2'; expected three "
                                                "corners")),
        ("a.obj", CORNERS + "f 1 1 2\nf 3 3 3\n", ("a.obj: a: none of its 2 faces has an area; expected a "
                                                  "mesh of triangles")),
        ("a.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "a.obj: .*; expected"),
        ("a.obj", CORNERS, "a.obj: no face; expected a whole file with a mesh of triangles"),
        ("a.obj", "", "a.obj: no face; expected a whole file with a mesh of triangles"),
        ("a.obj", "v a b c\nf 1 1 1", "a.obj: cannot be read: .*; expected a mesh in OBJ"),
        ("a.ply", PLY.replace("3 0 1 2", "3 0 1 7"), ("a.ply: a: corner 7 in face 0, counted from 0; "
                                                     "expected a number from 0 to 2")),
        ("a.ply", PLY.replace("3 0 1 2", "3 0 1 -1"), "a.ply: a: corner -1 in face 0"),
        ("a.ply", PLY.replace("0 1 0", "nan 1 0"), r"a.ply: a: found \[nan, 1.0, 0.0\] as vertex 2"),
        ("a.ply", "junk", "a.ply: cannot be read: Not a ply file!; expected a mesh in PLY"),
        ("a.glb", b"junk", "a.glb: cannot be read: .*; expected a mesh in GLB"),
        ("a.glb", glb_with_nan(), "a.glb: crate: found .*nan.*; expected finite coordinates"),
        *(("a.stl", content, ("a.stl: no face; expected a whole file with a mesh of "
                             "triangles")) for content in CUT_SHORT),
        ("a.glb", glb_of_two_files(), "a.glb: cannot be read: .*; expected .* with all its data inside"),
        ("a.obj", None, "a.obj: no such file or directory; expected a mesh in OBJ"),
        ("a.fbx", b"", "a.fbx: found the ending '.fbx'; expected one of .obj, .ply, .glb, .stl"),
    ],
)  # fmt: skip
def test_what_cannot_be_scanned_is_refused(tmp_path, name, content, message):
    """Coordinates that are not finite, corners that do not exist, and files that are missing, not whole or
    without a face are named."""
    if content is not None:
        write(tmp_path, content, name)
    with pytest.raises(GeometryError, match=message):
        load_mesh(tmp_path / name, unit="m", up="z")


@pytest.mark.parametrize(
    ("size", "unit", "message"),
    [
        (12_000, "m", (r"measures 1.2e\+04 x 1.2e\+04 x 1.2e\+04 m with unit = 'm'; expected at most 500 "
                      r"m tall .* \(perhaps its unit is mm\)")),
        (0.002, "mm", r"measures 2e-06 x 2e-06 x 2e-06 m with unit = 'mm'; expected .* at least 1 mm"),
        (5, "mm", None),
        (600, "ft", None),
        (2000, "ft", (r"measures 610 x 610 x 610 m with unit = 'ft'; .*\(perhaps its unit is cm or mm or "
                     r"in\)")),
    ],
)  # fmt: skip
def test_a_size_that_tells_of_a_wrong_unit_is_refused(tmp_path, size, unit, message):
    """Nothing is taller than 500 m or smaller than 1 mm: the message has file, size and unit, and which
    unit was perhaps meant."""
    content = CORNERS.replace("1", str(size)) + TETRAHEDRON
    if message is None:
        load(tmp_path, content, unit=unit)
        return
    with pytest.raises(GeometryError, match=message):
        load(tmp_path, content, unit=unit)


TRACK_M = np.array([[0.0, 0.0, 1.5], [3.0, 0.0, 1.5]])
LEAVES = MeshPart(name="leaves", part="leaf", reflectance=0.5, roughness=0.3)
TRIANGLE = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.uint32))


def place(x_m, y_m, z_m=None, above_ground_m=0.0, yaw_deg=0.0, scale=1.0):
    return MeshPlace(x_m=x_m, y_m=y_m, z_m=z_m, above_ground_m=above_ground_m, yaw_deg=yaw_deg, scale=scale)


def tree_of(*places, one_thing=True, parts=(LEAVES,)):
    """Stem and leaves about a centre 2 m over the file's origin and 1 m east of it."""
    meshes = (("leaves", TRIANGLE), ("stem", TRIANGLE))
    mesh = UserMesh(Path("tree.obj"), np.array([1.0, 0.0, 2.0]), meshes, 2.0)
    kind = {"semantic": "tree", "part": "stem", "reflectance": 0.4, "roughness": 0.5, "one_thing": one_thing}
    section = MeshFile(file="tree.obj", unit="m", up="z", parts=[*parts], places=[*places], **kind)
    return section, mesh


class Slope(HallWorld):
    """A hall whose floor rises to the east, for those who ask for its height."""

    def height_m(self, x_m, y_m):
        return 0.1 * x_m + 0.0 * y_m


def furnished(*meshes, reach_m=50.0):
    hall = Slope(Hall(kind="hall", length_m=30.0, width_m=18.0, height_m=6.0))
    return hall, Furnished(hall, meshes=meshes, reach_m=reach_m)


def test_meshes_come_after_what_is_there():
    """The world's own placements and rows stay as they are; each placed part has a row of its own after
    them."""
    hall, world = furnished(tree_of(place(4, 0), place(-4, 2)))
    own, window = hall.window(TRACK_M), world.window(TRACK_M)
    assert window.shapes[: len(own.shapes)] == own.shapes
    assert window.surfaces[: len(own.surfaces)].tolist() == own.surfaces.tolist()
    added = window.surfaces[len(own.surfaces) :]
    n = len(own.shape)
    assert window.shapes[len(own.shapes) :] == (MeshKey(0, Path("tree.obj")),)
    assert (window.shape[n:] == len(own.shapes)).all()
    assert window.first_surface[n:].tolist() == [len(own.surfaces), len(own.surfaces) + 2]
    assert added["part"].tolist() == [PlantPart.LEAF, PlantPart.STEM] * 2
    assert (added["semantic"] == Semantic.TREE).all()
    assert added["reflectance"] == pytest.approx([0.5, 0.4] * 2)
    assert [world.materials[m] for m in added["material"]] == ["tree.obj leaves", "tree.obj stem"] * 2
    assert world.shape(window.shapes[-1]) == (TRIANGLE, TRIANGLE)
    assert (
        world.shape(own.shapes[0])[0].vertices_m.tobytes()
        == hall.shape(own.shapes[0])[0].vertices_m.tobytes()
    )


@pytest.mark.parametrize(("one_thing", "expected"), [(True, [0, 0, 1, 1, 2, 2]), (False, [0, 1, 2, 3, 4, 5])])
def test_each_place_is_a_thing_or_each_part_is(one_thing, expected):
    """Instances count up through files, places and, where parts are things of their own, parts; each has a
    name."""
    places = (place(4, 0), place(-4, 2))
    _, world = furnished(tree_of(*places, one_thing=one_thing), tree_of(place(1, 1), one_thing=one_thing))
    added = world.window(TRACK_M).surfaces[2:]
    assert (added["instance"].astype(np.int64) - FIRST_FREE_INSTANCE).tolist() == expected
    assert set(world.names) == set(added["instance"].tolist())
    assert (
        world.names[FIRST_FREE_INSTANCE] == ("tree.obj" if one_thing else "tree.obj leaves") + " at (4, 0) m"
    )


@pytest.mark.parametrize(
    ("where", "origin"),
    [
        (place(4, 1), [4, 1, 0.4]),
        (place(4, 1, above_ground_m=0.5), [4, 1, 0.9]),
        (place(4, 1, z_m=7.0, above_ground_m=0.5), [4, 1, 7]),
    ],
)
def test_a_mesh_stands_on_the_ground_or_at_its_height(where, origin):
    """The file's origin comes to the ground at its place, to so much over it, or to the height that is
    given."""
    _, world = furnished(tree_of(where))
    T = world.window(TRACK_M).world_T_shape[-1]
    assert pytest.approx(origin) == T @ [-1, 0, -2, 1]


def test_yaw_and_scale_act_about_the_files_origin():
    """A quarter turn takes east to north, and a scale of three is three in all directions."""
    _, world = furnished(tree_of(place(4, 1, z_m=0.0, yaw_deg=90.0, scale=3.0)))
    T = world.window(TRACK_M).world_T_shape[-1]
    file_T_centre = np.array([-1.0, 0.0, -2.0])
    assert T @ [*(file_T_centre + [1, 0, 0]), 1] == pytest.approx([4, 4, 0])
    assert T @ [*(file_T_centre + [0, 1, 0]), 1] == pytest.approx([1, 1, 0])
    assert T @ [*(file_T_centre + [0, 0, 1]), 1] == pytest.approx([4, 1, 3])


def test_only_what_is_in_reach_is_in_the_window():
    """A placement is left out when all of it lies beyond reach of the track, and then leaves no trace."""
    hall, world = furnished(tree_of(place(-1, 25.0), place(0, 14.0), place(0, -60.0)), reach_m=12.5)
    window = world.window(TRACK_M)
    assert window.surfaces["instance"][2:].tolist() == [FIRST_FREE_INSTANCE + 1] * 2
    _, empty = furnished(tree_of(place(0, 60.0)), reach_m=12.5)
    assert empty.window(TRACK_M).shapes == hall.window(TRACK_M).shapes


def test_parts_may_differ_from_the_rest():
    """A part has its own appearance where one is given and the file's where not; a part that is not there
    is refused."""
    rows = surfaces_of(*tree_of(place(0, 0)))
    assert rows["reflectance"] == pytest.approx([0.5, 0.4])
    assert rows["roughness"] == pytest.approx([0.3, 0.5])
    assert rows["part"].tolist() == [PlantPart.LEAF, PlantPart.STEM]
    assert (rows["semantic"] == Semantic.TREE).all()
    with pytest.raises(GeometryError, match=r"tree.obj: parts: found 'leafs'; expected one of leaves, stem"):
        surfaces_of(*tree_of(place(0, 0), parts=[MeshPart(name="leafs")]))
