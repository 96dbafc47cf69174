"""Plan of a run: features in use and their cost, surroundings of the sensor, and the outlook of a stream."""

import math
import sys
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

from vlp16emu.engine import Engine
from vlp16emu.engine.windows import window_of
from vlp16emu.extras.keep_up import choose, settings_that_keep_up
from vlp16emu.extras.meshes.furnished import MeshKey
from vlp16emu.extras.walk.settings import Walk
from vlp16emu.forest.plants.foliage import IvyKey
from vlp16emu.forest.plants.prototypes import CrownKey, SaplingKey, ShrubKey
from vlp16emu.forest.plants.stem import StemKey
from vlp16emu.forest.stand.floor_shapes import FloorKey
from vlp16emu.forest.stand.tree_models import ModelKey
from vlp16emu.forest.tiles import TileKey
from vlp16emu.run.report import Recording
from vlp16emu.scenario import Scenario
from vlp16emu.units import S_NS

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
_SCARCE = 1.2  # speed below which other programs, for instance a driver on the same machine, may make a stream late


@dataclass(frozen=True, slots=True)
class Need:
    """A feature of a run."""

    name: str
    on: bool
    costs: str  # cost if it is on, otherwise the saving


def needs(engine: Engine, *, audited: bool) -> list[Need]:
    """Return the features of a recording, on or off; `audited` if pulses of it are cast again."""
    scenario, parts = engine.scenario, engine.parts
    motion = scenario.motion
    gait = isinstance(motion, Walk) and motion.gait.preset != "none"
    harness = isinstance(motion, Walk) and motion.harness is not None
    canopy = scenario.gps.connected and scenario.gps.canopy_loss
    moves, many, blows = any(unit.motion.moves for unit in parts.units), len(parts.units), parts.wind is not None
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
        "audit": (audited, "0.05 % of the pulses are cast again, with 512 rays each or more", "no pulse is cast again"),
        "labels": (False, "", "no surface behind returns: see `vlp16emu points --truth`"),
        "truth": (False, "", "no files beside it: see `vlp16emu record --truth`"),
    }
    unit = parts.units[0]
    of, beam, one_ray = unit.detector.constants, unit.beam, "one ray for each pulse, no axes of its footprint"
    is_noisy = max(of.range_noise_m, of.reflectivity_noise, of.reflectivity_noise_share) > 0.0
    ranked, strongest = "all echoes of each pulse are ranked", "nothing is looked for behind the strongest echo"
    of_sensor = {
        "beam width": (beam.has_width, f"up to {beam.rays} rays for each pulse", one_ray),
        "range and reflectivity noise": (is_noisy, "a pair of random numbers for each return", "no random number"),
        "detection threshold": (of.amplitude_noise > 0.0, "a random number for each faint echo", "every echo is seen"),
        "weather": (of.extinction_per_m > 0.0, "a draw of the air for each pulse", "clear air"),
        "last and second return": (not of.strongest_only, ranked, strongest),
    }
    return [Need(name, on, costs if on else spares) for name, (on, costs, spares) in (of_sensor | rows).items()]


def surroundings(engine: Engine) -> dict[str, Any]:
    """Return the surroundings within range of the sensor at the start: kind of the world, species, and counts by kind of object."""
    window = window_of(engine.parts, engine.scenario.start_ns, engine.batching, 0)
    named, placed = (getattr(key, "species", None) for key in window.shapes), Counter[str](tiles=0, trees=0)
    for which, often in Counter(window.shape.tolist()).items():
        key = window.shapes[which]
        kind = f"{key.kind.name.lower()}s" if isinstance(key, FloorKey) else _KINDS.get(type(key), "things")
        placed[kind] += often
    species = tuple(sorted({name for name in named if name is not None}))
    kind = engine.scenario.world.kind
    return {"kind": kind, "species": species, "placed": dict(placed), "surfaces": len(window.surfaces)}


def libraries() -> dict[str, bool]:
    """Return True for each library that this process has loaded."""
    return {name: name in sys.modules for name in _LIBRARIES}


def verdict(speed: float) -> str:
    """Return as text if a stream keeps up, from the simulated seconds per second of the engine."""
    if speed < 1.0:
        return "no, packets will be late"
    return "yes" if speed >= _SCARCE else "yes, with next to nothing left for other programs"


def recording_outlook(engine: Engine, measured: Recording, started_s: float, duration_s: float) -> dict[str, float]:
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
    """Return if a stream keeps up at a speed of the engine, and options with which it would, each sufficient alone."""
    options = [] if speed >= 1.0 else settings_that_keep_up(scenario, speed, 1.0)
    rung, _, _ = choose(scenario, 1.0, lambda rung: math.inf if rung else speed)
    return {
        "keeps_up": speed >= 1.0,
        "verdict": verdict(speed),
        "keeps_up_with": options,
        "rung": rung.name if rung else "the scene as it is",  # choice of `stream --keep-up` at this speed
    }
