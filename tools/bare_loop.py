"""The least that casts: rays loaded and handed to Embree, which is what all casting is measured by."""
# ruff: noqa: SLF001  # it reaches under the caster

import numba
import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast import LINE, Footprint, Scene
from vlp16emu.raycast import embree_kernel as kernel
from vlp16emu.raycast.embree_task import Target
from vlp16emu.raycast.footprint import sub_rays
from vlp16emu.types import Firings

__all__ = ["bare", "bare_met", "in_order", "packets"]

NONE = np.uint32(0xFFFFFFFF)


@numba.njit(nogil=True)
def bare(
    scene: int,
    rays: NDArray[np.float32],
    near_m: NDArray[np.float64],
    far_m: float,
    range_m: NDArray[np.float32],
) -> None:
    """Load packets (n, 6, 8) with near limits (n,) and call Embree, and nothing else."""
    packet = _full_packet()
    for p in range(rays.shape[0]):
        _send(packet, scene, rays, p, near_m[p], far_m)
        for lane in range(8):
            range_m[p, lane] = packet.rays[8, lane] if packet.words[19, lane] != NONE else np.inf


@numba.njit(nogil=True)
def bare_met(
    target: Target,
    rays: NDArray[np.float32],
    near_m: NDArray[np.float64],
    far_m: float,
    hits: kernel._Hits,
) -> None:
    """Do the same, and tell all that a return is made of, (n, 8) each: range, what was met, and under which angle."""
    packet = _full_packet()
    lanes, words = packet.rays, packet.words
    # Reaching into a tuple within a loop would count references at every step.
    first_surface, normal_matrix, shear = target.first_surface, target.normal_matrix, target.shear
    range_m, surface, cos_incidence = hits.range_m, hits.surface, hits.cos_incidence
    for p in range(rays.shape[0]):
        _send(packet, target.scene, rays, p, near_m[p], far_m)
        for lane in range(8):
            instance = words[19, lane]
            if instance == NONE:
                range_m[p, lane], surface[p, lane], cos_incidence[p, lane] = np.inf, NONE, 0.0
            else:
                range_m[p, lane] = lanes[8, lane]
                surface[p, lane] = first_surface[instance] + words[18, lane]
                cos_incidence[p, lane] = kernel._cosine(normal_matrix, shear, instance, lanes, lane)


@numba.njit(nogil=True)
def _full_packet() -> kernel._Packet:
    """Make a packet of eight rays."""
    packet = kernel._packet()
    packet.valid[:] = -1
    return packet


@numba.njit(nogil=True, _nrt=False)
def _send(
    packet: kernel._Packet, scene: int, rays: NDArray[np.float32], p: int, near_m: float, far_m: float
) -> None:
    """Load packet p, and call Embree."""
    for lane in range(8):
        kernel._reset(packet.rays, packet.words, lane, near_m, far_m, 0.0)
        for a in range(3):
            packet.rays[a, lane], packet.rays[4 + a, lane] = rays[p, a, lane], rays[p, 3 + a, lane]
    packet.context[:] = NONE
    kernel._intersect(packet.valid.ctypes.data, scene, packet.rays.ctypes.data, packet.arguments.ctypes.data)


def packets(opened: Scene, firings: Firings, beam: Footprint) -> NDArray[np.float32]:
    """Rays of a block, ready to load and in the order in which the chain casts them, (n, 6, 8)."""
    shape = firings.t_ns.shape
    if beam is LINE:
        origin_m, direction = firings.origin_m, firings.direction
    else:
        none = np.zeros(shape, np.int64)
        origin_m, direction = sub_rays(firings, beam, none, none + beam.rays)
    six = (
        np.concatenate([origin_m - opened._target.window_origin_m, direction], axis=-1)
        .astype(np.float32)
        .reshape(-1, 6)
    )
    return np.ascontiguousarray(in_order(six, shape[1], beam.rays).transpose(0, 2, 1))


def in_order(rays: NDArray[np.float32], lasers: int, per_pulse: int) -> NDArray[np.float32]:
    """From the order of pulses (n, c) to that of casting (n / 8, 8, c): laser by laser in eight sequences."""
    eights = rays.reshape(-1, 8, lasers, per_pulse, rays.shape[-1])
    return eights.transpose(0, 2, 1, 3, 4).reshape(-1, 8, rays.shape[-1])
