"""Plan of a run: features in use and their cost, surroundings of the sensor, and the outlook of a stream."""

import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from vlp16emu.engine import Engine, Job, Unit
from vlp16emu.engine.windows import window_of
from vlp16emu.extras.meshes.furnish import MeshKey
from vlp16emu.extras.outlook import Outlook
from vlp16emu.extras.walk.settings import Walk
from vlp16emu.forest.plants.foliage import IvyKey
from vlp16emu.forest.plants.prototypes import CrownKey, SaplingKey, ShrubKey
from vlp16emu.forest.plants.stem import StemKey
from vlp16emu.forest.stand.floor_shapes import FloorKey
from vlp16emu.forest.stand.tree_models import ModelKey
from vlp16emu.forest.tiles import TileKey
from vlp16emu.packets import pack_data
from vlp16emu.raycast.caster import Geometry
from vlp16emu.raycast.texture import add_texture
from vlp16emu.returns.detect import detect
from vlp16emu.run.report import Recording
from vlp16emu.scenario import Scenario
from vlp16emu.trees import Tree
from vlp16emu.types import ReturnMode, SensorModel
from vlp16emu.units import S_NS

T = TypeVar("T")

_KINDS = {
    CrownKey: "trees",
    IvyKey: "stems with ivy",
    ModelKey: "tree models",
    SaplingKey: "saplings",
    ShrubKey: "shrubs",
    TileKey: "tiles",
    StemKey: "stems",
    MeshKey: "meshes",
}
_LIBRARIES = ("numpy", "numba", "scipy", "embreex", "dpkt", "trimesh", "rasterio", "PIL", "rich", "serial")
_RUNS = 4  # over the first window
_RAYS = 8  # firing sequences that casters take together


@dataclass(frozen=True, slots=True)
class Need:
    """A feature of a run."""

    name: str
    on: bool
    costs: str  # cost if it is on, otherwise the saving


def needs(engine: Engine, *, audited: bool) -> list[Need]:
    """Return the features of a recording, on or off; `audited` if pulses of it are cast again."""
    scenario = engine.scenario
    parts = engine.parts
    motion = scenario.motion
    gait = isinstance(motion, Walk) and motion.gait.preset != "none"
    harness = isinstance(motion, Walk) and motion.harness is not None
    canopy = scenario.gps.connected and scenario.gps.canopy_loss
    moves = any(unit.motion.moves for unit in parts.units)
    many = len(parts.units)
    blows = parts.wind is not None
    own = bool(scenario.world.meshes or getattr(scenario.world, "tree_models", []))
    rows = {
        "motion": (moves, "a pose for every pulse, a window every 7 s", "one pose and one window for all"),
        "gait": (gait, "sums of lines for every pose", "nothing is swung"),
        "harness": (harness, "its answer to the gait for every pose", "nothing is solved"),
        "inertial unit": (parts.imu is not None, "samples, with --truth only", "no samples"),
        "satellites": (canopy, "256 rays at the sky once a second", "no ray at the sky"),
        "wind": (blows, "stems and crowns are instances that move in every window", "nothing is moved"),
        "rig": (
            many > 1,
            f"each of {many} sensors casts its own pulses in the same windows",
            "one sensor, nothing is merged",
        ),
        "meshes of your own": (own, "read once, placed where in reach", "none, trimesh stays unloaded"),
        "audit": (
            audited,
            "0.05 % of the pulses are cast again, with 512 rays each or more",
            "no pulse is cast again",
        ),
        "labels": (False, "", "no surface behind returns: see `vlp16emu points --truth`"),
        "truth": (False, "", "no files beside it: see `vlp16emu record --truth`"),
    }
    unit = parts.units[0]
    of = unit.detector.constants
    beam = unit.beam
    one_ray = "one ray for each pulse, no axes of its footprint"
    is_noisy = max(of.range_noise_m, of.reflectivity_noise, of.reflectivity_noise_share) > 0.0
    ranked = "all echoes of each pulse are ranked"
    strongest = "nothing is looked for behind the strongest echo"
    of_sensor = {
        "beam width": (beam.has_width, f"up to {beam.rays} rays for each pulse", one_ray),
        "range and reflectivity noise": (
            is_noisy,
            "a pair of random numbers for each return",
            "no random number",
        ),
        "detection threshold": (
            of.amplitude_noise > 0.0,
            "a random number for each faint echo",
            "every echo is seen",
        ),
        "weather": (of.extinction_per_m > 0.0, "a draw of the air for each pulse", "clear air"),
        "last and second return": (not of.strongest_only, ranked, strongest),
    }
    return [
        Need(name, on, costs if on else spares) for name, (on, costs, spares) in (of_sensor | rows).items()
    ]


def surroundings(engine: Engine) -> Tree:
    """Return the surroundings within range of the sensor at the start.

    They are the kind of the world, species, and counts by kind of object.
    """
    window = window_of(engine.parts, engine.scenario.start_ns, engine.batching, 0)
    named = (getattr(key, "species", None) for key in window.shapes)
    placed = Counter[str](tiles=0, trees=0)
    for which, often in Counter(window.shape.tolist()).items():
        key = window.shapes[which]
        kind = f"{key.kind.name.lower()}s" if isinstance(key, FloorKey) else _KINDS.get(type(key), "things")
        placed[kind] += often
    species = tuple(sorted({name for name in named if name is not None}))
    kind = engine.scenario.world.kind
    return {"kind": kind, "species": species, "placed": dict(placed), "surfaces": len(window.surfaces)}


