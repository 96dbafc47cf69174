"""What each stage of the chain makes of short stretches of scenes, as arrays in files: the worker of `tools/same_bytes`.

    python tools/same_stages.py FOLDER [--threads N] [--pieces N] [--scenes NAME ...]

Writes FOLDER/SCENE.npz with arrays named STAGE/ARRAY, and FOLDER/probes.npz with what the libraries answer to the same
arguments: an environment that changes none of these answers proves nothing.
"""

import argparse
import math
import tempfile
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.emulator import Emulator
from vlp16emu.engine import Engine, Job, assemble, in_one_world
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.foliage.tiles import FarTile
from vlp16emu.raycast import build
from vlp16emu.raycast.caster import Geometry
from vlp16emu.scenario import Scenario, load
from vlp16emu.types import Firings, Hits, Mesh, Returns, Window, World

Arrays = dict[str, NDArray[Any]]

STAGES = "world", "poses", "firings", "hits", "returns", "packets", "points"
"""In the order of the chain."""
START_S, SPAN_S = 3.0, 0.1
_NEAR = {"sensor.max_range_m": 25.0}
"""Growing a world takes most of the time; within 25 m there are both exact surfaces and the medium."""
_FAULTS = [
    {"kind": "rpm_wobble", "at_s": 0.0},
    {"kind": "dead_laser", "at_s": 3.02, "laser": 3},
    {"kind": "dirty_window", "at_s": 0.0, "sector_deg": [40, 90]},
    {"kind": "drop", "at_s": 0.0, "share": 0.1},
    {"kind": "corrupt", "at_s": 0.0, "share": 0.1},
    {"kind": "jitter", "at_s": 0.0, "up_to_s": 0.001},
]
_ROUGH = {
    "sensor.return_mode": "dual",
    "world.stems_per_ha": 250.0,
    "wind.speed_m_s": 5.0,
    "weather.rain_mm_h": 20.0,
    "motion.harness": {},
    "events": _FAULTS,
}
_DISTURBED_M = 1e-6
"""A unit in the last place of ranges from 8 to 16 m, the farthest that faces are cast at."""
_BEAMS = {"model": "free", "beams": 64, "vertical_fov_deg": [-25.0, 15.0], "max_range_m": 25.0}
SCENES: dict[str, tuple[str, dict[str, object]]] = {
    "hall": ("static_bench", {}),
    "birch_walk": ("birch_walk", _NEAR),
    "points of 64 beams": ("birch_walk", {"sensor": _BEAMS}),
    "spruce_walk, rough": ("spruce_walk", _NEAR | _ROUGH),
    "reference_forest": ("reference_forest", _NEAR),
}
"""Scene and settings; "rough" is dual return with wind, rain, harness and faults, among fewer stems: those in wind take long to build."""
CAPTURE = "capture of README.md"


