"""Embree scenes: shapes with their buffers, and instances of them at rest or in motion."""

import math
import threading
import weakref
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from vlp16emu.elementary import matvec
from vlp16emu.errors import RunError
from vlp16emu.kernels.compiler import array_kernel, inline_kernel
from vlp16emu.raycast import embree as rtc
from vlp16emu.raycast.pieces import Faces, faces_of, split_into_pieces
from vlp16emu.types import F4, F8, I8, U4, U8, Mesh, Window


class Shape(NamedTuple):
    """Shape in pieces, ready for Embree."""

    faces: tuple[Faces, ...]  # faces of each mesh, in order of pieces
    begin: I8  # (pieces + 1, meshes) first face of each piece
    boxes_m: F8  # (pieces, 2, 3) around each piece
    radius_m: float  # greatest distance of a corner from the shape's origin


def shape_of(meshes: Sequence[Mesh], *, bends: bool = False) -> Shape:
    """Group the triangles of a shape's meshes into pieces; those of a shape that bends are always low."""
    square_m2 = 0.0
    for x_m, y_m, z_m in (mesh.vertices_m.T for mesh in meshes):
        square_m2 = max(square_m2, float((x_m * x_m + y_m * y_m + z_m * z_m).max(initial=0.0)))
    return Shape(*split_into_pieces([faces_of(mesh) for mesh in meshes], bends=bends), math.sqrt(square_m2))


_WIDER_M = 2.0**-10
"""Margin by which edges are moved outwards for Embree: its rays are off by 1 um at 15 m and 8 um at 100 m,
times 1 / cosine in the plane of a face at grazing incidence. Twice the margin casts 4 % slower in
`scenes/spruce_walk`."""
_SHARPEST = 0.25
"""Least sine of a corner's angle; sharper corners, such as tips of grass blades, move no farther, and their
edges move less there: long needles of margin beyond each tip would cost a tenth of casting."""


