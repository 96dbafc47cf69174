"""Shapes and labels of things on the ground: stones, dead wood, tufts of grass and low plants.

They have unit size, are grown once per variant and scaled
where they are placed. Numbers and labels of each kind are rows of `floor.toml`. Leaves are kites, two
triangles each.
"""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import resources
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, hypot, matvec, norm, sin
from vlp16emu.forest.plants.branches import merge
from vlp16emu.forest.plants.species import GROUND_MATERIALS
from vlp16emu.forest.purpose import Growth
from vlp16emu.forest.stand.placement import PlacedThings
from vlp16emu.random import generator
from vlp16emu.trees import Table, Tree
from vlp16emu.types import F8, I8, SURFACE, Mesh, PlantPart, Semantic
from vlp16emu.world.vectors import closed_body, unit

Generator = np.random.Generator
Mask = NDArray[np.bool_]
Row = Table

FLOOR_VARIANTS = 6  # different shapes of each kind
STUMP_DEPTH = 0.5  # depth of a stump in the ground over its height above it
_UP = np.array([0.0, 0.0, 1.0])
_ROUND_SIDES = 16  # sides of logs and stumps
_REFLECTANCE_SPREAD = 0.08  # half-range between things
_ICOSAHEDRON = (  # faces, counter-clockwise seen from outside; corners as in `_icosphere`
    *((0, 8, 4), (5, 0, 2), (2, 0, 4), (7, 3, 1), (8, 1, 6)),
    *((4, 8, 6), (1, 3, 6), (10, 1, 8), (10, 0, 5), (8, 0, 10)),
    *((10, 7, 1), (5, 7, 10), (11, 7, 5), (5, 2, 11), (3, 7, 11)),
    *((4, 6, 9), (9, 2, 4), (9, 6, 3), (9, 11, 2), (3, 11, 9)),
)


class FloorKind(StrEnum):
    """Kind of thing on the ground, other than shrubs and trees."""

    STONE = "stone"
    LOG = "log"
    STUMP = "stump"
    TUFT = "tuft"
    HERB = "herb"
    FERN = "fern"
    DWARF_SHRUB = "dwarf_shrub"
    MOSS_CUSHION = "moss_cushion"
    LITTER_HEAP = "litter_heap"
    BROKEN_LOG = "broken_log"
    BROKEN_STUMP = "broken_stump"
    ROOT_PLATE = "root_plate"


@dataclass(frozen=True, slots=True)
class FloorKey:
    """Key of a shape; with the seed it determines the shape."""

    kind: FloorKind
    variant: int
    large: bool = False  # True for a stone so large that its faces would be visible