class Grown:
    """A world that keeps a copy of all that it gives, by group and name."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._given: dict[tuple[str, str], Window | FarTile | tuple[Mesh, ...]] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._world, name)

    def window(self, track_m: NDArray[np.float64]) -> Window:
        """Give a window; those of a run are along different tracks."""
        window = self._world.window(track_m)
        self._given["window", f"{track_m[0].round()}"] = window
        return window

    def far_tile(self, ix: int, iy: int) -> FarTile:
        """Give a square of the world as it is from afar."""
        tile = self._given["tile", f"{ix} {iy}"] = self._world.far_tile(ix, iy)
        return tile

    def shape(self, key: Hashable) -> tuple[Mesh, ...]:
        """Grow a shape; those that the store keeps are a group of their own, as it may give them."""
        group = "kept" if self._world.shape_name(key) else "shape"
        meshes = self._given[group, f"{key}"] = self._world.shape(key)
        return meshes

    def arrays(self) -> Arrays:
        """Join the arrays of a group, in the order of names."""
        parts: dict[str, list[NDArray[Any]]] = {}
        for (group, _), given in sorted(self._given.items(), key=lambda item: item[0]):
            for thing in given if isinstance(given, tuple) else (given,):
                for name, array in _arrays_of(thing):
                    plain = np.frombuffer(array.tobytes(), np.uint8 if array.dtype.names else array.dtype)
                    parts.setdefault(f"world/{group}.{name}", []).append(plain)
        return {name: np.concatenate(found) for name, found in parts.items()}


def _arrays_of(made: Any) -> list[tuple[str, NDArray[Any]]]:
    values = [(field.name, getattr(made, field.name)) for field in fields(made)]
    return [(name, value) for name, value in values if isinstance(value, np.ndarray)]


@dataclass(frozen=True)
class _Keeping(Engine):
    """An engine that hands the returns of its jobs to a function."""

    keep: Callable[[int, Returns], None] = lambda _unit, _returns: None

    def _scan(self, job: Job, opened: Future[Geometry]) -> Returns:
        returns = super()._scan(job, opened)
        self.keep(job.unit.number, returns)
        return returns


class Recorded:
    """A run that keeps what its stages make, block by block, so that neither threads nor pieces change the order."""

    def __init__(self, scenario: Scenario, threads: int, like: "Recorded | None" = None) -> None:
        self._made: dict[str, dict[tuple[int, int], NDArray[Any]]] = {}
        self._grown: Grown | None = None
        self.scenario = scenario
        if like and in_one_world(scenario, like.scenario):
            of_world: Any = like.engine
        else:
            parts = assemble(scenario)
            self._grown = Grown(parts.world)
            of_world = SimpleNamespace(scenario=scenario, parts=replace(parts, world=self._grown))
        self.engine = _Keeping.of(scenario, threads=threads, taps=[self._look], like=of_world)
        self.engine = replace(self.engine, keep=self._keep_returns)

    def stages(self, pieces: int) -> Arrays:
        """Run the stretch in one or more pieces, and give the arrays of all stages."""
        edges_s = np.linspace(START_S, START_S + SPAN_S, pieces + 1).tolist()
        spans_s = list(pairwise(edges_s))
        of = _points if self.scenario.sensor.model == "free" else _packets
        last = of(self.engine, spans_s)
        blocks = {
            name: np.concatenate([array for _, array in sorted(made.items(), key=lambda item: item[0])])
            for name, made in self._made.items()
        }
        return (self._grown.arrays() if self._grown else {}) | blocks | last

    def _look(self, job: Job, firings: Firings, hits: Hits, _geometry: Geometry) -> None:
        """Keep poses, firings and hits of some blocks."""
        unit = job.unit
        poses, first = unit.motion.poses_at(firings.t_ns.reshape(-1)), (unit.number, firings.index)
        rows, lasers = firings.t_ns.shape
        rays = np.concatenate([[0], hits.count.sum(axis=1, dtype=np.int64).cumsum()])
        if len(poses.t_ns) == 1:  # it never moves
            self._keep("poses", (unit.number, 0), poses, np.arange(2))
        else:
            self._keep("poses", first, poses, np.arange(rows + 1) * lasers)
        self._keep("firings", first, firings, np.arange(rows + 1))
        self._keep("hits", first, hits, rays)

    def _keep_returns(self, unit: int, returns: Returns) -> None:
        first = unit, returns.firings.index
        self._keep("returns", first, replace(returns, surfaces=None), np.arange(len(returns.distance_m) + 1))

    def _keep(self, stage: str, first: tuple[int, int], made: object, edges: NDArray[np.int64]) -> None:
        """Keep arrays block by block; those of firing sequence r of some blocks are at `edges` r to r + 1."""
        every, block = np.arange(len(edges)), self.engine.batching.block
        for name, array in _arrays_of(made):
            at = every if name == "count" else edges
            for row in range(0, len(edges) - 1, block):
                part = array[at[row] : at[min(row + block, len(edges) - 1)]]
                self._made.setdefault(f"{stage}/{name}", {})[first[0], first[1] + row] = part


def _packets(engine: Engine, spans_s: list[tuple[float, float]]) -> Arrays:
    """Run an engine to packets; payloads (n, bytes) are filled with zeros to the length of the longest."""
    packets = [packet for span_s in spans_s for packet in engine.packets(*span_s)]
    longest = max(len(packet.payload) for packet in packets)
    payload = b"".join(packet.payload.ljust(longest, b"\0") for packet in packets)
    return {
        "packets/due_ns": np.array([packet.due_ns for packet in packets]),
        "packets/length": np.array([len(packet.payload) for packet in packets]),
        "packets/payload": np.frombuffer(payload, np.uint8).reshape(-1, longest),
    }


def _points(engine: Engine, spans_s: list[tuple[float, float]]) -> Arrays:
    emulator = Emulator(engine.scenario)
    emulator.run = replace(emulator.run, engine=engine)
    parts: dict[str, list[NDArray[Any]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "points.npz"
        for span_s in spans_s:
            span = {"start_s": span_s[0], "duration_s": span_s[1] - span_s[0]}
            write_points(emulator, path, **span, truth=True)
            with np.load(path) as file:
                for name, array in file.items():
                    parts.setdefault(f"points/{name}", []).append(np.atleast_1d(array))
    return {name: np.concatenate(found) for name, found in parts.items()}


def _capture(threads: int) -> Arrays:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "capture.pcap"
        Emulator("birch_walk", threads=threads).record(path, duration_s=10.0)
        return {"packets/capture": np.fromfile(path, np.uint8)}


def probes() -> Arrays:
    """Ask each library for what processors may answer differently; of numba the instructions of a sum of products."""
    import numba  # here: the package chooses the processor that it compiles for before it is imported

    @numba.njit
    def sum_of_products(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
        total = 0.0
        for i in range(len(a)):
            total += a[i] * b[i]
        return total

    x = np.random.default_rng(1).uniform(-5.0, 5.0, 4096)
    square = x.reshape(64, 64)
    functions = (math.exp, math.sin, math.cos, math.atan, lambda value: math.pow(abs(value), 1.7))
    sum_of_products(x, x)
    (code,) = sum_of_products.inspect_asm().values()
    lines = [line for line in code.splitlines() if line.startswith("\t") and not line.startswith("\t.")]
    vectors = [f(x.astype(kind)) for kind in (np.float64, np.float32) for f in (np.exp, np.sin, np.cos)]
    return {
        "libm": np.array([[f(value) for value in x.tolist()] for f in functions]),
        "numpy": np.concatenate([*vectors, np.log(np.abs(x)), np.arctan2(x, x[::-1])]),
        "blas": np.concatenate([square @ square, np.linalg.inv(square)]),
        "numba": np.frombuffer("\n".join(lines).encode(), np.uint8),
        "triangles": build.widened(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.uint32)),
    }


def disturb() -> None:
    """Move each corner of the triangles that Embree is given at random: it finds other distances, edges and orders."""
    widened = build.widened

    def disturbed(vertices_m: NDArray[np.float32], triangles: NDArray[np.uint32]) -> NDArray[np.float32]:
        wider_m = widened(vertices_m, triangles)
        random = np.random.default_rng(len(wider_m))  # one for each call: threads build side by side
        return wider_m + random.uniform(-_DISTURBED_M, _DISTURBED_M, wider_m.shape).astype(np.float32)

    build.widened = disturbed


def made(names: list[str], threads: int, pieces: int) -> Iterator[tuple[str, Arrays]]:
    """Run scenes; those of one world share what grows in it."""
    before: Recorded | None = None
    for name in names:
        if name == CAPTURE:
            yield name, _capture(threads)
            continue
        scene, settings = SCENES[name]
        before = Recorded(load(scene, settings), threads, before)
        yield name, before.stages(pieces)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--pieces", type=int, default=1)
    parser.add_argument("--disturbed", action="store_true", help="give Embree other triangles")
    parser.add_argument("--scenes", nargs="+", choices=(*SCENES, CAPTURE), default=[*SCENES])
    options = parser.parse_args()
    if options.disturbed:
        disturb()
    options.folder.mkdir(parents=True, exist_ok=True)
    np.savez(options.folder / "probes.npz", **probes())
    for name, arrays in made(options.scenes, options.threads, options.pieces):
        np.savez(options.folder / f"{name}.npz", **arrays)


if __name__ == "__main__":
    main()
