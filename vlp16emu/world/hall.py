"""A hall of known shapes, for checks of distances to a tenth of a millimetre."""

import logging
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import acos, cos, log, sin, tan
from vlp16emu.errors import GeometryError
from vlp16emu.rotation import rotation
from vlp16emu.settings import Section
from vlp16emu.types import F8, SURFACE, Mesh, Semantic, ShapeKey, Window, World
from vlp16emu.world.settings import Hall, HallBox, HallPole, HallSphere
from vlp16emu.world.vectors import closed_body

_log = logging.getLogger(__name__)
Thing = HallBox | HallPole | HallSphere
_TOLERANCE_M = 5e-5
"""Largest gap between a chord and its arc. Round things deviate by about half of it to either side of the
true shape; on a sphere the gaps of both angles add up to at most twice that."""
_FEWEST_SIDES = 256
_SHAPES_KEPT = 16  # of all halls of a process: a ball takes 4 ms, and tests make many emulators
_WALL_INSTANCE = 1  # walls and ceiling; things follow from 2 in the given order: boxes, poles, spheres


@dataclass(frozen=True, slots=True)
class _Room:
    """Key of the hall itself: centred on the origin, floor at z = 0."""

    size_m: tuple[float, float, float]


class HallWorld:
    """A closed room with things in it; a `World` that is always wholly in reach, and its own `Site`.

    Raises GeometryError for a thing that is not completely inside.
    """

    materials = ("room", "box", "pole", "sphere")  # names by `SURFACE` material number
    near_m = math.inf  # fields of `World`: all near, nothing random or kept
    seed = 0
    name = "flat"  # fields of `Site`
    origin_m = (0.0, 0.0, 0.0)
    obstacles = None

    def __init__(self, section: Hall, _seed: int = 0) -> None:
        self._section = section
        room = _Room((section.length_m, section.width_m, section.height_m))
        boxes = section.boxes
        poles = section.poles
        spheres = section.spheres
        things: list[Thing] = [*boxes, *poles, *spheres]
        for thing in things:
            _check_inside(thing, room)
        self.size_m = room.size_m  # along x, y and z; centred on x = y = 0, floor at z = 0
        self._keys = (room, *things)
        self._things = things
        self.names = {_WALL_INSTANCE: "walls", **{i + 2: thing.name for i, thing in enumerate(things)}}
        surfaces = np.zeros(2 + len(things), SURFACE)
        surfaces["reflectance"] = [section.wall_reflectance] * 2 + [thing.brightness for thing in things]
        surfaces["texture"] = [section.texture] * 2 + [thing.texture for thing in things]
        surfaces["roughness"] = [section.wall_roughness or 0.0] * 2 + [
            thing.roughness or 0.0 for thing in things
        ]
        surfaces["shading"] = [section.shading] * 2 + [thing.shading for thing in things]
        surfaces["relief_m"] = [section.relief_m] * 2 + [thing.relief_m for thing in things]
        surfaces["material"] = [0, 0, *[1] * len(boxes), *[2] * len(poles), *[3] * len(spheres)]
        surfaces["semantic"] = Semantic.OTHER
        surfaces["semantic"][0] = Semantic.GROUND
        surfaces["instance"] = np.arange(len(surfaces))  # floor 0, walls and ceiling 1, things from 2
        self._surfaces = surfaces

    def world(
        self,
        path_xy_m: F8,
        *,
        reach_m: float,
        farthest_m: float,  # noqa: ARG002  # all of it is near
        wind: Section | None,  # noqa: ARG002  # nothing in it moves
        start_ns: int,  # noqa: ARG002
    ) -> tuple[World, None]:
        """Return the hall; parameters and errors as in `Site`."""
        self.check(path_xy_m)
        return self._section.with_meshes(self, path_xy_m, reach_m), None

    def has_ground(self, xy_m: F8, _reach_m: float = 0.0) -> NDArray[np.bool_]:
        """Return a mask of points (n, 2) inside the walls."""
        return np.asarray((np.abs(xy_m) < np.array(self.size_m[:2]) / 2).all(axis=1))

    def check(self, path_xy_m: F8) -> None:
        """Warn if a path (n, 2) leads through a wall: nothing is visible from outside."""
        half_m = np.array(self.size_m[:2]) / 2
        outside = ~self.has_ground(path_xy_m)
        if outside.any():
            x_m, y_m = path_xy_m[int(outside.argmax())]
            _log.warning(
                "hall: the path of the sensor leaves it at (%g, %g) m; "
                "expected x between -%g and %g m, y between -%g and %g m",
                *(x_m, y_m, half_m[0], half_m[0], half_m[1], half_m[1]),
            )

    def shape_name(self, _key: ShapeKey) -> str:
        """Return an empty name: a hall is not kept on disk."""
        return ""

    def height_m(self, x_m: F8, y_m: F8) -> F8:
        """Height of the floor: 0 everywhere."""
        return np.zeros(np.broadcast_shapes(np.shape(x_m), np.shape(y_m)))

    def window(self, track_m: F8) -> Window:
        """Return the whole hall for any track (n, 3)."""
        n = len(self._keys)
        world_T_shape = np.zeros((n, 3, 4))
        places_m = [thing.foot_m if isinstance(thing, HallPole) else thing.centre_m for thing in self._things]
        world_T_shape[:, :, :3] = [np.eye(3), *map(_turn, self._things)]
        world_T_shape[:, :, 3] = [(0.0, 0.0, self.size_m[2] / 2), *places_m]
        first = np.concatenate([[0], 2 + np.arange(n - 1)]).astype(np.uint32)
        placed = self._keys, np.arange(n, dtype=np.int32), world_T_shape, first
        # Whole metres near the sensor, exact in float32.
        return Window(np.round(track_m.mean(axis=0)), *placed, self._surfaces)

    def shape(self, key: ShapeKey) -> tuple[Mesh, ...]:
        """Meshes of the room (floor, then walls with ceiling) or of a thing, about its centre or foot."""
        return _shape(key)