@cache
def floor() -> dict[str, dict[str, Tree]]:
    """Return the rows of `floor.toml`: shapes by kind, and numbers of layers by section of a scene."""
    text = resources.files(__package__).joinpath("floor.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def shape_row(kind: FloorKind) -> Tree:
    """Return the row of a kind."""
    return floor()["shapes"][kind.value]


def is_ground(kind: FloorKind) -> bool:
    """Return True for a kind that is part of the ground."""
    return bool(shape_row(kind)["semantic"] == "GROUND")


def floor_meshes(seed: int, key: FloorKey) -> tuple[Mesh]:
    """Grow the one mesh of a shape.

    A stone spans -0.5 to 0.5 in z, and its outline seen from above has the area of a circle of diameter
    1. A log, or a piece of a broken log, lies along x from -0.5 to 0.5 with mean diameter 1. A stump
    is 1 high over the ground and 1 wide at the top. A root plate of diameter and thickness 1 stands across x,
    with its roots at -x and the butt of its log at the origin. All others are 1 high and have their foot at
    the origin.
    """
    rng = generator(seed, Growth.FLOOR_SHAPE, list(FloorKind).index(key.kind), key.variant)
    row = shape_row(key.kind)
    if key.large:
        row = row | {"splits": row["large_splits"]}
    return (_FORMS[row["form"]](rng, row),)


def floor_things(
    kind: FloorKind,
    keep: Mask,
    world_T: F8,
    draws: F8,
    *,
    species: I8 | None = None,
    large: Mask | None = None,
) -> PlacedThings:
    """Label the things (n,) selected by `keep`; draws (n, 2 or more) choose variant and brightness."""
    variants = (FLOOR_VARIANTS * draws[keep, 0]).astype(int).tolist()
    larges = [False] * len(variants) if large is None else large[keep].tolist()
    keys = [FloorKey(kind, *pair) for pair in zip(variants, larges, strict=True)]
    shape = shape_row(kind)
    rows = np.zeros((len(variants), 1), SURFACE)
    rows["semantic"] = Semantic[shape["semantic"]]
    rows["part"] = PlantPart[shape["part"]]
    rows["material"] = GROUND_MATERIALS.index(shape["material"])
    rows["reflectance"] = shape["reflectance"] + _REFLECTANCE_SPREAD * (2 * draws[keep, 1:2] - 1)
    if species is not None:
        rows["species"] = species[keep, None]
    return PlacedThings(keys, world_T[keep], rows, is_ground=is_ground(kind))


def _fern(rng: Generator, row: Row) -> Mesh:
    """Fronds that rise from a crown and arch outwards, with pairs of pinnae."""
    fronds = row["fronds"]
    pairs = row["pairs"]
    towards = 2 * np.pi * (np.arange(fronds) + rng.uniform(-0.3, 0.3, fronds)) / fronds
    t = np.linspace(0.2, 1.0, pairs)
    rise = rng.uniform(0.75, 1.0, (fronds, 1)) * sin(0.64 * np.pi * t)
    outward = np.stack([cos(towards), sin(towards), np.zeros(fronds)], axis=-1)[:, None]
    across = np.cross(_UP, outward)
    at = 0.5 * t[:, None] * outward + rise[..., None] * _UP
    length = 0.22 * sin(np.pi * np.linspace(0.35, 0.97, pairs))[:, None]
    sides = [length * (side * across + 0.35 * outward - 0.15 * _UP) for side in (-1, 1)]
    return _kites(np.concatenate([at, at]), np.concatenate(sides), 0.4)


def _herb(rng: Generator, row: Row) -> Mesh:
    """Shoots with a whorl of leaves each."""
    shoots = row["shoots"]
    leaves = row["leaves"]
    at = np.column_stack([_in_disc(rng, shoots, 0.4), rng.uniform(0.55, 1.0, shoots)])[:, None]
    towards = 2 * np.pi * (np.arange(leaves) / leaves + rng.random((shoots, 1)))
    leaf = np.stack([cos(towards), sin(towards), rng.uniform(-0.4, 0.4, towards.shape)], axis=-1)
    return _kites(at - 0.2 * rng.random((shoots, leaves, 1)) * _UP, 0.17 * leaf, 0.6)


def _dwarf_shrub(rng: Generator, row: Row) -> Mesh:
    """Small leaves throughout a dome, denser near its outside."""
    leaves = row["leaves"]
    direction = unit(rng.normal(0.0, 1.0, (leaves, 3)))
    direction[:, 2] = np.abs(direction[:, 2])
    at = direction * np.sqrt(rng.uniform(0.15, 0.8, (leaves, 1))) * [0.5, 0.5, 1.0]
    leaf = rng.normal(0.0, 1.0, (leaves, 3)) * [1.0, 1.0, 0.5]
    return _kites(at, 0.15 * unit(leaf), 0.6)


def _moss_cushion(rng: Generator, row: Row) -> Mesh:
    """Bumpy dome, open below, with its rim in the ground."""
    sides = row["sides"]
    away = np.array([0.22, 0.38, 0.5])
    high = np.array([0.9, 0.6, -0.4])
    angle = 2 * np.pi * np.arange(sides) / sides
    rim = 1 + 0.15 * cos(3 * angle + rng.uniform(0, 2 * np.pi)) * np.ones((3, 1))
    z = high[:, None] + 0.1 * rng.uniform(-1, 1, (3, sides)) * [[1.0], [1.0], [0.0]]
    ring = np.stack([away[:, None] * rim * cos(angle), away[:, None] * rim * sin(angle), z], axis=-1)
    vertices = np.concatenate([[[0.0, 0.0, 1.0]], ring.reshape(-1, 3)])
    corner = np.arange(sides)
    after = np.roll(np.arange(sides), -1)
    faces = [np.column_stack([np.zeros(sides, int), 1 + corner, 1 + after])]
    for low in (1, 1 + sides):
        faces += [np.column_stack([low + corner, low + sides + corner, low + sides + after])]
        faces += [np.column_stack([low + corner, low + sides + after, low + after])]
    return _unit(vertices, np.concatenate(faces))


def _litter_heap(rng: Generator, row: Row) -> Mesh:
    """Leaves on top of each other, and twigs."""
    leaves = row["leaves"]
    twigs = row["twigs"]
    at = np.column_stack([_in_disc(rng, leaves + twigs, 0.36), rng.uniform(0.1, 0.9, leaves + twigs)])
    towards = rng.uniform(0, 2 * np.pi, leaves + twigs)
    tilt = rng.uniform(-0.8, 0.8, leaves + twigs)
    leaf = np.column_stack([cos(towards), sin(towards), tilt])
    length = np.append(rng.uniform(0.14, 0.3, leaves), np.full(twigs, 0.6))[:, None]
    wide = np.append(np.full(leaves, 0.7), np.full(twigs, 0.03))
    return _kites(at - length * leaf / 2 * [1.0, 1.0, 0.0], length * leaf, wide)


def _in_disc(rng: Generator, count: int, radius: float) -> F8:
    towards = rng.uniform(0, 2 * np.pi, count)
    away = radius * np.sqrt(rng.random(count))
    return np.column_stack([away * cos(towards), away * sin(towards)])


def _kites(base: F8, along: F8, wide: F8 | float) -> Mesh:
    """Leaves from bases (..., 3) along vectors (..., 3), level across; `wide` is width over length."""
    base, along = np.broadcast_arrays(base, along)
    base = base.reshape(-1, 3)
    along = along.reshape(-1, 3)
    across = np.cross(_UP, along)
    middle = base + 0.45 * along
    half = 0.5 * np.reshape(wide, (-1, 1)) * across
    vertices = np.stack([base, middle - half, base + along, middle + half], axis=1).reshape(-1, 3)
    faces = 4 * np.arange(len(base))[:, None, None] + np.array([(0, 1, 2), (0, 2, 3)])
    return _unit(vertices, faces.reshape(-1, 3))


def _unit(vertices: F8, faces: I8) -> Mesh:
    """Mesh scaled to a height and a greatest diameter of 1."""
    vertices = vertices / [*(2 * [2 * norm(vertices[:, :2]).max()]), vertices[:, 2].max()]
    return Mesh(vertices.astype(np.float32), faces.astype(np.uint32))


def _stone(rng: Generator, row: Row) -> Mesh:
    sphere, faces = _icosphere(row["splits"])
    waves = rng.normal(0.0, 2.5, (3, row["lobes"]))
    lobes = row["lobe_height"] * sin(matvec(waves.T, sphere) + rng.uniform(0, 2 * np.pi, row["lobes"]))
    vertices = sphere * (1 + lobes.sum(axis=1, keepdims=True))
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    vertices[:, 2] = (vertices[:, 2] - low) / (high - low) - 0.5
    vertices[:, :2] -= vertices[:, :2].mean(axis=0)
    vertices[:, :2] *= np.sqrt(np.pi / 4 / _outline_m2(vertices[:, :2]))
    return Mesh(vertices.astype(np.float32), faces)


def _outline_m2(points: F8) -> float:
    """Return the area of the convex hull of points (n, 2), by Andrew's monotone chain."""
    ordered = points[np.lexsort(points.T)].tolist()
    area = 0.0
    for points_of_side in (ordered, ordered[::-1]):
        chain: list[list[float]] = []
        for x, y in points_of_side:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (y - ay) > (by - ay) * (x - ax):
                    break
                chain.pop()
            chain.append([x, y])
        area += sum(a[0] * b[1] - a[1] * b[0] for a, b in pairwise(chain)) / 2
    return area


def _icosphere(splits: int) -> tuple[F8, NDArray[np.uint32]]:
    """Subdivide the faces of an icosahedron; return unit vectors (v, 3) and triangles (f, 3)."""
    golden = (1 + np.sqrt(5)) / 2
    corners = [np.roll((0.0, a, b * golden), axis) for axis in range(3) for a in (-1, 1) for b in (-1, 1)]
    vertices = np.array(corners) / hypot(1, golden)
    faces = np.array(_ICOSAHEDRON)
    for _ in range(splits):
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        pairs, index = np.unique(edges, axis=0, return_inverse=True)
        middle = len(vertices) + index.reshape(-1, 3)
        midpoints = vertices[pairs].sum(axis=1)
        vertices = np.concatenate([vertices, unit(midpoints)])
        (a, b, c) = faces.T
        (ab, bc, ca) = middle.T
        quarters = np.array([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)])
        faces = quarters.transpose(0, 2, 1).reshape(-1, 3)
    return vertices, faces.astype(np.uint32)


