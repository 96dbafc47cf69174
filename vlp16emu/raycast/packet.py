"""The Embree packet: eight rays that are cast together, and their hits.

Embree finds candidates, and `_decide` selects the hit and its range. Embree's rounding depends on the
instruction set: with another one the same ray hits a leaf at its edge or misses it, or hits the other of two
intersecting faces. So Embree has slightly wider triangles (`build.widen`), candidates are kept up to
`_SLACK_M` behind the nearest, and each is decided in float64, by sums, products and one division, from the
original corners. Of two at the same range the one with the lower number is hit. So neither Embree's
arithmetic nor the order of candidates matters.

Kernels without new arrays count no references (`_nrt=False`), and loops take arrays out of tuples first.
"""

import math
from typing import NamedTuple

import llvmlite.ir
import numpy as np
from numba import types

from vlp16emu.elementary import sin
from vlp16emu.kernels.compiler import NumbaObject, inline_kernel, kernel, numba
from vlp16emu.raycast.build import knot_at
from vlp16emu.raycast.embree import FLAG_COHERENT, FLAG_FILTER
from vlp16emu.types import F4, F8, I4, I8, U4, U8, AnyArray

PACKET = 8  # rays per packet; 16 is slower without AVX-512

LEVEL = np.float32(sin(math.radians(20.0)))
"""Greatest slope of a level ray: includes all rays of a VLP-16 that is carried upright, with a lean of up to
3 degrees. Half of the near faces of `scenes/reference_forest` are met by no level ray, and are not built."""

_intersect = types.ExternalFunction(
    "rtcIntersect8", types.void(types.uintp, types.uintp, types.uintp, types.uintp)
)

ORG, _TNEAR, DIR, TIME, _TFAR, _MASK, _ID, _FLAGS, _SIZE = (
    PACKET * row for row in (0, 3, 4, 7, 8, 9, 10, 11, 21)
)
"""Offsets of the rows of RTCRayHit8, each of eight 4-byte words (rtcore_ray.h)."""
_HIT_PRIMITIVE = 5  # rows of the RTCHitN of a candidate
_HIT_MESH = 6
_HIT_INSTANCE = 7
_ALIGN = 64
NONE = np.uint32(0xFFFFFFFF)
_NO_INSTANCES = np.uint64(0xFFFFFFFFFFFFFFFF)

_SLACK_M = 2.0**-6
"""Slack of Embree's ranges: they are off by micrometres, times 1 / sine at grazing incidence; ten times this
costs no more."""

# Offsets of rows of `RayPacket.state`: range of the hit, or the limit; the normal there in coordinates of the
# shape, and its product with the direction.
_LIMIT, _NORMAL, _FACING, _STATE = (PACKET * row for row in (0, 1, 4, 5))


class Target(NamedTuple):
    """Faces that rays are cast against."""

    scene: int  # address of a committed RTCScene of instances that level rays may meet; 0 for none
    steep: int  # address of the scene for rays that are not `LEVEL`; 0 also if no such ray is cast
    window_origin_m: F8  # (3,) subtracted from the origins in float64, before conversion to float32
    first_surface: U4  # (n,) per instance, as in `Window`
    shape_T_window: F8  # (n, 3, 4) per instance, at rest
    row: I8  # (n,) per instance: first row of `buffers` of its piece
    buffers: U8  # (b, 2) addresses of the corners of a mesh, and of its triangles in a piece
    shear: F4  # (knots, n, 2) per instance, as in `build.InstanceMotion`
    foot_m: F8  # (n,) per instance, as in `build.InstanceMotion`
    reflectance: F4  # (m,) of the surfaces


class RayPacket(NamedTuple):
    """A thread's own packet."""

    rays: F4
    """Rows of eight (168,): loops over lanes read and write at constant offsets, so that the compiler
    vectorizes them."""
    valid: I4
    context: U8
    arguments: U8
    world_rays: F4
    """First rows of `rays` (64,), with the least range: Embree transforms its rays into instances and
    back."""
    state: F8  # (40,) likewise
    instance: U4  # (8,) instance that a ray hits, or `NONE`
    face: U8  # (8,) face of it: mesh number in the upper half, triangle number in the lower
    desk: U8  # (11,) addresses for `_decide`


