"""Cast given rays at given triangles with a ray caster of somebody else, and measure it.

    python peer_casters.py NAME TASK.npz OUT.json

`tools/bench --peers` runs it with the Python of a virtual environment that has these casters, and not this project.
The task has the triangles (`vertices_m`, `faces`), sets of rays (n, 6), the range at which they end (`far_m`), and
what a raster is made of (`raster_origin_m`, `raster_columns`).
"""

import importlib
import json
import math
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

SETS = ("one", "eight")
"""Sets of rays whose casting is timed; `raster` is for comparison alone."""
RAYS = {"eight": 8}
"""Of a pulse, where they are more than one."""
THREADS = (1, 2)
LONGEST_S, MOST = 4.0, 40
"""Repeats of a measurement: as many as begin within this time, but not more."""

Task = Mapping[str, np.ndarray]


class Work(NamedTuple):
    """One way to cast a set of rays."""

    cast: Callable[[], Any]
    ranges: Callable[[Any], np.ndarray]
    """From what `cast` gives to ranges in metres, not finite where nothing is met."""
    pulses: int
    """Of one ray or several."""
    idle: Callable[[], Any] | None = None
    """What of `cast` is there without rays, and does not count."""


Prepare = Callable[[str, int], Work]
"""Gets rays ready, by the name of their set and the number of threads."""


def resident_mb() -> float:
    """Memory of this process now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def least(work: Callable[[], Any], clock: Callable[[], float]) -> float:
    """Least time over the repeats, in seconds."""
    times, stop = list[float](), time.perf_counter() + LONGEST_S
    while len(times) < 2 or (time.perf_counter() < stop and len(times) < MOST):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)


def speed(work: Work, threads: int) -> float:
    """Million pulses per second: of CPU time where there is one thread, else of the wall clock."""
    clock = time.process_time if threads == 1 else time.perf_counter
    idle_s = least(work.idle, clock) if work.idle else 0.0
    return work.pulses / (least(work.cast, clock) - idle_s) / 1e6


def measure(build: Callable[[Task], Prepare], task: Task) -> dict[str, Any]:
    """Build, cast and report: seconds and megabytes of building, speeds, and what was hit."""
    before_mb, start = resident_mb(), time.process_time()
    prepare = build(task)
    measured: dict[str, Any] = {"build_s": time.process_time() - start, "memory_mb": resident_mb() - before_mb}
    for name in (*SETS, "raster"):
        work = prepare(name, 1)
        range_m = work.ranges(work.cast())
        met = np.isfinite(range_m) & (range_m <= float(task["far_m"]))
        measured[name] = {"share": float(met.mean()), "mean_m": float(range_m[met].mean(dtype=np.float64))}
    for name in SETS:
        for threads in THREADS:
            measured[name][f"threads_{threads}"] = speed(prepare(name, threads), threads)
    return measured


def open3d(task: Task) -> Prepare:
    """Open3D's RaycastingScene."""
    o3d = importlib.import_module("open3d")
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(task["vertices_m"]), o3d.core.Tensor(task["faces"]))
    scene.cast_rays(o3d.core.Tensor(task["raster"][:1]), nthreads=1)  # builds

    def prepare(name: str, threads: int) -> Work:
        rays = o3d.core.Tensor(task[name])
        return Work(
            lambda: scene.cast_rays(rays, nthreads=threads),
            lambda hits: hits["t_hit"].numpy(),
            len(task[name]) // RAYS.get(name, 1),
        )

    return prepare


def mitsuba(task: Task) -> Prepare:
    """Mitsuba 3 with vectorised LLVM code; without what it would report of the surface beyond the range."""
    mi, dr = importlib.import_module("mitsuba"), importlib.import_module("drjit")
    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(1)
    mesh = mi.Mesh("scene", len(task["vertices_m"]), len(task["faces"]))
    fields = mi.traverse(mesh)
    fields["vertex_positions"], fields["faces"] = task["vertices_m"].reshape(-1), task["faces"].reshape(-1)
    fields.update()
    scene = mi.load_dict({"type": "scene", "mesh": mesh})

    def prepare(name: str, threads: int) -> Work:
        columns = [mi.Float(np.ascontiguousarray(column)) for column in task[name].T]
        ray = mi.Ray3f(mi.Point3f(*columns[:3]), mi.Vector3f(*columns[3:]))
        ray.maxt = mi.Float(float(task["far_m"]))
        dr.eval(ray)

        def cast() -> Any:
            dr.set_thread_count(threads)
            hits = scene.ray_intersect_preliminary(ray, coherent=True)
            dr.eval(hits.t)
            dr.sync_thread()
            return hits.t

        return Work(cast, lambda t_m: t_m.numpy(), len(task[name]) // RAYS.get(name, 1))

    return prepare


def pyhelios(task: Task) -> Prepare:
    """PyHelios' LiDAR, which lays its rays itself: as a raster, and about pulses as it sees fit.

    A scan builds its tree anew each time, so that a scan of next to no rays is taken off.
    """
    import ctypes

    helios = importlib.import_module("pyhelios")
    context = helios.Context()
    context.addTrianglesFromArrays(task["vertices_m"], task["faces"])
    maps = Path("/proc/self/maps").read_text().splitlines()
    openmp = ctypes.CDLL(next(line.split()[-1] for line in maps if "libgomp" in line))

    def scan(columns: int, threads: int, rays: int) -> Any:
        cloud = helios.LiDARCloud()
        cloud.disableMessages()
        zenith, around = (math.radians(75.0), math.radians(105.0)), (0.0, 2 * math.pi)
        width = (0.0127, 0.003) if rays > 1 else (0.0, 0.0)
        cloud.addScan(task["raster_origin_m"].tolist(), 16, zenith, columns, around, *width)
        openmp.omp_set_num_threads(threads)
        # Returns nearer to each other than a metre are one, as those of a VLP-16.
        cloud.syntheticScan(context, **({"rays_per_pulse": rays, "pulse_distance_threshold": 1.0} if rays > 1 else {}))
        return cloud

    def ranges(cloud: Any) -> np.ndarray:
        points_m, _ = cloud.getHitsXYZRGBArrays()
        range_m = np.linalg.norm(points_m - task["raster_origin_m"], axis=1)
        return np.where(cloud.getHitMissArray() == 1, np.inf, range_m)

    def prepare(name: str, threads: int) -> Work:
        rays, columns = RAYS.get(name, 1), int(task["raster_columns"])
        if name != "raster":
            columns *= 30  # else lost in the time that the tree takes
        return Work(lambda: scan(columns, threads, rays), ranges, 16 * columns, lambda: scan(2, threads, rays))

    scan(2, 1, 1)
    return prepare


PEERS = {"Open3D": open3d, "Mitsuba": mitsuba, "PyHelios": pyhelios}


def main() -> None:
    """Measure one caster."""
    name, task, out = sys.argv[1:]
    with np.load(task) as file:
        given = dict(file)
    Path(out).write_text(json.dumps(measure(PEERS[name], given)))


if __name__ == "__main__":
    main()
