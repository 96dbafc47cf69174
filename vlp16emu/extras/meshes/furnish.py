"""A world with the user's own meshes in it."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import cos, matvec, sin
from vlp16emu.errors import GeometryError
from vlp16emu.extras.meshes.files import UserMesh, load_mesh
from vlp16emu.extras.meshes.settings import MeshFile, MeshPlace
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.settings import Section
from vlp16emu.types import (
    F8,
    FIRST_FREE_INSTANCE,
    SURFACE,
    HeightField,
    Mesh,
    PlantPart,
    Semantic,
    ShapeKey,
    Window,
    World,
)

_log = logging.getLogger(__name__)


def surfaces_of(section: MeshFile, mesh: UserMesh) -> NDArray[np.void]:
    """Return `SURFACE` (parts,) of a mesh, with material and instance 0.

    Raises GeometryError for a part that it does not have.
    """
    names = [name for name, _ in mesh.parts]
    settings_of = {part.name: part for part in section.parts}
    for name in settings_of.keys() - set(names):
        raise GeometryError(f"{mesh.path}: parts", f"found {name!r}", f"one of {', '.join(names)}")
    surfaces = np.zeros(len(names), SURFACE)
    for row, part in zip(surfaces, (settings_of.get(name, section) for name in names), strict=True):
        brightness = part.brightness
        row["reflectance"] = section.brightness if brightness is None else brightness
        row["roughness"] = part.roughness or section.roughness or 0.0
        row["semantic"] = Semantic[(part.semantic or section.semantic).upper()]
        row["part"] = PlantPart[(part.part or section.part).upper()]
    return surfaces


@dataclass(frozen=True, slots=True)
class MeshKey:
    """Name of a mesh's shape."""

    number: int  # index among the user's meshes
    path: Path


