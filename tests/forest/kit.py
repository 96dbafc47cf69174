"""Records of trees, stands grown tile by tile, solids and their sections, and leaves of meshes as quads
(n, 4, 3)."""

from itertools import product

import numpy as np
import trimesh

from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.stand import TREE

REACH_M = 15.0  # how far about a track windows of the room's forests reach


def trees_of(names, **fields):
    """Records (n,) `TREE` of species by name, upright and at the origin if nothing else is said."""
    trees = np.zeros(len(names), TREE)
    trees["species"] = [flora().trees[name].number for name in names]
    for field, values in fields.items():
        trees[field] = values
    return trees


def grown(stand, across):
    """All trees of a square of tiles, `across` along each side."""
    return np.concatenate([stand.trees(*tile) for tile in product(range(across), repeat=2)])


def feet_m(trees):
    return np.column_stack([trees["x_m"], trees["y_m"], trees["z_m"]])


def corners(mesh):
    return mesh.vertices_m[mesh.faces].astype(np.float64)


def normals(quads):
    """Vectors (n, 3) across quads, twice as long as their areas."""
    a, b, c, d = np.moveaxis(quads, 1, 0)
    return np.cross(c - a, d - b)


def areas_m2(quads):
    return np.linalg.norm(normals(quads), axis=1) / 2


def zeniths(quads):
    """Angles (n,) of normals from the vertical, at most a right one."""
    return np.arccos(np.abs(normals(quads)[:, 2]) / areas_m2(quads) / 2)


def solid_of(meshes):
    """One solid of meshes, whose shared corners become one."""
    corners = np.concatenate([mesh.vertices_m[mesh.faces] for mesh in meshes]).reshape(-1, 3)
    unique, index = np.unique(corners, axis=0, return_inverse=True)
    return trimesh.Trimesh(unique.astype(np.float64), index.reshape(-1, 3), process=False)


def section_m2(solid, normal, at_m):
    """Area of a section across a unit vector, whose outline is seen whole from its middle."""
    lines = trimesh.intersections.mesh_plane(solid, normal, at_m)
    lines -= lines.mean(axis=(0, 1))
    return np.abs(np.cross(lines[:, 0], lines[:, 1]) @ normal).sum() / 2


def section_diameter_m(solid, normal, at_m):
    return 2 * np.sqrt(section_m2(solid, normal, at_m) / np.pi)
