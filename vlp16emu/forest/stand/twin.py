"""Things near a path, and the digital twin of a part of the world, as labelled nodes of glTF.

glTF has y up (glTF 2.0 specification, section 3.4), so the root node converts from the world's z up;
programs with z up, such as Blender, convert it back.
"""

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import norm
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.forest.plants.prototypes import SaplingKey
from vlp16emu.forest.stand.floor_shapes import FloorKey, is_ground
from vlp16emu.forest.tiles import TILE_M, TileKey
from vlp16emu.trees import Tree
from vlp16emu.types import F8, Mesh, PlantPart, Semantic, ShapeKey, Window

Grow = Callable[[ShapeKey], tuple[Mesh, ...]]
Inside = Callable[[F8], NDArray[np.bool_]]  # mask of the points (n, 2) inside an area


@dataclass(frozen=True, slots=True)
class Thing:
    """A thing near the path, other than a tree of the stand."""

    instance: int
    species: int
    kind: str
    """`sapling`, or the `FloorKind` of things on the ground, or else the semantic class in lower case."""
    place_m: F8  # (3,) origin of its shape in the world
    size_m: tuple[float, float, float]
    """Size along the axes of its shape: for stones length, width and height; for logs length and mean
    diameter; for stumps the diameter at the top and the height; for anything else its extent."""


def things_near(
    window: Window, shape: Grow, *, trees: NDArray[np.uint32], path: Polyline, radius_m: float
) -> list[Thing]:
    """Things within a radius of a path, in the order of the window, without the instances of `trees` (n,)."""
    grounds = (
        isinstance(key, TileKey) or (isinstance(key, FloorKey) and is_ground(key.kind))
        for key in window.shapes
    )
    is_thing = ~np.fromiter(grounds, np.bool_)[window.shape]
    no_tree = ~np.isin(window.surfaces["instance"][window.first_surface], trees)
    near = path.distance_m(window.world_T_shape[:, :2, 3]) <= radius_m
    # Floor shapes have unit size by definition, which differs from their extent.
    unit_m = cache(lambda key: np.ptp(np.concatenate([mesh.vertices_m for mesh in shape(key)]), axis=0))
    found = []
    for i in np.flatnonzero(is_thing & no_tree & near).tolist():
        key = window.shapes[window.shape[i]]
        world_T_shape = window.world_T_shape[i]
        row = window.surfaces[window.first_surface[i]]
        scale = norm(world_T_shape[:, :3].T)
        size_m = tuple((scale if isinstance(key, FloorKey) else unit_m(key) * scale).tolist())
        kind = key.kind.value if isinstance(key, FloorKey) else Semantic(row["semantic"]).name.lower()
        kind = "sapling" if isinstance(key, SaplingKey) else kind
        found.append(
            Thing(int(row["instance"]), int(row["species"]), kind, world_T_shape[:, 3].copy(), size_m)
        )
    return found


_YUP_R_WORLD = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0, 0, 0, 1.0]])
"""Converts x east, y north, z up into x east, y up, z south."""
_ROOT = "world z up"  # name of the root node


def label(row: np.void, species: Mapping[int, str], *, with_part: bool) -> str:
    """Name one `SURFACE` by its labels, for instance `tree_000123/silver_birch/stem`.

    Ground is just `ground`.
    """
    words = [Semantic(row["semantic"]).name.lower()]
    if row["instance"]:
        words[0] += f"_{row['instance']:06d}"
    if row["species"]:
        words.append(species[int(row["species"])])
    if with_part and row["part"]:
        words.append(PlantPart(row["part"]).name.lower())
    return "/".join(words)


