"""Our casting beside that of others: the same triangles and the same rays, each caster in a process of its own.

`tools/bench --peers` is the command. Speeds are millions of whole pulses per second, of one ray and of eight, with one
thread of its processor time and with two of the wall clock, the best of the repeats: where other programs run, the latter
may be the less. Memory and time of building are those beyond the geometry that a caster is given: ours gets shapes and
where they stand, the others every placement written out, cut to what rays can reach. Ours is there as in a run, with faces
near by and a medium beyond, with all as faces, and with the same triangles as the others. That all of them hit alike is
asserted, but for the medium, which is alike in the mean only.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from peer_casters import SETS, THREADS, Prepare, Work, measure
from rich.box import MARKDOWN
from rich.table import Table

from vlp16emu.emulator import Emulator
from vlp16emu.engine.windows import BLOCK
from vlp16emu.foliage.tiles import FarTile
from vlp16emu.forest.stand.nearby import AllNear
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.raycast.caster import caster
from vlp16emu.raycast.faces import faces_of, relative_to_window
from vlp16emu.scenario import load
from vlp16emu.types import Firings, Mesh, Semantic, ShapeKey, Window, World

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from raycast.reference import sub_rays

PACKAGES = {"Open3D": "open3d-cpu==0.20.0", "Mitsuba": "mitsuba==3.9.1", "PyHelios": "pyhelios3d==0.1.38"}
OURS = ("ours", "ours, all faces", "ours, written out")
NEED_KB = {OURS[2]: 0.3, "Open3D": 0.2, "Mitsuba": 0.3, "PyHelios": 2.5}
"""Memory of a triangle that is written out: its input and what is made of it, as measured."""
BLOCKS = 2
MARGIN_M = 1.5
"""More than the sensor moves meanwhile."""
REACHES_M = (15.0, 30.0, 60.0, 100.0)
MEASURED = ("build, CPU s", "memory, MB", *(f"{rays}, {n}" for rays in SETS for n in THREADS))
TASK = "task.npz"
ALIKE, ALIKE_M = 0.001, 0.01
"""How far hit shares and mean ranges may be apart."""


@dataclass(frozen=True, slots=True)
class View:
    """A stretch of the walk with all that is within reach."""

    world: World
    window: Window
    shapes: Mapping[ShapeKey, tuple[Mesh, ...]]
    firings: list[Firings]
    near_m: NDArray[np.float64]
    far_m: float
    beams: Mapping[str, Footprint]
    """By the name of the set of rays: of one ray, and of eight."""
    raster: Firings

    @property
    def trees(self) -> int:
        """Trees and saplings within reach."""
        surfaces = self.window.surfaces
        return len(np.unique(surfaces["instance"][surfaces["semantic"] == Semantic.TREE]))

    @property
    def triangles(self) -> int:
        """Triangles of the shapes."""
        return int(self._of_shapes().sum())

    @property
    def triangles_written_out(self) -> int:
        """Triangles of all placements."""
        return int(self._of_shapes()[self.window.shape].sum())

    def _of_shapes(self) -> NDArray[np.int64]:
        shapes = (self.shapes[key] for key in self.window.shapes)
        return np.array([sum(len(faces_of(mesh)[1]) for mesh in meshes) for meshes in shapes])

    def blocks(self, name: str) -> tuple[Footprint, list[Firings]]:
        """Pulses of a set of rays, and how wide they are."""
        return (LINE, [self.raster]) if name == "raster" else (self.beams[name], self.firings)


def view(scene: str, reach_m: float) -> View:
    """Look at a scene from the beginning of its walk."""
    emulator = Emulator(load(scene, [f"sensor.max_range_m={reach_m}", "beam.model=adaptive"]), threads=1)
    unit, world = emulator.parts.units[0], emulator.parts.world
    firings = [unit.head.aim(n * BLOCK, BLOCK, unit.motion.poses_at, beam_axis=True) for n in range(BLOCKS)]
    window = world.window(unit.motion.poses_at(firings[0].t_ns[:1, 0]).world_p_body_m)
    shapes = {key: world.shape(key) for key in window.shapes}
    beams = {"one": LINE, "eight": unit.beam.changed(rays=8)}
    return View(world, window, shapes, firings, unit.head.beams.near_m, reach_m, beams, raster(firings[0]))


def written_out(seen: View) -> Mesh:
    """Every placement as triangles in the window's axes, without what is beyond reach."""
    middle_m = seen.firings[0].origin_m[0, 0] - seen.window.origin_m
    vertices, faces, count = [], [], 0
    for transform, which in zip(relative_to_window(seen.window), seen.window.shape, strict=True):
        for mesh in seen.shapes[seen.window.shapes[which]]:
            places_m = mesh.vertices_m.astype(np.float64) @ transform[:, :3].T + transform[:, 3]
            near = np.linalg.norm(places_m - middle_m, axis=1) < seen.far_m + MARGIN_M
            _, kept = faces_of(mesh)
            kept = kept[near[kept].any(axis=1)]
            used, own = np.unique(kept, return_inverse=True)
            vertices.append(places_m[used].astype(np.float32))
            faces.append((own.reshape(-1, 3) + count).astype(np.uint32))
            count += len(used)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def raster(firings: Firings) -> Firings:
    """Lay PyHelios' raster of 16 rows over 30 degrees: column by column, turning on within each."""
    columns, rows = firings.t_ns.shape
    elevation = np.radians(np.linspace(15.0, -15.0, rows))
    azimuth = np.arange(columns * rows).reshape(columns, rows) * (2 * np.pi / (rows * (columns - 1)))
    level = np.cos(elevation)
    up = np.broadcast_to(np.sin(elevation), azimuth.shape)
    direction = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), up], axis=-1)
    origin_m = np.broadcast_to(firings.origin_m[0, 0], direction.shape).copy()
    return replace(firings, origin_m=origin_m, direction=direction)