def _log(rng: Generator, row: Row) -> Mesh:
    """Tapering trunk with broken ends, bowed to one side, its thick end at -x."""
    along = np.linspace(-0.5, 0.5, 9)
    rings, ends = _drum(rng, along, 0.5 * (1 - 2 * row["taper"] * along), slant=0.01)
    if row["splinters"]:
        for end in (0, -1):
            rings[end, :, 2] += row["splinters"] * rng.uniform(-1, 1, _ROUND_SIDES)
    mesh = closed_body(rings, ends)
    vertices = np.ascontiguousarray(mesh.vertices_m[:, [2, 0, 1]])
    aside, sway = rng.normal(0.0, row["bow"], 2) * [1.0, 0.4]
    x = vertices[:, 0]
    vertices[:, 1] += aside * (1 / 3 - 4 * x * x) + sway * sin(2 * np.pi * x)
    return Mesh(vertices, mesh.faces)


def _stump(rng: Generator, row: Row) -> Mesh:
    """Foot of a felled tree, with its root flare; with `splinters`, the top is jagged and hollow."""
    splinters = row["splinters"]
    heights = np.array([-STUMP_DEPTH, 0.0, 0.3, 1.0])
    rings, ends = _drum(rng, heights, 0.5 * np.array([1.6, 1.45, 1.15, 1.0]), slant=0.06)
    if splinters:
        rings[-1, :, 2] += splinters * rng.uniform(-1, 1, _ROUND_SIDES)
        ends[-1, 2] -= splinters
    return closed_body(rings, ends)