def write_glb(
    file: BinaryIO,
    window: Window,
    shape: Grow,
    *,
    places_m: Mapping[int, F8],
    inside: Inside | None,
    species: Mapping[int, str],
    colours: NDArray[np.uint8],
) -> None:
    """Write complete instances of a window, and the ground of an area; shared shapes are stored once.

    Parameters
    ----------
    places_m : by instance, (3,) origin of its node in the world
    inside : the area; None to write the whole window; nodes of instances without a place are then at their
        placement
    species : names by number
    colours : (m, 3) sRGB of the window's surfaces
    """
    twin = _Twin(window, species, colours, places_m)
    wanted = np.ones(len(window.surfaces), np.bool_)
    placed = np.arange(len(window.shape))
    if inside is not None:
        wanted = np.isin(window.surfaces["instance"], list(places_m))
        tiles = {(int(x_m // TILE_M), int(y_m // TILE_M)) for x_m, y_m, _ in places_m.values()}
        is_tile = np.array([_has_part(key, tiles, inside) for key in window.shapes], np.bool_)
        placed = np.flatnonzero(wanted[window.first_surface] | is_tile[window.shape])
    order = placed[np.argsort(window.shape[placed], kind="stable")].tolist()
    for number_of_shape, alike in groupby(order, key=lambda placement: int(window.shape[placement])):
        meshes = shape(window.shapes[number_of_shape])  # only one shape at a time is in memory
        for placement in alike:
            first = int(window.first_surface[placement])
            for number, mesh in enumerate(meshes):
                is_ground = number == 0 and isinstance(window.shapes[number_of_shape], TileKey)
                corner_m = window.world_T_shape[placement, :2, 3]
                shown = _crop(mesh, corner_m, inside) if is_ground and inside else mesh
                if len(shown.faces) and (is_ground or wanted[first + number]):
                    twin.add(placement, number, shown)
    file.write(twin.trimesh.exchange.gltf.export_glb(twin.scene, include_normals=False))


def _has_part(key: ShapeKey, tiles: Container[tuple[int, int]], inside: Inside) -> bool:
    """Return whether a tile contains an instance or ground of the area."""
    if not isinstance(key, TileKey):
        return False
    # Points a metre apart can only miss a corner of the area.
    x_m, y_m = np.meshgrid(*(TILE_M * n + np.arange(TILE_M + 1) for n in (key.ix, key.iy)))
    return (key.ix, key.iy) in tiles or bool(inside(np.column_stack([x_m.ravel(), y_m.ravel()])).any())


def _crop(ground: Mesh, corner_m: F8, inside: Inside) -> Mesh:
    middles_m = ground.vertices_m[ground.faces].mean(axis=1)[:, :2] + corner_m
    used, faces = np.unique(ground.faces[inside(middles_m)], return_inverse=True)
    return Mesh(ground.vertices_m[used], faces.reshape(-1, 3).astype(np.uint32))


class _Twin:
    def __init__(
        self,
        window: Window,
        species: Mapping[int, str],
        colours: NDArray[np.uint8],
        places_m: Mapping[int, F8],
    ) -> None:
        import trimesh  # here: it takes a while to load

        self.trimesh = trimesh
        self._window = window
        self._species = species
        self._colours = colours
        self._places_m = places_m
        self._materials: Tree = {}
        self._nodes: dict[str, int] = {}  # number of uses of each name
        self.scene = trimesh.Scene(metadata={"unit": "m"})
        self.scene.graph.update(frame_to=_ROOT, matrix=_YUP_R_WORLD)

    def add(self, placement: int, number: int, mesh: Mesh) -> None:
        """Add mesh `number` of a placement below the node of its plant; other things are their own node."""
        window = self._window
        surface = int(window.first_surface[placement]) + number
        row = window.surfaces[surface]
        shape = int(window.shape[placement])
        parent = _ROOT
        vertices_m = mesh.vertices_m
        world_T_shape = np.eye(4)
        world_T_shape[:3] = window.world_T_shape[placement]
        if row["instance"] and row["part"]:
            place_m = self._places_m.get(int(row["instance"]), window.world_T_shape[placement, :, 3])
            parent = self._instance(row, place_m)
            world_T_shape[:3, 3] -= place_m
            if isinstance(window.shapes[shape], TileKey):  # not shared: the node takes its origin
                vertices_m = (vertices_m + world_T_shape[:3, 3]).astype(np.float32)
                world_T_shape[:3, 3] = 0.0
        name = f"shape_{shape}_{number}"
        if name not in self.scene.geometry:
            faces = mesh.faces
            if faces.shape[1] == 4:  # quads (a, b, c, d) are cut into (a, b, d) and (c, d, b) as casters do
                faces = np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])
            look = self.trimesh.visual.TextureVisuals(material=self._material(row, self._colours[surface]))
            self.scene.geometry[name] = self.trimesh.Trimesh(vertices_m, faces, visual=look, process=False)
        node = label(row, self._species, with_part=True)
        self._nodes[node] = self._nodes.get(node, 0) + 1
        node += f".{self._nodes[node]}" if self._nodes[node] > 1 else ""
        self.scene.graph.update(node, parent, matrix=world_T_shape, geometry=name, metadata=_extras(row))

    def _instance(self, row: np.void, place_m: F8) -> str:
        name = label(row, self._species, with_part=False)
        if name not in self._nodes:
            self._nodes[name] = 1
            world_T_instance = self.trimesh.transformations.translation_matrix(place_m)
            extras = {key: value for key, value in _extras(row).items() if key != "part"}
            self.scene.graph.update(name, _ROOT, matrix=world_T_instance, metadata=extras)
        return name

    def _material(self, row: np.void, colour: NDArray[np.uint8]) -> Any:
        """Shared material of a part of a species, or of another kind of thing."""
        part = PlantPart(row["part"]).name if row["part"] else Semantic(row["semantic"]).name
        name = f"{self._species.get(int(row['species']), '')} {part}".strip().lower()
        if name not in self._materials:
            # Linear factors from sRGB (IEC 61966-2-1), as required for base colours in glTF (section 3.9.2).
            share = colour / 255
            linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4).tolist()
            look: Tree = {"metallicFactor": 0.0, "roughnessFactor": 1.0, "doubleSided": True}
            look["baseColorFactor"] = [*linear, 1.0]
            self._materials[name] = self.trimesh.visual.material.PBRMaterial(name, **look)
        return self._materials[name]


def _extras(row: np.void) -> dict[str, int]:
    return {name: int(row[name]) for name in ("semantic", "part", "instance", "species")}
