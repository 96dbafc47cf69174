"""The slow twin of the caster: all of a window as triangles in float64, rays one after the other."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from vlp16emu.elementary import matvec
from vlp16emu.extras.displace import displace
from vlp16emu.raycast.adaptive import enough
from vlp16emu.raycast.beam import LINE, ROUND, beam_axis_of, draw_pattern, fill_sub_rays, pulse_axes
from vlp16emu.raycast.build import relative_to_window, shear_placements
from vlp16emu.raycast.pieces import faces_of
from vlp16emu.types import NO_SURFACE, Hits


def frozen(window, t_ns):
    """Still window that a moving one is at a time, or at its first or last where that is outside; its
    placements move along straight lines."""
    if (sway := window.sway) is None:
        return window
    assert sway.curve.shape[1] == 2
    top_m = top_at_m(sway, t_ns)
    transforms = window.world_T_shape.copy()
    shear = top_m / sway.height_m[:, None]
    transforms[sway.placement] = shear_placements(transforms[sway.placement], sway.foot_z_m, shear)
    return replace(window, world_T_shape=transforms, sway=None)


def top_at_m(sway, t_ns):
    """Movement (m, 2) of the tops at a time, or at the first or last knot where that is outside."""
    steps = len(sway.top_m) - 1
    at = min(max((t_ns - sway.start_ns) / sway.step_ns, 0.0), float(steps))
    knot = min(int(at), steps - 1)
    return sway.top_m[knot] + (at - knot) * (sway.top_m[knot + 1] - sway.top_m[knot])


def flatten(window, shape):
    """Triangles (t, 3, 3) float64 in metres from the window's origin, and their surfaces (t,) uint32."""
    transforms = relative_to_window(window)
    meshes = [shape(key) for key in window.shapes]
    corners, surfaces = [np.empty((0, 3, 3))], [np.empty(0, np.uint32)]
    for transform, which, first in zip(transforms, window.shape, window.first_surface, strict=True):
        for number, mesh in enumerate(meshes[which]):
            vertices_m = matvec(transform[:, :3], mesh.vertices_m.astype(np.float64)) + transform[:, 3]
            _, triangles = faces_of(mesh)
            corners.append(vertices_m[triangles])
            surfaces.append(np.full(len(triangles), first + number, np.uint32))
    return np.concatenate(corners), np.concatenate(surfaces)


