"""Forests at their seams: where leaves become a medium, corners of tiles, and windows of a walk."""

from collections.abc import Iterator

import numpy as np

from stability_cases.case import Row, case
from vlp16emu import Emulator
from vlp16emu.engine import Engine
from vlp16emu.scenario import load
from vlp16emu.types import F8

_LIGHT = ("beam.model=fixed", "beam.rays=16")
_PERFECT = ("noise.preset=ideal", "sensor.preset=steady", "sensor.max_range_m=40.0", *_LIGHT)


def _standing(x_m: float, y_m: float, *settings: str) -> Emulator:
    motion = f'motion={{kind="static",x_m={x_m!r},y_m={y_m!r},height_m=2.0}}'
    return Emulator(load("birch_walk", [*_PERFECT, motion, *settings]))


def _ranges_m(emulator: Emulator, stop_s: float = 0.1) -> F8:
    """Return ranges (k, 16) of the strongest returns, 0 without one."""
    return np.concatenate([r.distance_m[..., 0] for r in emulator.returns(0.0, stop_s)]).astype(np.float64)


@case("the explicit world, cast leaf by leaf", is_slow=True)
def near_and_far() -> Iterator[Row]:
    """Distant foliage as a medium from 5 m, from farther away, and nowhere: near_m from 5 m to infinity."""
    true_m = _ranges_m(_standing(3.0, 3.0, "world.near_m=inf"))
    share = float((true_m > 0).mean())
    for near_m in (5.0, 10.0, 15.0, 30.0, 1e6):
        found_m = _ranges_m(_standing(3.0, 3.0, f"world.near_m={near_m}"))
        yield Row(f"{near_m:g} m: share with a return", abs(float((found_m > 0).mean()) - share), 0.02)
        before = (true_m > 0) & (true_m < min(near_m, 1e3) - 1.0)
        moved = np.abs(found_m - true_m)[before] > 1e-3
        yield Row(f"{near_m:g} m: share of nearer returns that change", float(moved.mean()), 0.01)


@case("the same world a tenth of a micrometre aside", is_slow=True)
def corners_of_tiles() -> Iterator[Row]:
    """A sensor on the corner of four tiles, and moved by 1e-7 m to each side of it."""
    settings = "world.near_m=15.0", "beam.model=none"
    here_m = _ranges_m(_standing(20.0, 20.0, *settings), 0.02)
    for x_m, y_m in ((1e-7, 0.0), (-1e-7, 0.0), (0.0, 1e-7), (0.0, -1e-7)):
        there_m = _ranges_m(_standing(20.0 + x_m, 20.0 + y_m, *settings), 0.02)
        changed = np.abs(there_m - here_m) > 1e-3
        yield Row("share of pulses that change by over 1 mm", float(changed.mean()), 1e-3)


@case("the other window, cast at the same instants", is_slow=True)
def seams_of_windows() -> Iterator[Row]:
    """The last pulses before two windows of a walk meet, in still air and in wind, cast in both."""
    for name, wind in (("still air", ()), ("wind", ("wind.speed_m_s=4.0",))):
        scenario = load("birch_walk", [*_PERFECT, *wind])
        engine = Engine.of(scenario)
        unit = engine.parts.units[0]
        batching = engine.batching
        seam = batching.segment
        both = [engine.windows.wait(engine.windows.at_block(block)) for block in (seam - 1, seam)]
        firings = unit.head.aim(seam * batching.block - 160, 160, unit.motion.poses_at, beam_axis=True)
        hits = [g.cast(firings, unit.head.beams.near_m, unit.section.max_range_m, unit.beam) for g in both]
        one_m, other_m = (np.where(np.isfinite(of.range_m), of.range_m, 0.0) for of in hits)
        apart = np.abs(one_m - other_m)
        yield Row(f"{name}: share of rays that change by over 1 mm", float((apart > 1e-3).mean()), 0)
        other = hits[0].count != hits[1].count
        yield Row(f"{name}: pulses with another number of rays", int(other.sum()), 0)
