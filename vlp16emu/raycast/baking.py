"""Which placements of a window are written out together, and which stay instances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.quads import Faces
from vlp16emu.types import ShapeKey, Window

__all__ = ["FEW_QUADS", "Layout", "Pile", "baked", "lay_out"]

FEW_QUADS = 200
"""Shapes of no more quads are written out wherever they lie: stones, tufts, logs. Larger ones gained nothing, in
`scenes/reference_forest`, for the memory that they took."""

_CELL_M = 20.0
"""Edge of the squares that things are gathered in; 40 m and 80 m were no faster."""


@dataclass(frozen=True, slots=True)
class Pile:
    """Placements that are written out in one frame: all that its geometry is made of, and so its name."""

    keys: tuple[ShapeKey, ...]
    shape: tuple[int, ...]
    """Of each placement, index into `keys`."""
    transforms: bytes
    """pile_T_shape (n, 3, 4) float64; the pile's axes are those of the world."""
    rows: tuple[int, ...]
    """First surface of each placement, from the pile's first."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How a window is put together."""

    piles: tuple[Pile, ...]
    origin_m: NDArray[np.float64]
    """(p, 3) of each pile, world."""
    first_surface: NDArray[np.uint32]
    """(p,) of each pile."""
    instances: NDArray[np.int64]
    """(n,) placements that are in no pile."""


def lay_out(window: Window, small: NDArray[np.bool_]) -> Layout:
    """Gather what is `small`, of each shape (s,), and shapes that stand once and are not turned, such as ground.

    Neighbours in the window's order that lie in one square make a pile. A world that gives a place the same
    things in the same order gives it the same pile in every window. What moves stays an instance.
    """
    unturned = (window.world_T_shape[:, :, :3] == np.eye(3)).all(axis=(1, 2))
    alone = np.bincount(window.shape, minlength=len(window.shapes)) == 1
    whole = small[window.shape] | (unturned & alone[window.shape])
    if window.sway is not None:
        whole[window.sway.placement] = False
    gathered = np.flatnonzero(whole)
    cell = np.floor(window.world_T_shape[gathered, :2, 3] / _CELL_M)
    ends = np.flatnonzero((np.diff(cell, axis=0) != 0).any(axis=1)) + 1
    heaps = [heap for heap in np.split(gathered, ends) if len(heap)]
    origin_m = np.round(window.world_T_shape[[heap[0] for heap in heaps], :, 3]).reshape(-1, 3)
    return Layout(
        tuple(_pile(window, heap, origin) for heap, origin in zip(heaps, origin_m, strict=True)),
        origin_m,
        np.array([window.first_surface[heap].min() for heap in heaps], np.uint32),
        np.flatnonzero(~whole),
    )


def baked(pile: Pile, faces: Sequence[Sequence[Faces]]) -> dict[int, Faces]:
    """Write a pile out.

    Parameters
    ----------
    faces : of the meshes of each of the pile's shapes

    Returns
    -------
    Faces by surface, numbered from the pile's first
    """
    transforms = np.frombuffer(pile.transforms).reshape(-1, 3, 4)
    shape, rows = np.array(pile.shape), np.array(pile.rows)
    parts: dict[int, list[Faces]] = {}
    for which, meshes in enumerate(faces):
        own = np.flatnonzero(shape == which)
        turned = transforms[own, None]
        for number, (vertices_m, quads) in enumerate(meshes):
            # Column by column: the same sums whatever the number of vertices and placements.
            x, y, z = vertices_m.astype(np.float64).T[:, None, :, None]
            places = turned[..., 0] * x + turned[..., 1] * y + turned[..., 2] * z + turned[..., 3]
            for row, place_m in zip((rows[own] + number).tolist(), places.astype(np.float32), strict=True):
                parts.setdefault(row, []).append((place_m, quads))
    return {row: _joined(parts[row]) for row in sorted(parts)}


def _pile(window: Window, heap: NDArray[np.int64], origin_m: NDArray[np.float64]) -> Pile:
    """Name the placements of a heap."""
    # Numbered as they come, not as they are numbered in this window: other windows number them otherwise.
    index_of: dict[int, int] = {}
    shape = tuple(index_of.setdefault(which, len(index_of)) for which in window.shape[heap].tolist())
    transforms = window.world_T_shape[heap]
    transforms[:, :, 3] -= origin_m
    rows = window.first_surface[heap] - window.first_surface[heap].min()
    keys = tuple(window.shapes[which] for which in index_of)
    return Pile(keys, shape, transforms.tobytes(), tuple(rows.tolist()))


def _joined(parts: list[Faces]) -> Faces:
    """Faces of one surface, in order."""
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(vertices_m) for vertices_m, _ in parts)], dtype=np.uint32)
    quads = [faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)]
    return np.concatenate([vertices_m for vertices_m, _ in parts]), np.concatenate(quads)
