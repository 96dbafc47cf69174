"""Shapes of what covers the ground: ferns, herbs, dwarf shrubs, moss and litter, of unit size.

Each is 1 high and has an outline of diameter 1; leaves are kites, two triangles each. What they look like are assumptions, after
pictures in floras.
"""

import numpy as np

from vlp16emu.elementary import cos, norm, sin
from vlp16emu.types import Array, IntArray, Mesh
from vlp16emu.world.vectors import unit

Generator = np.random.Generator

_UP = np.array([0.0, 0.0, 1.0])


def fern(rng: Generator) -> Mesh:
    """Nine fronds that rise from a crown and arch outwards, with eight pairs of pinnae each."""
    fronds, pairs = 9, 8
    towards = 2 * np.pi * (np.arange(fronds) + rng.uniform(-0.3, 0.3, fronds)) / fronds
    t = np.linspace(0.2, 1.0, pairs)
    rise = rng.uniform(0.75, 1.0, (fronds, 1)) * sin(0.64 * np.pi * t)
    outward = np.stack([cos(towards), sin(towards), np.zeros(fronds)], axis=-1)[:, None]
    across = np.cross(_UP, outward)
    at = 0.5 * t[:, None] * outward + rise[..., None] * _UP
    length = 0.22 * sin(np.pi * np.linspace(0.35, 0.97, pairs))[:, None]
    sides = [length * (side * across + 0.35 * outward - 0.15 * _UP) for side in (-1, 1)]
    return _kites(np.concatenate([at, at]), np.concatenate(sides), 0.4)


def herb(rng: Generator) -> Mesh:
    """Nine shoots with a whorl of four leaves each."""
    shoots, leaves = 9, 4
    at = np.column_stack([_in_disc(rng, shoots, 0.4), rng.uniform(0.55, 1.0, shoots)])[:, None]
    towards = 2 * np.pi * (np.arange(leaves) / leaves + rng.random((shoots, 1)))
    leaf = np.stack([cos(towards), sin(towards), rng.uniform(-0.4, 0.4, towards.shape)], axis=-1)
    return _kites(at - 0.2 * rng.random((shoots, leaves, 1)) * _UP, 0.17 * leaf, 0.6)


def dwarf_shrub(rng: Generator) -> Mesh:
    """Small leaves all through a dome, more of them near its outside."""
    leaves = 90
    direction = unit(rng.normal(0.0, 1.0, (leaves, 3)))
    direction[:, 2] = np.abs(direction[:, 2])
    at = direction * np.sqrt(rng.uniform(0.15, 0.8, (leaves, 1))) * [0.5, 0.5, 1.0]
    leaf = rng.normal(0.0, 1.0, (leaves, 3)) * [1.0, 1.0, 0.5]
    return _kites(at, 0.15 * unit(leaf), 0.6)


def moss_cushion(rng: Generator) -> Mesh:
    """Make a bumpy dome, open below, whose rim is in the ground."""
    sides, away, high = 12, np.array([0.22, 0.38, 0.5]), np.array([0.9, 0.6, -0.4])
    angle = 2 * np.pi * np.arange(sides) / sides
    rim = 1 + 0.15 * cos(3 * angle + rng.uniform(0, 2 * np.pi)) * np.ones((3, 1))
    z = high[:, None] + 0.1 * rng.uniform(-1, 1, (3, sides)) * [[1.0], [1.0], [0.0]]
    ring = np.stack([away[:, None] * rim * cos(angle), away[:, None] * rim * sin(angle), z], axis=-1)
    vertices = np.concatenate([[[0.0, 0.0, 1.0]], ring.reshape(-1, 3)])
    here, after = np.arange(sides), np.roll(np.arange(sides), -1)
    faces = [np.column_stack([np.zeros(sides, int), 1 + here, 1 + after])]
    for low in (1, 1 + sides):
        faces += [np.column_stack([low + here, low + sides + here, low + sides + after])]
        faces += [np.column_stack([low + here, low + sides + after, low + after])]
    return _unit(vertices, np.concatenate(faces))


def litter_heap(rng: Generator) -> Mesh:
    """Leaves that lie one on the other, and three twigs."""
    leaves, twigs = 16, 3
    at = np.column_stack([_in_disc(rng, leaves + twigs, 0.36), rng.uniform(0.1, 0.9, leaves + twigs)])
    towards = rng.uniform(0, 2 * np.pi, leaves + twigs)
    tilt = rng.uniform(-0.8, 0.8, leaves + twigs)
    leaf = np.column_stack([cos(towards), sin(towards), tilt])
    length = np.append(rng.uniform(0.14, 0.3, leaves), np.full(twigs, 0.6))[:, None]
    wide = np.append(np.full(leaves, 0.7), np.full(twigs, 0.03))
    return _kites(at - length * leaf / 2 * [1.0, 1.0, 0.0], length * leaf, wide)


def _in_disc(rng: Generator, count: int, radius: float) -> Array:
    towards, away = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.random(count))
    return np.column_stack([away * cos(towards), away * sin(towards)])


def _kites(base: Array, along: Array, wide: Array | float) -> Mesh:
    """Leaves from bases (..., 3) along vectors (..., 3), level across, their width over their length given."""
    base, along = np.broadcast_arrays(base, along)
    base, along = base.reshape(-1, 3), along.reshape(-1, 3)
    across = np.cross(_UP, along)
    middle = base + 0.45 * along
    half = 0.5 * np.reshape(wide, (-1, 1)) * across
    vertices = np.stack([base, middle - half, base + along, middle + half], axis=1).reshape(-1, 3)
    faces = 4 * np.arange(len(base))[:, None, None] + np.array([(0, 1, 2), (0, 2, 3)])
    return _unit(vertices, faces.reshape(-1, 3))


def _unit(vertices: Array, faces: IntArray) -> Mesh:
    """Stretch to a height and a greatest diameter of 1."""
    vertices = vertices / [*(2 * [2 * norm(vertices[:, :2]).max()]), vertices[:, 2].max()]
    return Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