def _root_plate(rng: Generator, row: Row) -> Mesh:
    """Irregular disc of soil with protruding roots."""
    sides = row["sides"]
    roots: int = row["roots"]
    along, away = np.array(row["profile"]).T
    angle = 2 * np.pi * np.arange(sides) / sides
    rim = 1 + sum(s * cos(n * angle + rng.uniform(0, 2 * np.pi)) for n, s in ((2, 0.1), (3, 0.08), (7, 0.05)))
    radius = 0.5 * away[:, None] * rim
    z = along[:, None] + row["bumps"] * rng.uniform(-1, 1, (len(along), sides))
    soil = np.stack([radius * cos(angle), radius * sin(angle), z], axis=-1)
    pieces = [closed_body(soil, np.array([[0.0, 0.0, -0.95], [0.0, 0.0, 0.2]]))]
    for towards in rng.uniform(0, 2 * np.pi, roots).tolist():
        foot = rng.uniform(0.2, 0.4)
        tip = rng.uniform(0.35, 0.65)
        ends = np.array([[foot, -0.45], [tip, rng.uniform(-1.4, -0.6)]])
        ends = np.column_stack([ends[:, 0] * cos(towards), ends[:, 0] * sin(towards), ends[:, 1]])
        corners = np.stack([cos(angle[::4]), sin(angle[::4]), 0 * angle[::4]], axis=-1)
        pieces.append(
            closed_body(ends[::-1, None] + np.array([0.01, 0.03])[:, None, None] * corners, ends[::-1])
        )
    plate = merge(*pieces)
    return Mesh(np.ascontiguousarray(plate.vertices_m[:, [2, 0, 1]]), plate.faces)


