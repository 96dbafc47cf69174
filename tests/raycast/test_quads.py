"""Triangles in pairs."""

import numpy as np
import pytest

from vlp16emu.raycast.quads import faces_of, flatten
from vlp16emu.types import SURFACE, Mesh, Window
from vlp16emu.world.plants.crown import CrownKey, crown_meshes


def grid(n):
    """Square of 2 n n triangles, row by row."""
    y, x = np.meshgrid(*[np.arange(n + 1.0)] * 2, indexing="ij")
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = [(a, a + 1, a + n + 2), (a, a + n + 2, a + n + 1)]
    corners = np.concatenate([np.column_stack(triple) for triple in faces])
    return Mesh(np.column_stack([x.ravel(), y.ravel(), (x * y).ravel()]).astype("f4"), corners.astype("u4"))


def cut(quads):
    """Triangles of quads as Embree cuts them, without those of no area, each turned to its least corner first."""
    both = np.concatenate([quads[:, [0, 1, 3]], quads[:, [2, 3, 1]]])
    return in_order(
        both[(both[:, 0] != both[:, 1]) & (both[:, 1] != both[:, 2]) & (both[:, 2] != both[:, 0])]
    )


def in_order(triangles):
    """Triangles each turned to its least corner first, sorted."""
    least = triangles.argmin(axis=1)[:, None]
    turned = np.take_along_axis(triangles, (least + np.arange(3)) % 3, axis=1).tolist()
    return sorted(map(tuple, turned))


def birch():
    """Branches of a crown: thousands of tubes."""
    return crown_meshes(4, CrownKey("silver_birch", 0, 0.24, 21.0, 9.0, 5.0, 60.0))[1]


@pytest.mark.parametrize(
    "mesh",
    [grid(9), birch(), Mesh(np.eye(3, dtype="f4"), np.array([[0, 1, 2]], "u4"))],
    ids=["grid", "tubes", "one triangle"],
)
def test_quads_are_the_same_triangles(mesh):
    """Cut as Embree cuts them, the quads are the triangles of the mesh, each once and turned the same way."""
    vertices_m, quads = faces_of(mesh)
    assert cut(quads) == in_order(mesh.faces)
    assert np.array_equal(vertices_m[:-1], mesh.vertices_m)
    assert quads.max() < len(vertices_m) - 1


def test_most_triangles_find_a_partner():
    """A grid needs half as many quads as triangles, and tubes at most 0.7."""
    assert len(faces_of(grid(9))[1]) == 81
    assert len(faces_of(birch())[1]) < 0.7 * len(birch().faces)


def test_quads_stay_as_they_are():
    """A mesh of quads keeps its faces, and the slow twin cuts them into the same triangles."""
    mesh = Mesh(grid(1).vertices_m, np.array([[0, 1, 3, 2]], "u4"))
    assert np.array_equal(faces_of(mesh)[1], mesh.faces)
    place = np.eye(4)[None, :3]
    window = Window(np.zeros(3), ("one",), np.zeros(1, "i4"), place, np.zeros(1, "u4"), np.zeros(1, SURFACE))
    corners_m, _ = flatten(window, lambda _: (mesh,))
    assert np.array_equal(corners_m, mesh.vertices_m[[[0, 1, 2], [3, 2, 1]]])


def test_pairs_depend_on_the_mesh_alone():
    """The same mesh gives the same bytes."""
    assert faces_of(birch())[1].tobytes() == faces_of(birch())[1].tobytes()
