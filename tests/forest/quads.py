"""Leaves of meshes as the tests look at them: quads (n, 4, 3)."""

import numpy as np


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