def _drum(rng: Generator, at: F8, radius: F8, *, slant: float) -> tuple[F8, F8]:
    """Rings (r, sides, 3) about the z axis and centres (2, 3) of the ends.

    They have weathered ribs and slanted ends.
    """
    sides = _ROUND_SIDES
    angle = 2 * np.pi * np.arange(_ROUND_SIDES) / _ROUND_SIDES
    ribs = sum(0.04 * cos(n * angle + rng.uniform(0, 2 * np.pi)) for n in (2, 3, 5))
    # Corners are placed so that the cross-section, with ribs, has the area of its circle.
    corner = radius[:, None] * (1 + ribs) * np.sqrt(2 * np.pi / sides / sin(2 * np.pi / sides) / 1.0024)
    x, y = corner * cos(angle), corner * sin(angle)
    z = np.repeat(at[:, None], sides, axis=1)
    tilt = slant * rng.normal(0.0, 1.0, (2, 2))
    for end, (tilt_x, tilt_y) in zip((0, -1), tilt, strict=True):
        z[end] += tilt_x * x[end] + tilt_y * y[end]
    rings = np.stack([x, y, z], axis=-1)
    return rings, rings[[0, -1]].mean(axis=1)


def _tuft(rng: Generator, row: Row) -> Mesh:
    """Blades that start together and bend outwards: a quad from the foot, and one to the tip."""
    n: int = row["blades"]
    towards = rng.uniform(0, 2 * np.pi, n)
    lean = rng.uniform(0.05, 0.45, n)
    length = rng.uniform(0.6, 1.0, n)
    foot = rng.normal(0.0, 0.05, (n, 2))
    outward = np.stack([cos(towards), sin(towards), np.zeros(n)], axis=-1)
    across = np.stack([-sin(towards), cos(towards), np.zeros(n)], axis=-1)
    lean = lean[:, None]
    length = length[:, None]
    base = np.column_stack([foot, np.zeros(n)])
    knee = base + length * (0.6 * _UP + 0.6 * lean * outward)
    tip = knee + length * (0.4 * (1 - lean) * _UP + 0.8 * lean * outward)
    tip[:, 2] /= tip[:, 2].max()
    # Width from the tuft's leaf area, for blades that narrow to a fifth above the knee.
    lower, upper = (float(norm(b - a).sum()) for a, b in ((base, knee), (knee, tip)))
    half_width = row["blade_area"] * n / (2 * lower + 1.2 * upper)
    half = half_width * across
    narrow = 0.2 * half_width * across
    corners = [base - half, base + half, knee + half, knee - half, tip + narrow, tip - narrow]
    vertices = np.stack(corners, axis=1).reshape(-1, 3).astype(np.float32)
    faces = (np.array([(0, 1, 2, 3), (3, 2, 4, 5)]) + 6 * np.arange(n)[:, None, None]).reshape(-1, 4)
    return Mesh(vertices, faces.astype(np.uint32))


_FORMS: dict[str, Callable[[Generator, Row], Mesh]] = {
    "dwarf_shrub": _dwarf_shrub,
    "fern": _fern,
    "herb": _herb,
    "litter_heap": _litter_heap,
    "log": _log,
    "moss_cushion": _moss_cushion,
    "root_plate": _root_plate,
    "stone": _stone,
    "stump": _stump,
    "tuft": _tuft,
}
"""Functions of the forms in `floor.toml`."""
