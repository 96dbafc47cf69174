"""Small worlds, single pulses and perfect units for the cases."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from vlp16emu.engine import Unit, assemble
from vlp16emu.packets import LASERS
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.raycast.caster import Geometry, caster
from vlp16emu.raycast.settings import Beam
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import load
from vlp16emu.sensor.beams import LENS_RADIUS_M
from vlp16emu.types import F8, SURFACE, Firings, Hits, Mesh, Returns, Window

PULSES = 24 * LASERS  # of a packet of single return: pulses come in multiples of it
_WORKERS = ThreadPoolExecutor(2)


def unit_of(scene: str, *settings: str) -> Unit:
    """First sensor of a scene."""
    return assemble(load(scene, settings)).units[0]


def beam(model: str, rays: int = 64, *, has_width: bool = True) -> Footprint:
    """Light of a VLP-16, or light without width."""
    light = Footprint(Beam(model=model), seed=7, resolution_m=1.0).with_settings(
        rays=rays
    )  # fewer, too, than a scene may have
    return light if has_width else light.with_settings(spot_mm=(0.0, 0.0), divergence_mrad=(0.0, 0.0))


def faces(corners_m: F8) -> Mesh:
    """Return a mesh of quads (n, 4, 3) or triangles (n, 3, 3)."""
    numbers = np.arange(corners_m.shape[0] * corners_m.shape[1], dtype=np.uint32).reshape(corners_m.shape[:2])
    return Mesh(corners_m.reshape(-1, 3).astype(np.float32), numbers)


def wall(x_m: float, half_m: float = 50.0) -> Mesh:
    """Upright square across the x axis."""
    corners = [(x_m, -half_m, -half_m), (x_m, half_m, -half_m), (x_m, half_m, half_m), (x_m, -half_m, half_m)]
    return faces(np.array([corners]))


def open_scene(meshes: Sequence[Mesh], *, reflectance: float = 0.5, times: int = 1) -> Geometry:
    """Scene of one shape whose meshes are surfaces of their own, about the origin.

    Parameters
    ----------
    times : how many instances stand there
    """
    surfaces = np.zeros(len(meshes), SURFACE)
    surfaces["reflectance"] = reflectance
    window = Window(
        origin_m=np.zeros(3),
        shapes=("things",),
        shape=np.zeros(times, np.int32),
        world_T_shape=np.repeat(np.eye(3, 4)[None], times, axis=0),
        first_surface=np.zeros(times, np.uint32),
        surfaces=surfaces,
    )
    world = SimpleNamespace(
        shape=lambda _key: tuple(meshes), shape_name=lambda _key: "", near_m=math.inf, far_tile=None, seed=0
    )
    return caster(world, _WORKERS).open(window)


def pulses(origin_m: F8, direction: F8, *, lasers: int = LASERS) -> Firings:
    """Pulses (n, 3) as firing sequences, n a multiple of 8 a laser, or to be packed of `PULSES`.

    The level axis of their light is across z.
    """
    across = np.cross(direction, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1)[:, None]
    of = [np.reshape(array, (-1, lasers, 3)).astype(np.float64) for array in (origin_m, direction, across)]
    return replace(Firings.rays(0, of[0], of[1]), beam_axis=of[2])


def cast(scene: Geometry, firings: Firings, light: Footprint = LINE) -> Hits:
    """Cast to beyond the largest code."""
    return scene.cast(firings, np.full(firings.t_ns.shape[1], LENS_RADIUS_M), 140.0, light)


def detect_pulses(scene: Geometry, firings: Firings, light: Footprint = LINE) -> Returns:
    """Detect pulses by a sensor without errors that sees as far as the largest code."""
    detector = unit_of("static_bench", "sensor.max_range_m=131.07").detector
    return detect(firings, cast(scene, firings, light), scene.surfaces, detector, truth=False)