class EmbreeMesh:
    """A shape and the committed scenes of its requested pieces.

    Parameters
    ----------
    shape : shape with its faces by mesh; hits give face numbers
    """

    def __init__(self, shape: Shape) -> None:
        self.faces, self._begin, self.boxes_m, self.radius_m = shape
        self.buffers = np.empty((*self._begin[1:].shape, 2), np.uint64)
        """Addresses (pieces, meshes, 2) of corners, and of the first triangle of each piece."""
        for mesh, (vertices_m, triangles) in enumerate(self.faces):
            self.buffers[:, mesh, 0] = vertices_m.ctypes.data
            self.buffers[:, mesh, 1] = triangles.ctypes.data + triangles.strides[0] * self._begin[:-1, mesh]
        self._scenes = dict[int, int]()
        self._building = threading.Lock()

    def scene(self, piece: int) -> int:
        """Return the address of the scene of a piece; build it at the first call.

        Raises RunError if Embree fails.
        """
        with self._building:
            if piece not in self._scenes:
                scene = self._build(self._begin[piece], self._begin[piece + 1])
                rtc.check("build a shape")
                self._scenes[piece] = scene
            return self._scenes[piece]

    def has(self, pieces: set[int]) -> bool:
        """Return whether the scenes of all these pieces are built."""
        return pieces <= self._scenes.keys()

    def _build(self, begin: I8, stop: I8) -> int:
        lib = rtc.library()
        device = rtc.device()
        scene, _ = _new_scene(self)
        # Embree reads these arrays until the scene is committed: only compact scenes refer to them later,
        # others hold corners of their own (Embree 4, `rtcSetSharedGeometryBuffer`).
        in_use = list[NDArray[np.generic]]()
        for number in np.flatnonzero(stop > begin).tolist():
            vertices_m, triangles = self.faces[number]
            wider_m = widen(vertices_m, triangles[begin[number] : stop[number]])
            corners = _corner_numbers(len(wider_m) - 1)
            in_use += [wider_m, corners]
            geometry = lib.rtcNewGeometry(device, rtc.GEOMETRY_TRIANGLE)
            for kind, layout, data, rows in (
                (rtc.BUFFER_VERTEX, rtc.FORMAT_FLOAT3, wider_m, len(wider_m) - 1),
                (rtc.BUFFER_INDEX, rtc.FORMAT_UINT3, corners, len(wider_m) // 3),
            ):
                lib.rtcSetSharedGeometryBuffer(geometry, kind, 0, layout, data.ctypes.data, 0, 12, rows)
            lib.rtcCommitGeometry(geometry)
            lib.rtcAttachGeometryByID(scene, geometry, number)
            lib.rtcReleaseGeometry(geometry)
        lib.rtcCommitScene(scene)
        return scene


_COUNTED = [np.arange(3 << 16, dtype=np.uint32)]


def _corner_numbers(n: int) -> U4:
    """Return 0, 1, 2 ... up to n or more, as corners of separate triangles; one array for all meshes."""
    counted = _COUNTED[0]
    if len(counted) < n:
        counted = _COUNTED[0] = np.arange(max(n, 2 * len(counted)), dtype=np.uint32)
    return counted


@array_kernel
def widen(vertices_m: F4, triangles: U4) -> F4:
    """Widen triangles (t, 3) in their planes: move their edges outwards by `_WIDER_M`.

    Returns
    -------
    Corners (3 t + 1, 3), triangle by triangle; the last is unused, as Embree reads 16 bytes at a vertex of 12
    """
    out = np.zeros((3 * len(triangles) + 1, 3), np.float32)
    edge_m = np.empty((3, 3))
    length_m = np.empty(3)
    for t in range(len(triangles)):
        for k in range(3):  # from corner k to the next
            for axis in range(3):
                from_m = np.float64(vertices_m[triangles[t, k], axis])
                edge_m[k, axis] = np.float64(vertices_m[triangles[t, (k + 1) % 3], axis]) - from_m
            x, y, z = edge_m[k]
            length_m[k] = math.sqrt(x * x + y * y + z * z)
        (ax, ay, az) = edge_m[0]
        (bx, by, bz) = edge_m[1]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        doubled_m2 = math.sqrt(nx * nx + ny * ny + nz * nz)
        for k in range(3):
            after_m, before_m = length_m[k], length_m[k - 1]
            # The corner moves by one over the sine of the angle between both edges, which is this area over
            # their lengths.
            by_m = _WIDER_M / max(doubled_m2, _SHARPEST * after_m * before_m)
            for axis in range(3):
                outwards_m2 = edge_m[k - 1, axis] * after_m - edge_m[k, axis] * before_m
                moved_m = by_m * outwards_m2 if outwards_m2 else 0.0  # without area no ray hits it
                out[3 * t + k, axis] = vertices_m[triangles[t, k], axis] + moved_m
    return out


def relative_to_window(window: Window) -> F8:
    """Return window_T_shape (n, 3, 4): placements relative to the window's origin, in float64."""
    transforms = window.world_T_shape.copy()
    transforms[:, :, 3] -= window.origin_m
    return transforms


def inverses(transforms: F8) -> F8:
    """Invert affine transforms (n, 3, 4) by cofactors, in a fixed order for the same bits everywhere."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z) = transforms.transpose(1, 2, 0)
    rows = (
        (e * i - f * h, c * h - b * i, b * f - c * e),
        (f * g - d * i, a * i - c * g, c * d - a * f),
        (d * h - e * g, b * g - a * h, a * e - b * d),
    )
    determinant = a * rows[0][0] + b * rows[1][0] + c * rows[2][0]
    out = np.empty_like(transforms)
    for k, (p, q, r) in enumerate(rows):
        out[:, k, 0] = p / determinant
        out[:, k, 1] = q / determinant
        out[:, k, 2] = r / determinant
        out[:, k, 3] = -(out[:, k, 0] * x + out[:, k, 1] * y + out[:, k, 2] * z)
    return out


def placed_boxes(world_T_shape: F8, boxes_m: F8) -> tuple[F8, F8]:
    """Return middles and half sizes (n, 3), (n, 3) in the world of boxes (n, 2, 3) of placed shapes."""
    half_m = np.diff(boxes_m, axis=1)[:, 0] / 2
    middle_m = matvec(world_T_shape[..., :3], boxes_m[:, 0] + half_m) + world_T_shape[..., 3]
    return middle_m, matvec(np.abs(world_T_shape[..., :3]), half_m)


def shear_placements(world_T_shape: F8, foot_z_m: F8, shear: F8) -> F8:
    """Shear placements (m, 3, 4) by `shear` (..., m, 2) per metre over a foot (m,): (..., m, 3, 4)."""
    over_foot = world_T_shape[:, 2].copy()
    over_foot[:, 3] -= foot_z_m
    moved = np.broadcast_to(world_T_shape, (*shear.shape[:-1], 3, 4)).copy()
    moved[..., :2, :] += shear[..., None] * over_foot[:, None]
    return moved


def _new_scene(owner: object) -> tuple[int, Callable[[], object]]:
    """Return the address of an empty scene, and a function that releases it before its owner does."""
    lib = rtc.library()
    scene: int = lib.rtcNewScene(rtc.device())
    release = weakref.finalize(owner, lib.rtcReleaseScene, scene)
    release.atexit = False  # the system frees memory faster
    lib.rtcSetSceneFlags(scene, rtc.SCENE_FLAGS)
    return scene, release


class Instances:
    """Pieces of the placements of a window, each a numbered instance.

    Parameters
    ----------
    window, meshes : window, and a mesh for each placement
    workers : threads that build pieces in parallel

    Raises RunError if a window lasts too long for Embree.
    """

    def __init__(self, window: Window, meshes: Sequence[EmbreeMesh], workers: Executor) -> None:
        self.window = window
        self.meshes = meshes
        self._workers = workers
        counts = np.array([len(mesh.boxes_m) for mesh in meshes], np.int64)
        self.placement = np.repeat(np.arange(len(meshes)), counts)  # (n,) placement of each piece
        self.boxes_m = np.concatenate([np.zeros((0, 2, 3)), *(mesh.boxes_m for mesh in meshes)])
        """Boxes (n, 2, 3) of pieces, in coordinates of the shape."""
        self.motion = motion_of(window, self.placement, self.boxes_m)
        self.buffers, self.row = _buffers(meshes, counts)
        """Buffers (b, 2) as in `EmbreeMesh`, and the first row (n,) of each piece."""
        self._piece = np.arange(len(self.placement)) - np.repeat(np.cumsum(counts) - counts, counts)
        """Number (n,) of each piece in its mesh."""

    def scene(self, kept: NDArray[np.bool_]) -> int:
        """Build the scene of selected pieces (n,) and return its address, valid for the life of this object.

        Raises RunError if Embree fails.
        """
        wanted = defaultdict[EmbreeMesh, set[int]](set)
        numbers = np.flatnonzero(kept)
        placed = self.placement[numbers].tolist()
        meshes = [self.meshes[at] for at in placed]
        pieces = self._piece[numbers].tolist()
        for mesh, piece in zip(meshes, pieces, strict=True):
            wanted[mesh].add(piece)
        new = [mesh for mesh, of_mesh in wanted.items() if not mesh.has(of_mesh)]
        list(self._workers.map(lambda mesh: [mesh.scene(piece) for piece in sorted(wanted[mesh])], new))
        scenes = np.array([mesh.scene(piece) for mesh, piece in zip(meshes, pieces, strict=True)], np.uint64)
        scene, release = _new_scene(self)
        transforms = relative_to_window(self.window).astype(np.float32)
        _attach(
            scene, rtc.device(), numbers, scenes, self.placement[numbers], transforms, *self._moving(numbers)
        )
        rtc.library().rtcCommitScene(scene)
        try:
            rtc.check("build the window")
        except RunError:
            release()
            raise
        return scene

    def _moving(self, numbers: I8) -> tuple[I8, F4]:
        """Return where pieces (n,) stand among those that move, -1 at rest, and what moves (m, k, 3, 4).

        The latter is window_T_shape of each moving piece at all knots.
        """
        motion = self.motion
        moves = (motion.shear[:, numbers] != 0.0).any(axis=(0, 2))
        row = np.where(moves, np.cumsum(moves) - 1, -1)
        moving = numbers[moves]
        if not len(moving):
            return row, np.empty((0, 0, 3, 4), np.float32)
        still = relative_to_window(self.window)[self.placement[moving]]
        shear = motion.shear[:, moving].astype(np.float64)
        moved = shear_placements(still, motion.foot_m[moving], shear)
        return row, np.ascontiguousarray(moved.swapaxes(0, 1), np.float32)


def _buffers(meshes: Sequence[EmbreeMesh], counts: I8) -> tuple[U8, I8]:
    """Concatenate buffers of the distinct meshes; return them and the first row of each piece."""
    first = dict[int, int]()
    tables = [np.zeros((0, 2), np.uint64)]
    stop = 0
    for mesh in meshes:
        if id(mesh) not in first:
            first[id(mesh)] = stop
            tables.append(mesh.buffers.reshape(-1, 2))
            stop += len(tables[-1])
    begin = np.array([first[id(mesh)] for mesh in meshes], np.int64)
    meshes_each = np.array([mesh.buffers.shape[1] for mesh in meshes], np.int64)
    piece = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.concatenate(tables), np.repeat(begin, counts) + piece * np.repeat(meshes_each, counts)


_MOST_KNOTS = 129  # RTC_MAX_TIME_STEP_COUNT (Embree 4, rtcore_common.h)

rtc.library()  # kernels of this and the casting modules link with it
_set_count = types.ExternalFunction("rtcSetGeometryTimeStepCount", types.void(types.uintp, types.uint32))
_set_transform = types.ExternalFunction(
    "rtcSetGeometryTransform", types.void(types.uintp, types.uint32, types.int32, types.uintp)
)
_new_geometry = types.ExternalFunction("rtcNewGeometry", types.uintp(types.uintp, types.int32))
_set_scene = types.ExternalFunction("rtcSetGeometryInstancedScene", types.void(types.uintp, types.uintp))
_commit = types.ExternalFunction("rtcCommitGeometry", types.void(types.uintp))
_attach_by_number = types.ExternalFunction(
    "rtcAttachGeometryByID", types.void(types.uintp, types.uintp, types.uint32)
)
_release = types.ExternalFunction("rtcReleaseGeometry", types.void(types.uintp))


class InstanceMotion(NamedTuple):
    """Motion of the instances of a scene: each is sheared by its height over a foot."""

    start_ns: int  # UTC of the first knot
    span_ns: int  # time from the first knot to the last; 0 if nothing moves
    shear: F4  # (k, n, 2) metres towards x and y per metre over the foot; no knots if nothing moves
    foot_m: F8  # (n,) height in the window at which an instance does not move; empty if nothing moves

    def times(self, t_ns: I8) -> F4:
        """Return ray times 0..1 at UTC instants of any shape, clipped to the span."""
        if not self.span_ns:
            return np.zeros(t_ns.shape, np.float32)
        return np.clip((t_ns - self.start_ns) / self.span_ns, 0.0, 1.0).astype(np.float32)


_LEAST_M = 1e-3  # height that a flat piece is given for its chord


def motion_of(window: Window, placement: I8, boxes_m: F8) -> InstanceMotion:
    """Return the motion of pieces (n,) with boxes (n, 2, 3) in the coordinates of their placements.

    A piece moves as the chord of its placement's curve over the height of its box: a shear about the height
    at which the chord meets the axis at rest. The chord is off by up to the curvature times the square of the
    height over 8, and pieces that touch part by twice that: slabs of a crown by some 3 mm per metre of the
    top's movement.

    Raises RunError if a window lasts too long for Embree.
    """
    n = len(placement)
    if (sway := window.sway) is None:
        return InstanceMotion(0, 0, np.empty((0, n, 2), np.float32), np.empty(0))
    knots = len(sway.top_m)
    if knots > _MOST_KNOTS:
        raise RunError(f"wind: found {knots} knots in a window, Embree takes {_MOST_KNOTS}")
    row_of = np.full(len(window.shape), -1)
    row_of[sway.placement] = np.arange(len(sway.placement))
    row = row_of[placement]
    moves = np.flatnonzero(row >= 0)
    row = row[moves]
    middle_m, half_m = placed_boxes(window.world_T_shape[placement[moves]], boxes_m[moves])
    half_z_m = np.maximum(half_m[:, 2], _LEAST_M / 2)
    low_m = middle_m[:, 2] - half_z_m
    low_share = sway.shares(row, low_m)
    slope = (sway.shares(row, middle_m[:, 2] + half_z_m) - low_share) / (2.0 * half_z_m)
    shear = np.zeros((knots, n, 2), np.float32)
    shear[:, moves] = sway.top_m[:, row] * slope[:, None]
    foot_m = np.zeros(n)
    over_m = np.divide(low_share, slope, out=np.zeros(len(row)), where=slope > 0)
    foot_m[moves] = low_m - over_m - window.origin_m[2]
    return InstanceMotion(sway.start_ns, sway.step_ns * (knots - 1), shear, foot_m)


@array_kernel
def _attach(
    scene: int, device: int, numbers: I8, scenes: U8, placement: I8, transforms: F4, row: I8, steps: F4
) -> None:
    """Attach instances of scenes (n,) to a scene by their numbers; from Python each takes five times as long.

    Parameters
    ----------
    placement, transforms : row (n,) of each instance at rest in the transforms (p, 3, 4)
    row, steps : as from `Instances._moving`
    """
    for at in range(len(numbers)):
        geometry = _new_geometry(device, rtc.GEOMETRY_INSTANCE)
        _set_scene(geometry, scenes[at])
        if row[at] < 0:
            own = transforms[placement[at]]
            _set_transform(geometry, 0, rtc.FORMAT_FLOAT3X4_ROW_MAJOR, own.ctypes.data)
        else:
            _set_count(geometry, steps.shape[1])
            for knot in range(steps.shape[1]):
                own = steps[row[at], knot]
                _set_transform(geometry, knot, rtc.FORMAT_FLOAT3X4_ROW_MAJOR, own.ctypes.data)
        _commit(geometry)
        _attach_by_number(scene, geometry, numbers[at])
        _release(geometry)


@inline_kernel
def knot_at(knots: int | np.int64, time: float) -> tuple[int | np.int64, float]:
    """Return the knot before a ray time 0..1, and the fraction from it to the next knot."""
    at = np.float64(time) * (knots - 1)
    knot = min(int(at), knots - 2)
    return knot, at - knot