@dataclass(frozen=True, slots=True)
class Stage:
    """Cost of a stage of the chain."""

    name: str
    cpu_s_per_s: float  # processor seconds of one core per simulated second


def stages(engine: Engine, repeats: int) -> list[Stage]:
    """Measure the stages of the chain with the first sensor, in their order: the best of the repeats.

    Each works on the same pulses, spread over the first window, as many at once as in a run. Rays that end at
    `world.near_m` give the first stage of casting, and the further cost of the full range the second one.
    Opening a window is the processor time of all threads for the second one, as the sensor moves.
    """
    unit = engine.parts.units[0]
    parts = engine.parts
    count = unit.beam.revolutions_at_once * engine.batching.block * engine.batching.parts
    segment = engine.batching.segment * engine.batching.block
    geometry = engine.windows.at_block(0).result()
    spent_s = dict[str, float]()
    for first in range(0, segment, segment // _RUNS):
        for name, own_s in _stages_at(engine, unit, geometry, first // _RAYS * _RAYS, count, repeats).items():
            spent_s[name] = spent_s.get(name, 0.0) + own_s
    simulated_s = _RUNS * count * engine.batching.sequence_ns / S_NS
    found = [Stage(name, own_s / simulated_s) for name, own_s in spent_s.items()]
    if parts.moves:
        began_s = time.process_time()
        engine.windows.at_block(engine.batching.segment).result()
        opened_s = (time.process_time() - began_s) * S_NS / (segment * engine.batching.sequence_ns)
        found.insert(0, Stage("open windows of the world", opened_s))
    return found


def _stages_at(
    engine: Engine, unit: Unit, geometry: Geometry, first: int, count: int, repeats: int
) -> dict[str, float]:
    """Return the processor time of the stages, in seconds.

    It covers `count` firing sequences from number `first`.
    """
    head = unit.head
    sensor = engine.scenario.sensor
    world = engine.parts.world
    job = Job(
        unit, unit.detector, range(first // engine.batching.block, 1), engine.batching.block, world.seed
    )
    spent_s = dict[str, float]()

    def time_stage(name: str, work: Callable[[], T]) -> T:
        """Do the work of a stage several times, note its least time, and return its result."""
        times_s = []
        for _ in range(repeats):
            began_s = time.thread_time()
            result = work()
            times_s.append(time.thread_time() - began_s)
        spent_s[name] = min(times_s)
        return result

    t_ns = head.times_ns(first, count).reshape(-1)
    poses = time_stage("poses of pulses", lambda: unit.motion.poses_at(t_ns))
    firings = time_stage(
        "aim", lambda: head.aim(first, count, lambda _: poses, beam_axis=unit.beam.has_width)
    )
    far_m, near_m = (
        sensor.max_range_m,
        min(sensor.max_range_m, 0.999 * world.near_m),
    )  # no ray goes on into the medium
    time_stage("cast, near", lambda: geometry.cast(firings, head.beams.near_m, near_m, unit.beam))
    hits = time_stage("cast, far", lambda: geometry.cast(firings, head.beams.near_m, far_m, unit.beam))
    spent_s["cast, far"] = max(spent_s["cast, far"] - spent_s["cast, near"], 0.0)
    for tap in engine.taps:
        time_stage("audit", lambda tap=tap: tap(job, firings, hits, geometry))  # type: ignore[misc]
    time_stage("texture", lambda: add_texture(firings, hits, geometry.surfaces, world.seed))
    if unit.state.optics is not None:
        optics = unit.state.optics
        hits = time_stage("window", lambda: optics.dim(firings, hits))
    returns = time_stage(
        "detect", lambda: detect(firings, hits, geometry.surfaces, unit.detector, truth=False)
    )
    if sensor.model in {model.value for model in SensorModel}:
        mode = ReturnMode(sensor.return_mode)
        time_stage("pack", lambda: pack_data(returns, mode, SensorModel(sensor.model), unit.number))
    return spent_s


def libraries() -> dict[str, bool]:
    """Return True for each library that this process has loaded."""
    return {name: name in sys.modules for name in _LIBRARIES}


def recording_outlook(
    engine: Engine, measured: Recording, started_s: float, duration_s: float
) -> dict[str, float]:
    """Return run time and size of a recording from a measured one; all windows cost as much as the second.

    Parameters
    ----------
    started_s : measured time from the start of the program to the end of the first moment
    duration_s : simulated seconds of the recording
    """
    segment_s = engine.batching.segment * engine.batching.block_ns / S_NS
    further = int(duration_s // segment_s) if engine.parts.moves else 0
    opening_s = 0.0
    if further:
        began_s = time.process_time()
        engine.windows.at_block(engine.batching.segment).result()
        opening_s = (time.process_time() - began_s) / engine.threads
    return {
        "duration_s": duration_s,
        "wall_s": started_s + duration_s / measured.real_time_factor + further * opening_s,
        "bytes": round(measured.bytes * duration_s / measured.simulated_s),
    }


def stream_outlook(scenario: Scenario, speed: float) -> dict[str, object]:
    """Return if a stream keeps up at a speed of the engine, and options with which it would."""
    outlook = Outlook(scenario, speed)
    rung = next(iter(outlook.candidates), None)
    return {
        "keeps_up": outlook.keeps_up,
        "verdict": outlook.verdict,
        "keeps_up_with": [] if outlook.keeps_up else outlook.advice,
        "rung": rung.name if rung else "the scene as it is",  # choice of `stream --keep-up` at this speed
    }
