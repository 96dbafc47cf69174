"""A digital twin: what stands there as glTF, every thing a node that carries its labels.

glTF has y up (glTF 2.0 specification, section 3.4), so one node above all turns the world's z up into it;
programs that have z up themselves, such as Blender, turn it back.
"""

from collections.abc import Callable, Mapping
from itertools import groupby
from typing import Any, BinaryIO

import numpy as np
import trimesh
from numpy.typing import NDArray

from vlp16emu.forest.tiles import TileKey
from vlp16emu.types import Array, Mesh, PlantPart, Semantic, ShapeKey, Window

_YUP_R_WORLD = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0, 0, 0, 1.0]])
"""Turns x east, y north, z up into x east, y up, z south."""
_ROOT = "world z up"  # name of the node that holds everything


def label(row: np.void, species: Mapping[int, str], *, with_part: bool) -> str:
    """Name one `SURFACE` by its labels, for instance `tree_000123/silver_birch/stem`; ground is just `ground`."""
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
    shape: Callable[[ShapeKey], tuple[Mesh, ...]],
    *,
    places_m: Mapping[int, Array],
    species: Mapping[int, str],
    colours: NDArray[np.uint8],
) -> int:
    """Write all that is in a window; what is placed often is stored once. Returns the number of instances.

    Parameters
    ----------
    places_m : by instance, (3,) origin of its node in the world; where its placement is, if not given
    species : names by number
    colours : (m, 3) sRGB of the window's surfaces
    """
    twin = _Twin(window, species, colours, places_m)
    order = np.argsort(window.shape, kind="stable").tolist()
    for which, alike in groupby(order, key=lambda placement: int(window.shape[placement])):
        meshes = shape(window.shapes[which])  # one shape at a time is held in memory
        for placement in alike:
            for number, mesh in enumerate(meshes):
                if len(mesh.faces):
                    twin.add(placement, number, mesh)
    file.write(trimesh.exchange.gltf.export_glb(twin.scene, include_normals=False))
    return len(twin.instances)


class _Twin:
    def __init__(
        self, window: Window, species: Mapping[int, str], colours: NDArray[np.uint8], places_m: Mapping[int, Array]
    ) -> None:
        self._window, self._species, self._colours, self._places_m = window, species, colours, places_m
        self._materials: dict[str, Any] = {}
        self._nodes: dict[str, int] = {}  # how often each name is taken
        self.instances: set[int] = set()
        self.scene = trimesh.Scene(metadata={"unit": "m"})
        self.scene.graph.update(frame_to=_ROOT, matrix=_YUP_R_WORLD)

    def add(self, placement: int, number: int, mesh: Mesh) -> None:
        """Hang mesh `number` of a placement below the node of its plant; what is no part of a plant is its own node."""
        window = self._window
        surface = int(window.first_surface[placement]) + number
        row = window.surfaces[surface]
        if row["instance"]:
            self.instances.add(int(row["instance"]))
        which, parent = int(window.shape[placement]), _ROOT
        vertices_m, world_T_shape = mesh.vertices_m, np.eye(4)
        world_T_shape[:3] = window.world_T_shape[placement]
        if row["instance"] and row["part"]:
            place_m = self._places_m.get(int(row["instance"]), window.world_T_shape[placement, :, 3])
            parent = self._instance(row, place_m)
            world_T_shape[:3, 3] -= place_m
            if isinstance(window.shapes[which], TileKey):  # not shared: its origin becomes its node's
                vertices_m = (vertices_m + world_T_shape[:3, 3]).astype(np.float32)
                world_T_shape[:3, 3] = 0.0
        name = f"shape_{which}_{number}"
        if name not in self.scene.geometry:
            faces = mesh.faces
            if faces.shape[1] == 4:  # quads (a, b, c, d) are cut into (a, b, d) and (c, d, b) as casters do
                faces = np.concatenate([faces[:, [0, 1, 3]], faces[:, [2, 3, 1]]])
            look = trimesh.visual.TextureVisuals(material=self._material(row, self._colours[surface]))
            self.scene.geometry[name] = trimesh.Trimesh(vertices_m, faces, visual=look, process=False)
        node = label(row, self._species, with_part=True)
        self._nodes[node] = self._nodes.get(node, 0) + 1
        node += f".{self._nodes[node]}" if self._nodes[node] > 1 else ""
        self.scene.graph.update(node, parent, matrix=world_T_shape, geometry=name, metadata=_extras(row))

    def _instance(self, row: np.void, place_m: Array) -> str:
        name = label(row, self._species, with_part=False)
        if name not in self._nodes:
            self._nodes[name] = 1
            world_T_instance = trimesh.transformations.translation_matrix(place_m)
            extras = {key: value for key, value in _extras(row).items() if key != "part"}
            self.scene.graph.update(name, _ROOT, matrix=world_T_instance, metadata=extras)
        return name

    def _material(self, row: np.void, colour: NDArray[np.uint8]) -> Any:
        """Material of a part of a species, or of what is no plant; one for all that show it."""
        what = PlantPart(row["part"]).name if row["part"] else Semantic(row["semantic"]).name
        name = f"{self._species.get(int(row['species']), '')} {what}".strip().lower()
        if name not in self._materials:
            # Factors of light from sRGB (IEC 61966-2-1), as glTF wants base colours (section 3.9.2).
            share = colour / 255
            linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4).tolist()
            look = {"metallicFactor": 0.0, "roughnessFactor": 1.0, "doubleSided": True}
            self._materials[name] = trimesh.visual.material.PBRMaterial(name, baseColorFactor=[*linear, 1.0], **look)
        return self._materials[name]


def _extras(row: np.void) -> dict[str, int]:
    return {name: int(row[name]) for name in ("semantic", "part", "instance", "species")}
