"""Run time of each stage of the chain: seconds of one thread per simulated second, the best of the repeats.

On a shared machine the ratios mean more than the figures. As many blocks are cast together as in the chain. "Cast,
near" ends rays where the medium begins; without a medium it casts to the full range. Opening is the processor time of all
threads for the second window, with the first window open and its geometry kept.
"""

import time
from collections.abc import Callable

import numpy as np
from rich.box import MARKDOWN
from rich.table import Table

from vlp16emu import Emulator
from vlp16emu.engine.windows import BLOCK, SEGMENT, STEPS
from vlp16emu.packets import pack_data
from vlp16emu.raycast.caster import Geometry
from vlp16emu.raycast.texture import add_texture
from vlp16emu.returns.detect import detect
from vlp16emu.scenario import load
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import Firings, Hits, ReturnMode, Returns, Semantic, SensorModel

BLOCK_S = BLOCK * SEQUENCE_NS * 1e-9
SETTINGS = {
    "default": [],
    "default, dual": ["sensor.return_mode=dual"],
    "one ray": ["beam.model=none"],
    "one ray, ideal": ["beam.model=none", "noise.preset=ideal"],
}
RUNS = 4  # over the window
NEAR, CAST = "cast, near", "cast"


def best(work: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of this thread over the repeats, in seconds."""
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return min(times)


def opening_s(emulator: Emulator) -> float:
    """Return the processor seconds per simulated second for opening windows; 0 if there is only one."""
    emulator.engine.windows.at_block(0).result()
    if not emulator.parts.moves:
        return 0.0
    start = time.process_time()
    emulator.engine.windows.at_block(SEGMENT * STEPS).result()
    return (time.process_time() - start) / (SEGMENT * BLOCK_S)


def stages(emulator: Emulator, opened: Geometry, repeats: int) -> dict[str, float]:
    """Time each stage over the same runs of blocks of a window: seconds per simulated second."""
    unit, sensor = emulator.parts.units[0], emulator.scenario.sensor
    mode, model = ReturnMode(sensor.return_mode), SensorModel(sensor.model)
    head, poses_at, has_width = unit.head, unit.motion.poses_at, unit.beam.has_width
    together = unit.beam.together
    firsts, count = range(0, SEGMENT * BLOCK, SEGMENT * BLOCK // RUNS), together * BLOCK
    times = [head.times_ns(n, count).reshape(-1) for n in firsts]
    poses = [poses_at(t_ns) for t_ns in times]
    near_m, far_m = head.beams.near_m, sensor.max_range_m

    def aim() -> list[Firings]:
        still = zip(firsts, poses, strict=True)
        return [head.aim(n, count, lambda _t, p=p: p, beam_axis=has_width) for n, p in still]

    firings = aim()

    def cast(reach_m: float) -> list[Hits]:
        return [opened.cast(f, near_m, reach_m, unit.beam) for f in firings]

    hits = cast(far_m)

    def vary() -> None:  # once more at each repeat
        for f, h in zip(firings, hits, strict=True):
            add_texture(f, h, opened.surfaces, emulator.parts.world.seed)

    def find() -> list[Returns]:
        met = zip(firings, hits, strict=True)
        return [detect(f, h, opened.surfaces, unit.detector, truth=False) for f, h in met]

    returns = find()
    work: dict[str, Callable[[], object]] = {
        "poses": lambda: [poses_at(t_ns) for t_ns in times],
        "aim": aim,
        NEAR: lambda: cast(min(far_m, 0.999 * emulator.parts.world.near_m)),  # no ray goes on into the medium
        CAST: lambda: cast(far_m),
        "texture": vary,
        "detect": find,
        "pack": lambda: [pack_data(r, mode, model, 0) for r in returns],
    }
    return {name: best(do, repeats) / (RUNS * together * BLOCK_S) for name, do in work.items()}


def stage_table(scene: str, repeats: int) -> Table:
    """Measure the stages."""
    cost: dict[str, dict[str, float]] = {}
    for name, own in SETTINGS.items():
        emulator = Emulator(load(scene, own), threads=2)
        opening, opened = opening_s(emulator), emulator.engine.windows.at_block(0).result()
        cost[name] = stages(emulator, opened, repeats) | {"open windows": opening}
    trees = np.unique(opened.surfaces["instance"][opened.surfaces["semantic"] == Semantic.TREE])
    title = f"{scene}, {len(trees)} trees and saplings in reach, processor s per s"
    table = Table("stage", *cost, title=title, box=MARKDOWN)
    for stage in cost["default"]:
        table.add_row(stage, *(f"{column[stage]:.4f}" for column in cost.values()))
    # `aim` is timed without its poses, and `cast, near` is a part of `cast`.
    sums = (sum(s for stage, s in column.items() if stage != NEAR) for column in cost.values())
    table.add_row("sum", *(f"{total:.4f}" for total in sums))
    return table
