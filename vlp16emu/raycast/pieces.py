"""Pieces of shapes with tight boxes, each an instance.

A ray is transformed into the coordinates of every instance whose box it passes, which is a large part of the
cost, and the rays of a lidar are nearly level: the relevant size of a box is its area seen from the side. So
stems are separate from the ground, and crowns are cut into horizontal slabs, each as wide as the crown there.
What bends is always cut, as a piece moves straight.
"""

from collections.abc import Sequence

import numpy as np

from vlp16emu.kernels.compiler import kernel
from vlp16emu.types import F4, F8, I8, U4, Mesh

Faces = tuple[F4, U4]  # vertices (v, 3) in metres, and triangles (t, 3)

_SLAB_M = 1.5
"""Height of a slab: with separate bodies it saves a fifth of the time for near faces in
`scenes/reference_forest`; 1 m and 2 m gain the same within 2 %."""

_WORTH = 0.7
"""Slabs become pieces if the total area of their boxes is at most this share of the area of the box around
them; from 0.6 to 0.95 the gain is the same, with more pieces."""


def faces_of(mesh: Mesh) -> Faces:
    """Return vertices and triangles of a mesh, contiguous; quads (a, b, c, d) become (a, b, d), (c, d, b)."""
    quads = mesh.faces.shape[1] == 4
    triangles = mesh.faces[:, [0, 1, 3, 2, 3, 1]].reshape(-1, 3) if quads else mesh.faces
    return np.ascontiguousarray(mesh.vertices_m), np.ascontiguousarray(triangles)  # read by their addresses


def split_into_pieces(faces: Sequence[Faces], *, bends: bool = False) -> tuple[tuple[Faces, ...], I8, F8]:
    """Order the triangles of a shape by pieces.

    Parameters
    ----------
    faces : faces of each mesh
    bends : whether slabs become pieces even if they do not pay

    Returns
    -------
    The same faces, in each mesh ordered by piece; the first face of each piece, (pieces + 1, meshes); and the
    boxes of pieces, (pieces, 2, 3)
    """
    ordered = list(faces)
    counts = [np.zeros((1, len(faces)), np.int64)]
    boxes = [np.zeros((0, 2, 3))]
    for body in _bodies(faces):
        slabs, around = _slabs([faces[mesh] for mesh in body], bends=bends)
        boxes.append(around)
        count = np.zeros((1 + max(int(slab.max()) for slab in slabs), len(faces)), np.int64)
        for mesh, slab in zip(body, slabs, strict=True):
            vertices_m, triangles = faces[mesh]
            ordered[mesh] = vertices_m, triangles[np.argsort(slab, kind="stable")]
            count[:, mesh] = np.bincount(slab, minlength=len(count))
        counts.append(count[count.any(axis=1)])
    return tuple(ordered), np.concatenate(counts).cumsum(axis=0), np.concatenate(boxes)


def _bodies(faces: Sequence[Faces]) -> list[list[int]]:
    """Group non-empty meshes, in order, while a common box is no larger than separate ones."""
    bodies = list[list[int]]()
    around = np.zeros((2, 3))
    for mesh, (vertices_m, triangles) in enumerate(faces):
        if not len(triangles):
            continue
        axes_m = np.ascontiguousarray(vertices_m.T)  # numpy is ten times as fast along rows
        box = np.array([axes_m.min(axis=1), axes_m.max(axis=1)])
        common = np.array([np.minimum(around[0], box[0]), np.maximum(around[1], box[1])])
        if bodies and _side_m2(common) <= _side_m2(around) + _side_m2(box):
            bodies[-1].append(mesh)
            around = common
        else:
            bodies.append([mesh])
            around = box
    return bodies


def _slabs(body: Sequence[Faces], *, bends: bool) -> tuple[list[I8], F8]:
    """Return the slab (t,) of each triangle, all 0 if slabs do not pay, and the boxes of non-empty slabs."""
    low_m = min(float(vertices_m[:, 2].min()) for vertices_m, _ in body)
    high_m = max(float(vertices_m[:, 2].max()) for vertices_m, _ in body)
    boxes = np.repeat([[[np.inf] * 3, [-np.inf] * 3]], 1 + int((high_m - low_m) / _SLAB_M), axis=0)
    slabs = [np.zeros(len(triangles), np.int64) for _, triangles in body]
    for (vertices_m, triangles), slab in zip(body, slabs, strict=True):
        _assign_to_slabs(vertices_m, triangles, low_m, slab, boxes)
    boxes = boxes[boxes[:, 1, 2] > -np.inf]
    around = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    if not bends and _side_m2(boxes).sum() > _WORTH * _side_m2(around):
        return [np.zeros_like(slab) for slab in slabs], around[None]
    return slabs, boxes


def _side_m2(boxes: F8) -> F8:
    """Return side areas (...,) of boxes (..., 2, 3): two faces, in proportion to the mean projected area."""
    size: F8 = boxes[..., 1, :] - boxes[..., 0, :]
    return (size[..., 0] + size[..., 1]) * size[..., 2]


@kernel
def _assign_to_slabs(vertices_m: F4, triangles: U4, low_m: float, slab: I8, boxes: F8) -> None:
    """Assign triangles (t, 3) to the slabs of their lowest corners, and extend boxes (slabs, 2, 3)."""
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        slab[t] = int((min(vertices_m[a, 2], vertices_m[b, 2], vertices_m[c, 2]) - low_m) / _SLAB_M)
        box = boxes[slab[t]]
        for corner in range(3):
            for axis in range(3):
                at = vertices_m[triangles[t, corner], axis]
                box[0, axis], box[1, axis] = min(box[0, axis], at), max(box[1, axis], at)
