"""What `tools/peers` casts: pulses of a sector of a walk, and all triangles that they can reach."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vlp16emu import Emulator
from vlp16emu.engine.windows import BLOCK, window_of
from vlp16emu.raycast.beam import LINE, Footprint, beam_axis_of, draw_pattern, fill_sub_rays, pulse_axes
from vlp16emu.raycast.build import relative_to_window
from vlp16emu.raycast.pieces import faces_of
from vlp16emu.scenario import load
from vlp16emu.types import Firings, Window, World

FROM_DEG = 60.0  # beside the path, which is kept free of trees
MARGIN_M = 1.0  # more than the sensor moves in these revolutions
TOGETHER = 8  # sequences, and revolutions, that the program casts at once
ORDER_DEG = 1.6  # sectors by which it orders these revolutions


class View(NamedTuple):
    """A sector of the beginning of a walk."""

    scene: str
    reach_m: float
    sector_deg: float


def first_pulses(view: View, *, all_faces: bool) -> tuple[Emulator, Firings]:
    """Return an emulator, and the pulses of its first revolutions in a sector from azimuth `FROM_DEG` on."""
    settings = [f"sensor.max_range_m={view.reach_m}", "beam.model=fixed", "beam.rays=8"]
    if all_faces and load(view.scene).world.kind != "hall":  # a hall has no medium
        settings.append("world.near_m=inf")
    emulator = Emulator(view.scene, settings, threads=1)
    unit = emulator.parts.units[0]
    firings = unit.head.aim(0, TOGETHER * BLOCK, unit.motion.poses_at, beam_axis=True)
    azimuth_deg = ((firings.azimuth_deg[:, 0] - FROM_DEG) % 360).reshape(-1, TOGETHER)
    inside = np.flatnonzero(azimuth_deg.max(axis=1) < view.sector_deg)
    groups = inside[np.argsort((azimuth_deg[inside, 0] / ORDER_DEG).astype(int), kind="stable")]
    rows = (TOGETHER * groups[:, None] + np.arange(TOGETHER)).reshape(-1)
    names = "t_ns", "clock_ns", "azimuth_deg", "reading_deg", "origin_m", "direction", "beam_axis"
    return emulator, replace(firings, **{name: getattr(firings, name)[rows] for name in names})


def triangles(world: World, window: Window, firings: Firings, view: View) -> dict[str, np.ndarray]:
    """Return the triangles of all placements that the pulses can reach, in axes of the window."""
    eye_m = firings.origin_m[0, 0] - window.origin_m
    ahead = firings.direction[:, :, :2].reshape(-1, 2).mean(axis=0)
    half_rad = np.radians(view.sector_deg / 2)

    def is_met(from_m: np.ndarray, size_m: np.ndarray) -> np.ndarray:
        """Return whether balls with middles (n, 3) from the eye and radii (n,) can be met."""
        range_m = np.linalg.norm(from_m, axis=1) - size_m - MARGIN_M
        across_rad = np.arctan2(ahead[0] * from_m[:, 1] - ahead[1] * from_m[:, 0], from_m[:, :2] @ ahead)
        level_m = np.hypot(from_m[:, 0], from_m[:, 1])
        wide_m = size_m + MARGIN_M
        sine = (wide_m / level_m.clip(1e-6)).clip(max=1)
        wide_rad = np.where(level_m > wide_m, np.arcsin(sine), np.pi)
        return (range_m < view.reach_m) & (np.abs(across_rad) - wide_rad < half_rad)

    shapes = [[faces_of(mesh) for mesh in world.shape(key)] for key in window.shapes]
    radii_m = [max(float(np.linalg.norm(v, axis=1).max(initial=0.0)) for v, _ in shape) for shape in shapes]
    transforms = relative_to_window(window)
    stretch = np.linalg.norm(transforms[:, :, :3], axis=1).max(axis=1)
    near = is_met(transforms[:, :, 3] - eye_m, stretch * np.array(radii_m)[window.shape])
    vertices, faces, count = [], [], 0
    for transform, which in zip(transforms[near], window.shape[near], strict=True):
        for corners_m, triangle in shapes[which]:
            place_m = corners_m.astype(np.float64) @ transform[:, :3].T + transform[:, 3]
            middle_m = place_m[triangle].mean(axis=1)
            size_m = np.linalg.norm(place_m[triangle] - middle_m[:, None], axis=2).max(axis=1)
            kept = triangle[is_met(middle_m - eye_m, size_m)]
            used, own = np.unique(kept, return_inverse=True)
            vertices.append(place_m[used].astype(np.float32))
            faces.append((own.reshape(-1, 3) + count).astype(np.uint32))
            count += len(used)
    return {"vertices_m": np.concatenate(vertices), "faces": np.concatenate(faces)}


def rays_of(firings: Firings, beam: Footprint, from_m: np.ndarray) -> np.ndarray:
    """Return origins and directions of rays (n, 6), in the order and with the sub-rays of the program."""
    if beam is LINE:
        lines = np.concatenate([firings.origin_m - from_m, firings.direction], axis=-1)
        groups = lines.reshape(-1, TOGETHER, lines.shape[1], 6).transpose(0, 2, 1, 3)
        return groups.reshape(-1, 6).astype(np.float32)
    axes, sub_rays = np.empty((4, 3), np.float32), np.empty((7, 8), np.float32)
    rays, sigmas = np.empty((firings.t_ns.size, 8, 6), np.float32), beam.sigmas.astype(np.float32)
    for number, (i, j) in enumerate(np.ndindex(firings.t_ns.shape)):
        pulse_axes(firings.origin_m, firings.direction, beam_axis_of(firings, beam), from_m, i, j, axes)
        fill_sub_rays(
            sub_rays.reshape(-1), axes, sigmas, *draw_pattern(beam.seed, firings.index + i, j), 0, False
        )
        rays[number, :, :3], rays[number, :, 3:] = sub_rays[:3].T, sub_rays[4:].T
    return rays.reshape(-1, 6)


def write_task(view: View, path: Path) -> int:
    """Write triangles and rays for the other casters; return the number of triangles."""
    emulator, firings = first_pulses(view, all_faces=True)
    window = window_of(emulator.parts, emulator.scenario.start_ns, emulator.engine.batching, 0)
    arrays = triangles(emulator.parts.world, window, firings, view)
    beams = {"1": LINE, "8": emulator.parts.units[0].beam}
    sets = {f"rays_{name}": rays_of(firings, beam, window.origin_m) for name, beam in beams.items()}
    np.savez(path, reach_m=view.reach_m, **arrays, **sets)
    return len(arrays["faces"])