@lru_cache(maxsize=_SHAPES_KEPT)
def _shape(key: ShapeKey) -> tuple[Mesh, ...]:
    """Make the meshes of a room or of a thing, which the key describes whole."""
    match key:
        case _Room(size):
            box = _box_quads(size)
            return Mesh(box.vertices_m, box.faces[:1, ::-1]), Mesh(box.vertices_m, box.faces[1:, ::-1])
        case HallBox(size_m=size):
            return (_box_quads(size),)
        case HallPole():
            return (_pole(key),)
        case HallSphere():
            return (_sphere(key.diameter_m / 2),)
    raise KeyError(key)


def _turn(thing: Thing) -> F8:
    """Return the rotation (3, 3) of a thing from its own axes."""
    return np.eye(3) if isinstance(thing, HallSphere) else rotation(*thing.angles_deg)


def _extent(thing: Thing) -> tuple[F8, F8]:
    """Return the middle (3,) of a thing and half of its extent along the axes of the hall (3,)."""
    turn = _turn(thing)
    match thing:
        case HallPole(diameter_m=diameter_m, height_m=height_m, foot_m=foot_m):
            axis = turn[:, 2]
            across = np.sqrt(np.maximum(1.0 - axis * axis, 0.0))  # of its ends, which are discs
            half = np.abs(axis) * (height_m / 2) + across * (diameter_m / 2)
            return np.asarray(foot_m) + axis * (height_m / 2), half
        case HallBox(size_m=size_m):
            half = (np.abs(turn) * (np.asarray(size_m) / 2)).sum(axis=1)
            return np.asarray(thing.centre_m), half
    return np.asarray(thing.centre_m), np.full(3, thing.diameter_m / 2)


def _check_inside(thing: Thing, room: _Room) -> None:
    middle, half = _extent(thing)
    length_m, width_m, height_m = room.size_m
    spans = ((-length_m / 2, length_m / 2), (-width_m / 2, width_m / 2), (0.0, height_m))
    for axis, (low, high), at, size in zip("xyz", spans, middle, half, strict=True):
        if not (low <= at - size and at + size <= high):
            found = f"spans {at - size:g} to {at + size:g} m in {axis}"
            raise GeometryError(f"hall: {thing.name}", found, f"inside {low:g} to {high:g} m")


def _box_quads(size_m: tuple[float, float, float]) -> Mesh:
    """Make a box about its centre; the bottom is the first face."""
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
    return Mesh((corners * size_m).astype(np.float32), np.array(faces, dtype=np.uint32))


def _sides(radius_m: float) -> int:
    """Sides of a polygon whose chords are within the tolerance; even, so that it can be halved."""
    needed = math.pi / acos(1 - min(_TOLERANCE_M / radius_m, 1.0))
    return max(_FEWEST_SIDES, 2 * math.ceil(needed / 2))


def _pole(pole: HallPole) -> Mesh:
    """Make a closed cylinder about its foot.

    The mean radius of its polygon over azimuth is half the diameter.
    """
    sides = _sides(pole.diameter_m / 2)
    half = math.pi / sides
    # Mean of cos(half) / cos(azimuth) over one side is cos(half) * ln(tan(pi/4 + half/2)) / half.
    corner_m = pole.diameter_m / 2 * half / (cos(half) * log(tan(math.pi / 4 + half / 2)))
    angle = 2 * half * np.arange(sides)
    ring = np.column_stack([corner_m * cos(angle), corner_m * sin(angle), np.zeros(sides)])
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, pole.height_m]])
    return closed_body(ring + ends[:, None], ends)


def _sphere(radius_m: float) -> Mesh:
    """Make a ball of meridians and parallels about its centre.

    Half of it is inside and half outside the true surface.
    """
    sides = _sides(radius_m)
    half = math.pi / sides
    # The centre of a face near the equator is below its corners by cos(half) in either angle.
    corner_m = radius_m * 2 / (1 + cos(half) * cos(half))
    latitude = np.pi * (np.arange(1, sides // 2) / (sides // 2) - 0.5)
    longitude = 2 * half * np.arange(sides)
    flat = cos(latitude)[:, None]
    z = np.broadcast_to(sin(latitude)[:, None], (len(latitude), sides))
    rings = np.stack([flat * cos(longitude), flat * sin(longitude), z], axis=-1)
    return closed_body(corner_m * rings, corner_m * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
