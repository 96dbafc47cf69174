"""A world with the user's meshes in it."""

from pathlib import Path

import numpy as np
import pytest

from vlp16emu.errors import GeometryError
from vlp16emu.forest.stand.forest import FIRST_FREE_INSTANCE
from vlp16emu.types import Mesh, PlantPart, Semantic
from vlp16emu.world.furnished import Furnished, Furniture, MeshKey
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall, MeshFile, MeshPart, MeshPlace
from vlp16emu.world.user_mesh import PartMesh, UserMesh

TRACK_M = np.array([[0.0, 0.0, 1.5], [3.0, 0.0, 1.5]])
LEAVES = MeshPart(name="leaves", part="leaf", reflectance=0.5)
TRIANGLE = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.uint32))


def place(x_m, y_m, z_m=None, above_ground_m=0.0, yaw_deg=0.0, scale=1.0):
    return MeshPlace(x_m=x_m, y_m=y_m, z_m=z_m, above_ground_m=above_ground_m, yaw_deg=yaw_deg, scale=scale)


def tree_of(*places, one_thing=True, parts=(LEAVES,)):
    """Stem and leaves about a centre 2 m over the file's origin and 1 m east of it."""
    meshes = (PartMesh("leaves", TRIANGLE), PartMesh("stem", TRIANGLE))
    mesh = UserMesh(Path("tree.obj"), np.array([1.0, 0.0, 2.0]), meshes, 2.0)
    section = MeshFile(
        file="tree.obj",
        unit="m",
        up="z",
        semantic="tree",
        part="stem",
        reflectance=0.4,
        one_thing=one_thing,
        parts=[*parts],
        places=[*places],
    )
    return Furniture(section, mesh)


class Slope(HallWorld):
    """A hall whose floor rises to the east, for those who ask for its height."""

    def height_m(self, x_m, y_m):
        """One in ten."""
        return 0.1 * x_m + 0.0 * y_m


def furnished(*furniture, reach_m=50.0):
    hall = Slope(Hall(kind="hall", length_m=30.0, width_m=18.0, height_m=6.0))
    return hall, Furnished(hall, furniture=furniture, reach_m=reach_m)


def test_meshes_come_after_what_is_there():
    """The world's own placements and rows stay as they are; each placed part has a row of its own after them."""
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
    assert world.shape(own.shapes[0])[0].vertices_m.tobytes() == hall.shape(own.shapes[0])[0].vertices_m.tobytes()


@pytest.mark.parametrize(("one_thing", "expected"), [(True, [0, 0, 1, 1, 2, 2]), (False, [0, 1, 2, 3, 4, 5])])
def test_each_place_is_a_thing_or_each_part_is(one_thing, expected):
    """Instances count up through files, places and, where parts are things of their own, parts; each has a name."""
    places = (place(4, 0), place(-4, 2))
    _, world = furnished(tree_of(*places, one_thing=one_thing), tree_of(place(1, 1), one_thing=one_thing))
    added = world.window(TRACK_M).surfaces[2:]
    assert (added["instance"].astype(np.int64) - FIRST_FREE_INSTANCE).tolist() == expected
    assert set(world.names) == set(added["instance"].tolist())
    assert world.names[FIRST_FREE_INSTANCE] == ("tree.obj" if one_thing else "tree.obj leaves") + " at (4, 0) m"


@pytest.mark.parametrize(
    ("where", "origin"),
    [
        (place(4, 1), [4, 1, 0.4]),
        (place(4, 1, above_ground_m=0.5), [4, 1, 0.9]),
        (place(4, 1, z_m=7.0, above_ground_m=0.5), [4, 1, 7]),
    ],
)
def test_a_mesh_stands_on_the_ground_or_at_its_height(where, origin):
    """The file's origin comes to the ground at its place, to so much over it, or to the height that is given."""
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
    """A part has its own appearance where one is given and the file's where not; a part that is not there is refused."""
    rows = tree_of(place(0, 0)).surfaces
    assert rows["reflectance"] == pytest.approx([0.5, 0.4])
    assert rows["part"].tolist() == [PlantPart.LEAF, PlantPart.STEM]
    assert (rows["semantic"] == Semantic.TREE).all()
    with pytest.raises(GeometryError, match=r"tree.obj: parts: found 'leafs'; expected one of leaves, stem"):
        tree_of(place(0, 0), parts=[MeshPart(name="leafs")])