@dataclass(frozen=True, slots=True)
class Grown:
    """A world whose shapes are there already."""

    seen: View

    @property
    def near_m(self) -> float:
        """Range beyond which is the medium."""
        return self.seen.world.near_m

    @property
    def seed(self) -> int:
        """Of the world."""
        return self.seen.world.seed

    @property
    def name(self) -> str:
        """None: nothing of it is kept on disk."""
        return ""

    def shape_name(self, _key: ShapeKey) -> str:
        """None, likewise."""
        return ""

    def window(self, track_m: NDArray[np.float64]) -> Window:
        """Give what stands there."""
        return self.seen.world.window(track_m)

    def far_tile(self, ix: int, iy: int) -> FarTile:
        """Describe a tile."""
        return self.seen.world.far_tile(ix, iy)

    def shape(self, key: ShapeKey) -> tuple[Mesh, ...]:
        """Give a shape; those that are farther than the window's are grown."""
        there = self.seen.shapes.get(key)
        return self.seen.world.shape(key) if there is None else there


def one_mesh(seen: View, mesh: Mesh) -> World:
    """Put all into one shape that stands at the window's origin."""
    place = np.concatenate([np.eye(3), seen.window.origin_m[:, None]], axis=1)[None]
    none = np.zeros(1, np.int32)
    window = Window(
        origin_m=seen.window.origin_m,
        shapes=("all",),
        shape=none,
        world_T_shape=place,
        first_surface=none.astype(np.uint32),
        surfaces=seen.window.surfaces,
    )
    return AllNear(window, lambda _key: (mesh,))