_Vector = tuple[float, float, float]
_Corners = tuple[_Vector, _Vector, _Vector]
_DTYPES = ["f4", "i4", "u8", "u8", "f4", "f8", "u4", "u8", "u8"]


def _pointer(kind: NumbaObject) -> NumbaObject:
    """Make a function that converts an address to a pointer to numbers of a type."""

    @numba.extending.intrinsic
    def pointer(typingctx: NumbaObject, address: NumbaObject) -> NumbaObject:

        def codegen(
            context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
        ) -> NumbaObject:
            return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.uint64), codegen

    return pointer


_as_float32 = _pointer(types.float32)
_as_float64 = _pointer(types.float64)
_as_int32 = _pointer(types.int32)
_as_int64 = _pointer(types.int64)
_as_uint32 = _pointer(types.uint32)
_as_uint64 = _pointer(types.uint64)


@inline_kernel
def _minus(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inline_kernel
def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline_kernel
def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inline_kernel
def _vector(numbers: AnyArray, at: int | np.int64, step: int) -> _Vector:
    return np.float64(numbers[at]), np.float64(numbers[at + step]), np.float64(numbers[at + 2 * step])


@inline_kernel
def _corners(desk: U8, instance: np.int64, face: np.uint64) -> _Corners:
    row = 2 * (_as_int64(desk[5])[instance] + np.int64(face >> np.uint64(32)))
    buffers = _as_uint64(desk[6])
    triangle = 3 * np.int64(face & np.uint64(NONE))
    vertices = _as_float32(buffers[row])
    corners = _as_uint32(buffers[row + 1])
    a, b, c = 3 * corners[triangle], 3 * corners[triangle + 1], 3 * corners[triangle + 2]
    return _vector(vertices, a, 1), _vector(vertices, b, 1), _vector(vertices, c, 1)


@inline_kernel
def _ray_in_shape(desk: U8, world_rays: F8, r: np.int64, instance: np.int64) -> tuple[_Vector, _Vector]:
    """Return origin and direction of ray r in the coordinates of an instance's shape."""
    (x, y, z) = _vector(world_rays, r, PACKET)
    (dx, dy, dz) = _vector(world_rays, DIR + r, PACKET)
    knots = np.int64(desk[9])
    if knots:
        shear = _as_float32(desk[8])
        n = np.int64(desk[10])
        knot, share = knot_at(knots, world_rays[TIME + r])
        before = 2 * (knot * n + instance)
        after = 2 * ((knot + 1) * n + instance)
        lean_x = shear[before] + share * (shear[after] - shear[before])
        lean_y = shear[before + 1] + share * (shear[after + 1] - shear[before + 1])
        over_m = z - _as_float64(desk[7])[instance]
        x = x - lean_x * over_m
        y = y - lean_y * over_m
        dx = dx - lean_x * dz
        dy = dy - lean_y * dz
    at = 12 * instance
    T = _as_float64(desk[4])
    row_x = _vector(T, at, 1)
    row_y = _vector(T, at + 4, 1)
    row_z = _vector(T, at + 8, 1)
    from_m = (x, y, z)
    along = (dx, dy, dz)
    origin_m = (
        _dot(row_x, from_m) + T[at + 3],
        _dot(row_y, from_m) + T[at + 7],
        _dot(row_z, from_m) + T[at + 11],
    )
    return origin_m, (_dot(row_x, along), _dot(row_y, along), _dot(row_z, along))


@inline_kernel
def _meet_triangle(
    corners: _Corners, normal: _Vector, ray: tuple[_Vector, _Vector]
) -> tuple[float, float, bool]:
    """Intersect a ray with a triangle; return range, normal times direction, and True for a hit.

    The three determinants of the direction and two corners then have the same sign. For two triangles with a
    common edge the edge's determinants differ only in sign, so no ray passes between them.
    """
    origin_m, along = ray
    a, b, c = _minus(corners[0], origin_m), _minus(corners[1], origin_m), _minus(corners[2], origin_m)
    of_a, of_b, of_c = _dot(_cross(b, c), along), _dot(_cross(c, a), along), _dot(_cross(a, b), along)
    facing = _dot(normal, along)
    range_m = _dot(a, normal) / facing
    return range_m, facing, (min(of_a, of_b, of_c) >= 0.0) | (max(of_a, of_b, of_c) <= 0.0)


@kernel
def _decide(arguments: int) -> None:
    """Accept or reject a candidate hit: Embree's filter, given its RTCFilterFunctionNArguments."""
    words = _as_uint64(arguments)
    valid = _as_int32(words[0])
    desk = _as_uint64(_as_uint64(words[2])[1])
    n = np.int64(words[5] & np.uint64(NONE))
    far_m = _as_float32(words[3])
    numbers = _as_uint32(words[3])
    hit = _as_uint32(words[4])
    world_rays = _as_float32(desk[0])
    state = _as_float64(desk[1])
    instances = _as_uint32(desk[2])
    faces = _as_uint64(desk[3])
    last = NONE
    last_face = np.uint64(0)
    normal = (0.0, 0.0, 0.0)
    corners = normal, normal, normal
    for i in range(n):
        if not valid[i]:
            continue
        r = np.int64(numbers[_ID // PACKET * n + i])
        instance = hit[_HIT_INSTANCE * n + i]
        face = np.uint64(hit[_HIT_MESH * n + i]) << np.uint64(32) | np.uint64(hit[_HIT_PRIMITIVE * n + i])
        if instance != last or face != last_face:  # usually the same for all rays
            last = instance
            last_face = face
            corners = _corners(desk, np.int64(instance), face)
            normal = _cross(_minus(corners[1], corners[0]), _minus(corners[2], corners[0]))
        range_m, facing, is_inside = _meet_triangle(
            corners, normal, _ray_in_shape(desk, world_rays, r, np.int64(instance))
        )
        limit_m = state[_LIMIT + r]
        is_first = instance < instances[r] or (instance == instances[r] and face < faces[r])
        is_nearer = range_m < limit_m or (range_m == limit_m and is_first)
        if is_inside and is_nearer and world_rays[_TNEAR + r] <= range_m:
            instances[r] = instance
            faces[r] = face
            state[_LIMIT + r] = range_m
            state[_FACING + r] = facing
            for axis in range(3):
                state[_NORMAL + PACKET * axis + r] = normal[axis]
            far_m[_TFAR // PACKET * n + i] = np.float32(range_m + _SLACK_M)
        else:
            valid[i] = 0


@numba.extending.intrinsic
def _filter(typingctx: NumbaObject) -> NumbaObject:
    """Return the address of `_decide` as a C function, compiled into the calling kernel."""
    kind = types.Dispatcher(_decide)
    decision = kind.get_call_type(typingctx, (types.uint64,), {})

    def codegen(
        context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
    ) -> NumbaObject:
        word = llvmlite.ir.IntType(64)
        kinds = llvmlite.ir.FunctionType(llvmlite.ir.VoidType(), [word])
        function = llvmlite.ir.Function(builder.module, kinds, f"{builder.function.name}.filter")
        function.linkage = "internal"
        inside = llvmlite.ir.IRBuilder(function.append_basic_block())
        dispatcher: NumbaObject = _decide
        compiled = dispatcher.overloads[decision.args]
        context.add_linking_libs([compiled.library])
        context.call_internal_no_propagate(inside, compiled.fndesc, decision, function.args)
        inside.ret_void()
        return builder.ptrtoint(function, word)

    return types.uint64(), codegen


def ray_packet() -> RayPacket:
    """Make an empty packet.

    RTCIntersectArguments: flags and feature mask (all), then pointers to context and filter. Each thread
    needs its own context: a shared one loses hits on instances silently. RTCRayQueryContext is two words of 4
    bytes; behind them is the address of our desk.
    """
    sizes = (4 * _SIZE, 4 * PACKET, 64, 64, 32 * PACKET, 8 * _STATE, 4 * PACKET, 8 * PACKET, 8 * 11)
    first = np.cumsum([0, *(-(-size // _ALIGN) * _ALIGN for size in sizes)])
    raw = np.zeros(first[-1] + _ALIGN, np.uint8)
    raw = raw[-raw.ctypes.data % _ALIGN :]
    parts = [raw[at : at + size] for at, size in zip(first[:-1].tolist(), sizes, strict=True)]
    packet = RayPacket(*(part.view(dtype) for part, dtype in zip(parts, _DTYPES, strict=True)))
    packet.context[1] = packet.desk.ctypes.data
    packet.arguments[0] = FLAG_COHERENT | FLAG_FILTER | int(NONE) << 32
    packet.arguments[1] = packet.context.ctypes.data
    packet.desk[:4] = [part.ctypes.data for part in packet[4:8]]
    words = packet.rays.view(np.uint32)
    words[_MASK : _MASK + PACKET] = NONE
    words[_ID : _ID + PACKET] = np.arange(PACKET)
    return packet


@inline_kernel
def set_filter(packet: RayPacket) -> None:
    """Set this kernel's `_decide` as the filter of a packet."""
    packet.arguments[2] = _filter()


@inline_kernel
def cast_packet(target: Target, packet: RayPacket, near_m: float, far_m: float) -> None:
    """Cast the valid rays of a packet between two ranges; if one is steep, all are cast as steep."""
    rays = packet.rays
    world_rays = packet.world_rays
    valid = packet.valid
    desk = packet.desk
    state = packet.state
    instance = packet.instance
    rise = np.float32(0.0)
    for lane in range(PACKET):
        rise = max(rise, abs(rays[DIR + 2 * PACKET + lane]))
    for at in range(8 * PACKET):
        world_rays[at] = rays[at]
    first_m, last_m = np.float32(max(near_m - _SLACK_M, 0.0)), np.float32(far_m + _SLACK_M)
    for lane in range(PACKET):
        world_rays[_TNEAR + lane] = near_m
        rays[_TNEAR + lane] = first_m
        rays[_TFAR + lane] = last_m
        state[_LIMIT + lane] = far_m if valid[lane] else state[_LIMIT + lane]
        instance[lane] = NONE if valid[lane] else instance[lane]
    scene = target.scene if rise <= LEVEL else target.steep
    if not scene:
        return
    desk[4] = target.shape_T_window.ctypes.data
    desk[5] = target.row.ctypes.data
    desk[6] = target.buffers.ctypes.data
    desk[7] = target.foot_m.ctypes.data
    desk[8] = target.shear.ctypes.data
    desk[9] = target.shear.shape[0]
    desk[10] = target.shear.shape[1]
    packet.context[0] = _NO_INSTANCES
    _intersect(valid.ctypes.data, scene, rays.ctypes.data, packet.arguments.ctypes.data)


@inline_kernel
def hit_of(target: Target, packet: RayPacket, r: int) -> tuple[np.float32, np.uint32, np.float32]:
    """Return range, surface and cosine of incidence of the hit of ray r.

    The normal in the window is the shape's normal times the transpose of `shape_T_window`; a horizontal shear
    changes its vertical component only. Its product with the direction is the same in both frames.
    """
    instance = packet.instance[r]
    state = packet.state
    T = target.shape_T_window
    surface = np.uint32(target.first_surface[instance] + np.uint32(packet.face[r] >> np.uint64(32)))
    nx, ny, nz = state[_NORMAL + r], state[_NORMAL + PACKET + r], state[_NORMAL + 2 * PACKET + r]
    x = T[instance, 0, 0] * nx + T[instance, 1, 0] * ny + T[instance, 2, 0] * nz
    y = T[instance, 0, 1] * nx + T[instance, 1, 1] * ny + T[instance, 2, 1] * nz
    z = T[instance, 0, 2] * nx + T[instance, 1, 2] * ny + T[instance, 2, 2] * nz
    if target.shear.shape[0]:
        knot, share = knot_at(target.shear.shape[0], packet.world_rays[TIME + r])
        before = target.shear[knot, instance]
        after = target.shear[knot + 1, instance]
        lean_x = before[0] + share * (after[0] - before[0])
        lean_y = before[1] + share * (after[1] - before[1])
        z -= lean_x * x + lean_y * y
    cosine = abs(state[_FACING + r]) / math.sqrt(x * x + y * y + z * z)
    return np.float32(state[_LIMIT + r]), surface, np.float32(min(cosine, 1.0))