@runtime_checkable
class BareWorld(World, Protocol):
    """A world without the user's meshes."""

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of materials by `SURFACE` material number."""

    @property
    def height_m(self) -> HeightField:
        """Height of the ground."""


class Furnished:
    """A world with the user's meshes in it; a `World`.

    Raises GeometryError for more objects than there are instance numbers, and for a part that a mesh does not
    have.

    Parameters
    ----------
    world : world without the meshes
    meshes : settings and contents of each mesh file, in the order of their numbers
    reach_m : how far the sensor sees
    """

    def __init__(
        self, world: BareWorld, *, meshes: Sequence[tuple[MeshFile, UserMesh]], reach_m: float
    ) -> None:
        self.bare = world  # the world without the user's things
        self.height_m = world.height_m
        self.near_m = world.near_m
        self.seed = world.seed
        for name in ("name", "far_tile", "core", "reaches"):  # a hall has no far tiles, and no end
            if hasattr(world, name):
                setattr(self, name, getattr(world, name))
        self._reach_m = reach_m
        self.names = dict[int, str]()  # names of the user's objects by instance
        self._mesh_of = dict[MeshKey, UserMesh]()
        self._keys = list[MeshKey]()
        materials = list(world.materials)
        placed = []
        radius_m = []
        self._rows = []
        for section, mesh in meshes:
            key = MeshKey(len(self._mesh_of), mesh.path)
            surfaces = surfaces_of(section, mesh)
            self._mesh_of[key] = mesh
            labels = [f"{mesh.path.name} {name}" for name, _ in mesh.parts]
            things = [mesh.path.name] if section.one_thing else labels
            count = len(self.names) + len(section.places) * len(things)
            if count > 2**32 - FIRST_FREE_INSTANCE:
                raise GeometryError("meshes", f"found {count} things", "at most 65536")
            for place in section.places:
                first = FIRST_FREE_INSTANCE + len(self.names)
                rows = surfaces.copy()
                rows["material"] = len(materials) + np.arange(len(rows))
                rows["instance"] = first + np.arange(len(things))  # one number for each part, or one for all
                where = f"at ({place.x_m:g}, {place.y_m:g}) m"
                self.names |= {first + i: f"{thing} {where}" for i, thing in enumerate(things)}
                self._keys.append(key)
                self._rows.append(rows)
                placed.append(_world_T_mesh(place, mesh, world.height_m))
                radius_m.append(place.scale * mesh.radius_m)
            materials += labels
        self.materials = tuple(materials)
        self._world_T_mesh = np.reshape(placed, (-1, 3, 4))
        self._radius_m = np.array(radius_m)

    def check(self, path_xy_m: F8) -> None:
        """Warn of each mesh that is out of sight along the whole path (n, 2)."""
        gap_m = (
            distance_m(self._world_T_mesh[:, :2, 3], path_xy_m) - self._radius_m
            if self._keys
            else np.zeros(0)
        )
        for key in self._mesh_of:
            nearest_m = min(
                gap for gap, mesh_key in zip(gap_m.tolist(), self._keys, strict=True) if mesh_key == key
            )
            if nearest_m > self._reach_m:
                _log.warning(
                    "%s: not in sight, %.1f m from the path at the nearest;"
                    " expected a place %g m from it at most"
                    " (map coordinates must have origin_m taken off)",
                    *(key.path, nearest_m, self._reach_m),
                )

    def window(self, track_m: F8) -> Window:
        """Return the world and the user's meshes within reach of sensor positions (n, 3)."""
        window = self.bare.window(track_m)
        gap_m = distance_m(self._world_T_mesh[:, :2, 3], track_m[:, :2]) - self._radius_m
        near = np.flatnonzero(gap_m <= self._reach_m)
        if not len(near):
            return window
        keys = list(dict.fromkeys(self._keys[i] for i in near))
        first = len(window.surfaces) + np.cumsum([0, *(len(self._rows[i]) for i in near[:-1])])
        return replace(
            window,
            shapes=(*window.shapes, *keys),
            shape=np.append(
                window.shape, [len(window.shapes) + keys.index(self._keys[i]) for i in near]
            ).astype(np.int32),
            world_T_shape=np.concatenate([window.world_T_shape, self._world_T_mesh[near]]),
            first_surface=np.append(window.first_surface, first).astype(np.uint32),
            surfaces=np.concatenate([window.surfaces, *(self._rows[i] for i in near)]),
            **window.with_more(len(near)),
        )

    def shape_name(self, key: ShapeKey) -> str:
        """Return the store name of a shape of the world; the user's meshes are not stored."""
        return "" if isinstance(key, MeshKey) else self.bare.shape_name(key)

    def shape(self, key: ShapeKey) -> tuple[Mesh, ...]:
        """Return the meshes of a shape: one for each part of a user's file, or the meshes from the world."""
        if isinstance(key, MeshKey):
            return tuple(mesh for _, mesh in self._mesh_of[key].parts)
        return self.bare.shape(key)


def _world_T_mesh(place: MeshPlace, mesh: UserMesh, height_m: HeightField) -> F8:
    z_m = place.z_m
    if z_m is None:
        z_m = place.above_ground_m + float(height_m(np.array([place.x_m]), np.array([place.y_m]))[0])
    yaw = math.radians(place.yaw_deg)
    c = place.scale * cos(yaw)
    s = place.scale * sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, place.scale]])
    origin = np.array([place.x_m, place.y_m, z_m])
    return np.column_stack([turn, origin + matvec(turn, mesh.centre_m)])


def furnish(bare: World, files: Sequence[Section], path_xy_m: F8, reach_m: float) -> World:
    """Put the user's own meshes into a world, and warn of those that are out of sight along a path (n, 2).

    Raises GeometryError if a mesh cannot be read, or another package's world has no place for meshes.
    """
    if not isinstance(bare, BareWorld):
        expected = "a world with `materials` and `height_m`"
        raise GeometryError("world.meshes", f"found a world of the class {type(bare).__name__}", expected)
    sections = [section for section in files if isinstance(section, MeshFile)]
    meshes = [(one, load_mesh(Path(one.file), unit=one.unit, up=one.up)) for one in sections]
    world = Furnished(bare, meshes=meshes, reach_m=reach_m)
    world.check(path_xy_m)
    return world