def sub_rays(firings, beam, from_m, first, count):
    """Origins in metres from `from_m` (3,) and directions (k, L, count, 3) of sub-rays from `first` on, as
    the kernel lays them."""
    pulses = firings.origin_m, firings.direction, beam_axis_of(firings, beam), from_m
    rays = np.empty((*firings.t_ns.shape, -(-count // ROUND), 6, ROUND), np.float32)
    axes, laid = np.empty((4, 3), np.float32), np.empty((7, ROUND), np.float32)
    sigmas, adaptive = beam.sigmas.astype(np.float32), beam.budget.adaptive
    for i, j in np.ndindex(firings.t_ns.shape):
        pulse_axes(*pulses, i, j, axes)
        u, v = draw_pattern(beam.seed, firings.index + i, j)
        for number in range(rays.shape[2]):
            fill_sub_rays(laid.reshape(-1), axes, sigmas, u, v, first + ROUND * number, adaptive)
            rays[i, j, number, :3], rays[i, j, number, 3:] = laid[:3], laid[4:]
    rays = rays.swapaxes(3, 4).reshape(*firings.t_ns.shape, -1, 6)[:, :, :count]
    return np.ascontiguousarray(rays[..., :3]), np.ascontiguousarray(rays[..., 3:])


class ReferenceScene:
    """A window as one soup of triangles, (t, 3, 3) float64; a new one for each instant where something
    moves."""

    def __init__(self, window, shape):
        self._origin_m, self.surfaces = window.origin_m, window.surfaces
        self._moves = window.sway is not None
        self._at = lru_cache(1)(lambda t_ns: flatten(frozen(window, t_ns), shape))

    def cast(self, firings, near_m, far_m, beam=LINE):
        """Cast pulses; the arguments are those of `EmbreeGeometry.cast`."""
        shape = firings.t_ns.shape
        near = np.broadcast_to(near_m, shape)

        def cast(rays, each):
            return self._rays(*rays, np.repeat(near, each), far_m, np.repeat(firings.t_ns, each))

        if beam.budget.adaptive:
            return self._by_rounds(cast, firings, beam)
        if beam.has_width:
            each = beam.budget.max_rays
            return Hits(np.full(shape, each, np.uint16), *cast(self._sub_rays(firings, beam, 0, each), each))
        lines = (firings.origin_m - self._origin_m).reshape(-1, 3), firings.direction.reshape(-1, 3)
        met = cast(lines, 1)
        range_m, surface, cosine = met[0].reshape(shape), met[1].reshape(shape), met[2].reshape(shape)
        if beam.section.model == "offset":
            displace(range_m, beam, firings.index)
        return Hits.one_ray_each(range_m, surface, cosine)

    def _sub_rays(self, firings, beam, first, count):
        origin_m, direction = sub_rays(firings, beam, self._origin_m, first, count)
        return origin_m.reshape(-1, 3).astype(np.float64), direction.reshape(-1, 3).astype(np.float64)

    def _by_rounds(self, cast, firings, beam):
        """Cast rounds of all pulses, and keep those that each pulse wants."""
        shape, reflectance = firings.t_ns.shape, np.ascontiguousarray(self.surfaces["reflectance"])
        met = []
        wants, count = np.ones(shape, np.bool_), np.zeros(shape, np.uint16)
        for first in range(0, beam.rays, ROUND):
            each = min(ROUND, beam.rays - first)
            fresh = cast(self._sub_rays(firings, beam, first, each), each)
            met.append(tuple(array.reshape(*shape, each) for array in fresh))
            count[wants] += each
            so_far = [np.concatenate([part[n] for part in met], axis=-1) for n in range(3)]
            for pulse in np.argwhere(wants).tolist():
                range_m, surface, cosine = (array[pulse[0], pulse[1]] for array in so_far)
                of_rays = np.where(surface == NO_SURFACE, 0.0, reflectance[surface % len(reflectance)])
                energy = of_rays * cosine / np.maximum(np.square(range_m), np.float32(1e-12))
                wants[tuple(pulse)] = not enough(range_m, energy, beam.budget, np.empty((2, first + each)))
            if not wants.any():
                break
        kept = np.arange(so_far[0].shape[-1]) < count[..., None]
        return Hits(count, *(array[kept] for array in so_far))

    def _rays(self, origin_m, direction, near, far_m, t_ns):
        """Cast rays (n, 3) from origins relative to the window's."""
        n = len(origin_m)
        range_m, cos_incidence = np.full(n, np.inf, np.float32), np.zeros(n, np.float32)
        surface = np.full(n, NO_SURFACE, np.uint32)
        for i in range(n):
            triangles_m, surfaces = self._at(int(t_ns[i]) if self._moves else 0)
            t_m = ranges_m(triangles_m, origin_m[i], direction[i])
            t_m[(t_m < near[i]) | (t_m > far_m)] = np.inf
            nearest = int(np.argmin(t_m)) if len(t_m) else -1
            if nearest >= 0 and np.isfinite(t_m[nearest]):
                a, b, c = triangles_m[nearest]
                normal = np.cross(b - a, c - a)
                cos_incidence[i] = abs(normal @ direction[i]) / np.linalg.norm(normal)
                range_m[i], surface[i] = t_m[nearest], surfaces[nearest]
        return range_m, surface, cos_incidence


def ranges_m(triangles_m, origin_m, direction):
    """Distance along one ray to every triangle, inf where missed (Moeller and Trumbore, 1997)."""
    a, b, c = triangles_m[:, 0], triangles_m[:, 1], triangles_m[:, 2]
    ab, ac, to_ray = b - a, c - a, origin_m - a
    p = np.cross(direction, ac)
    determinant = np.einsum("ij,ij->i", ab, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", to_ray, p) / determinant
        q = np.cross(to_ray, ab)
        v = q @ direction / determinant
        t_m = np.einsum("ij,ij->i", ac, q) / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (determinant != 0)
    return np.where(inside, t_m, np.inf)