def ours(seen: View, world: World, _task: object) -> Prepare:
    """Cast as the chain does."""
    with ThreadPoolExecutor(1) as builder:
        window = world.inside if isinstance(world, AllNear) else seen.window
        scene = caster(world, builder).open(window)

    def prepare(name: str, threads: int) -> Work:
        (beam, blocks), workers = seen.blocks(name), ThreadPoolExecutor(threads)

        def block(firings: Firings) -> NDArray[np.float32]:
            return scene.cast(firings, seen.near_m, seen.far_m, beam).range_m

        pulses = sum(firings.t_ns.size for firings in blocks)
        return Work(lambda: list(workers.map(block, blocks)), np.concatenate, pulses)

    return prepare


def own_row(scene: str, reach_m: float, name: str, task: Path) -> dict[str, Any]:
    """Measure one of ours; in a process of its own, so that memory is its own."""
    with np.load(task) as file:
        given = dict(file)
    seen = view(scene, reach_m)
    worlds: dict[str, Callable[[], World]] = {
        OURS[0]: lambda: Grown(seen),
        OURS[1]: lambda: AllNear(seen.window, seen.shapes.__getitem__),
        OURS[2]: lambda: one_mesh(seen, Mesh(given["vertices_m"], given["faces"])),
    }
    return measure(partial(ours, seen, worlds[name]()), given)


def install(venv: Path) -> dict[str, str]:
    """Make the virtual environment where there is none; report why something does not install."""
    python, why = venv / "bin" / "python", {}
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
        for name, package in PACKAGES.items():
            command = [str(python), "-m", "pip", "install", "-qq", "numpy", package]
            done = subprocess.run(command, check=False, capture_output=True, text=True)
            if done.returncode:
                why[name] = last_line(done.stderr)
    return why


def last_line(text: str) -> str:
    """Give what a program said last."""
    return (text.strip().splitlines() or ["no word"])[-1]


def child(command: list[str], out: Path) -> dict[str, Any] | str:
    """Run a caster: what it measured, or why there is nothing."""
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    return last_line(done.stderr) if done.returncode else json.loads(out.read_text())


def free_kb() -> float:
    """Memory that is to be had."""
    lines = Path("/proc/meminfo").read_text().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("MemAvailable")))


def rows(
    scene: str, reach_m: float, venv: Path, folder: Path, triangles: int
) -> Iterator[tuple[str, dict[str, Any] | str]]:
    """Measure one caster after the other."""
    task, out, here = folder / TASK, folder / "out.json", Path(__file__)
    why: dict[str, str] = {}
    for name in (*OURS, *PACKAGES):
        need_kb = NEED_KB.get(name, 0.0) * triangles
        command = [sys.executable, str(here), scene, str(reach_m)]
        if name in PACKAGES:
            why = why or install(venv)
            command = [str(venv / "bin" / "python"), str(here.with_name("peer_casters.py"))]
        if name in why:
            yield name, f"does not install: {why[name]}"
        elif need_kb > 0.7 * free_kb():
            yield name, f"left out: would need some {need_kb / 1e6:.0f} GB"
        else:
            one = child([*command, name, str(task), str(out)], out)
            if isinstance(one, str) and name in OURS:
                raise SystemExit(f"{name}: {one}")
            yield name, one


def assert_alike(measured: Mapping[str, dict[str, Any] | str]) -> None:
    """Compare hit shares and mean ranges with those of our own caster with all as faces.

    Raises
    ------
    SystemExit
        where a caster hits something else
    """
    true = measured[OURS[1]]
    for name, one in measured.items():
        if isinstance(one, str) or isinstance(true, str) or name == OURS[0]:
            continue
        # PyHelios lays its own rays, but for the raster.
        for rays in ("raster",) if name == "PyHelios" else (*SETS, "raster"):
            share, mean_m = (abs(one[rays][what] - true[rays][what]) for what in ("share", "mean_m"))
            if share > ALIKE or mean_m > ALIKE_M:
                raise SystemExit(f"{name}, {rays}: found {one[rays]}, {OURS[1]} {true[rays]}")


