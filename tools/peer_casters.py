"""Ray casters of others, each behind one function, and the measurement of any caster: run by `tools/peers`.

    python peer_casters.py NAME TASK.npz CPU_SECONDS

It runs with the Python of a virtual environment that has these casters, and not vlp16emu. A task has
triangles (`vertices_m`, `faces`), rays (n, 6) of origin and direction (`rays_1`, `rays_8`, by rays of a
pulse), and the range at which they end (`reach_m`).
"""

import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

EMBREE = "Embree, one ray after the other"

Task = Mapping[str, Any]
Casts = dict[str, Callable[[], np.ndarray]]  # by rays of a pulse: casts once, returns ranges in metres


def resident_mb() -> float:
    """Return the memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def measure(build: Callable[[Task], Casts], task: Task, cpu_s: float) -> dict[str, Any]:
    """Build a caster, and cast at least twice and until `cpu_s` are used: least CPU time, and what is hit."""
    before_mb = resident_mb()
    start_s = time.process_time()
    casts = build(task)
    found: dict[str, Any] = {}
    for rays, cast in casts.items():
        range_m = cast()  # what is built by the first rays counts as building
        hit = np.isfinite(range_m) & (range_m <= float(task["reach_m"]))
        found[rays] = {"share": float(hit.mean()), "mean_m": float(range_m[hit].mean(dtype=np.float64))}
        found[rays]["pulses"] = range_m.size // int(rays)
    found["build_s"] = time.process_time() - start_s
    found["memory_mb"] = resident_mb() - before_mb
    for rays, cast in casts.items():
        times_s = list[float]()
        while len(times_s) < 2 or sum(times_s) < cpu_s:
            start_s = time.process_time()
            cast()
            times_s.append(time.process_time() - start_s)
        found[rays]["s_per_million"] = 1e6 * min(times_s) / found[rays]["pulses"]
    return found


def embree(task: Task) -> Casts:
    """Bare Embree by the classes of embreex: single rays, without normals."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, task["vertices_m"], task["faces"].astype(np.int32))

    def casts(rays: np.ndarray) -> Callable[[], np.ndarray]:
        origin_m, direction = np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:])
        reach_m = np.full(len(rays), float(task["reach_m"]), np.float32)

        def cast() -> np.ndarray:
            limit_m = reach_m.copy()  # ranges are written there
            range_m = scene.run(origin_m, direction, limit_m, query="DISTANCE")
            range_m[range_m >= reach_m] = np.inf  # a ray that misses keeps its limit
            return range_m

        return cast

    return {rays: casts(task[f"rays_{rays}"]) for rays in ("1", "8")}


def open3d(task: Task) -> Casts:
    """Open3D's RaycastingScene with one thread; it reports normals too."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(open3d.core.Tensor(task["vertices_m"]), open3d.core.Tensor(task["faces"]))

    def casts(rays: np.ndarray) -> Callable[[], np.ndarray]:
        given = open3d.core.Tensor(rays)

        def cast() -> np.ndarray:
            return scene.cast_rays(given, nthreads=1)["t_hit"].numpy()

        return cast

    return {rays: casts(task[f"rays_{rays}"]) for rays in ("1", "8")}


def mitsuba(task: Task) -> Casts:
    """Mitsuba 3 as compiled by LLVM, rays marked as coherent, ranges only."""
    import drjit
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    drjit.set_thread_count(1)
    mesh = mitsuba.Mesh("all", len(task["vertices_m"]), len(task["faces"]))
    fields = mitsuba.traverse(mesh)
    fields["vertex_positions"] = task["vertices_m"].reshape(-1)
    fields["faces"] = task["faces"].reshape(-1)
    fields.update()
    scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})

    def casts(rays: np.ndarray) -> Callable[[], np.ndarray]:
        columns = [mitsuba.Float(np.ascontiguousarray(column)) for column in rays.T]
        ray = mitsuba.Ray3f(mitsuba.Point3f(*columns[:3]), mitsuba.Vector3f(*columns[3:]))
        ray.maxt = mitsuba.Float(float(task["reach_m"]))
        drjit.eval(ray)

        def cast() -> np.ndarray:
            hits = scene.ray_intersect_preliminary(ray, coherent=True)
            drjit.eval(hits.t)
            drjit.sync_thread()
            return hits.t.numpy()

        return cast

    return {rays: casts(task[f"rays_{rays}"]) for rays in ("1", "8")}


PEERS = {EMBREE: embree, "Open3D": open3d, "Mitsuba": mitsuba}


if __name__ == "__main__":
    _name, _task, _cpu_s = sys.argv[1:]
    with np.load(_task) as _file:
        print(json.dumps(measure(PEERS[_name], dict(_file), float(_cpu_s))))