def cells(one: dict[str, Any]) -> list[str]:
    """Fill the columns `MEASURED`."""
    speeds = [f"{one[name][f'threads_{threads}']:.2f}" for name in SETS for threads in THREADS]
    return [f"{one['build_s']:.2f}", f"{one['memory_mb']:.0f}", *speeds]


def put_down(seen: View, mesh: Mesh, file: Path) -> None:
    """Write what the casters get."""
    np.savez(
        file,
        vertices_m=mesh.vertices_m,
        faces=mesh.faces,
        far_m=seen.far_m,
        raster_origin_m=seen.firings[0].origin_m[0, 0] - seen.window.origin_m,
        raster_columns=BLOCK,
        **{name: in_casting_order(seen, name) for name in (*SETS, "raster")},
    )


def beside(scene: str, reach_m: float, venv: Path | None) -> Table:
    """Measure all casters with what is within reach of the beginning of a walk, and compare them.

    Raises
    ------
    SystemExit
        where a caster hits something else than ours
    """
    load_before, seen = os.getloadavg()[0], view(scene, reach_m)
    mesh = written_out(seen)
    triangles = len(mesh.faces)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        put_down(seen, mesh, folder / TASK)
        del mesh  # may be gigabytes
        measured = dict(rows(scene, reach_m, venv or folder / "venv", folder, triangles))
    assert_alike(measured)
    title = f"{scene} within {reach_m:g} m, {seen.trees} trees and saplings, M pulses/s, load {load_before:.0f}"
    table = Table("caster", "M triangles", *MEASURED, "hit, %", "mean range, m", title=title, box=MARKDOWN)
    for name, one in measured.items():
        if isinstance(one, str):
            table.add_row(name, one)
            continue
        held = seen.triangles if name in OURS[:2] else triangles
        met = one["raster"]["share"], one["raster"]["mean_m"]
        table.add_row(name, f"{held / 1e6:.2f}", *cells(one), f"{100 * met[0]:.2f}", f"{met[1]:.3f}")
    return table


def by_reach(scene: str) -> Table:
    """Measure ours against how far it sees."""
    nothing = Mesh(np.zeros((3, 3), np.float32), np.zeros((1, 3), np.uint32))
    heads = "reach, m", "trees", "M triangles", "M written out"
    table = Table(*heads, *MEASURED, title=f"{scene}, ours, M pulses/s", box=MARKDOWN)
    for reach_m in REACHES_M:
        seen = view(scene, reach_m)
        with tempfile.TemporaryDirectory() as name:
            put_down(seen, nothing, Path(name) / TASK)
            one = dict(islice(rows(scene, reach_m, Path(name), Path(name), 0), 1))[OURS[0]]
        counts = [f"{count / 1e6:.2f}" for count in (seen.triangles, seen.triangles_written_out)]
        table.add_row(f"{reach_m:g}", str(seen.trees), *counts, *(cells(one)))
    return table


def in_casting_order(seen: View, name: str) -> NDArray[np.float32]:
    """Rays of a set (n, 6), in the order in which the chain casts them: lines laser by laser in eight sequences."""
    (beam, blocks), from_m = seen.blocks(name), seen.window.origin_m
    if beam.has_width:
        parts = [sub_rays(firings, beam, from_m, 0, beam.rays) for firings in blocks]
        return np.concatenate([np.concatenate(part, axis=-1).reshape(-1, 6) for part in parts])
    lines = [np.concatenate([f.origin_m - from_m, f.direction], axis=-1) for f in blocks]
    eights = [line.reshape(-1, 8, line.shape[1], 6).transpose(0, 2, 1, 3).reshape(-1, 6) for line in lines]
    return np.concatenate(eights).astype(np.float32)


if __name__ == "__main__":
    _scene, _reach_m, _name, _task, _out = sys.argv[1:]
    Path(_out).write_text(json.dumps(own_row(_scene, float(_reach_m), _name, Path(_task))))
