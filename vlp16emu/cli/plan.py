"""`vlp16emu plan`: what a scene needs and leaves out, and how fast two seconds of it are."""

import os
import time
from typing import Any

from vlp16emu.cli.arguments import AsJson, Audit, Ideal, SceneName, Settings, Threads
from vlp16emu.cli.printer import print_json, print_rows, rows_of
from vlp16emu.cli.start import make_emulator

_MEASURED_S = 2.0
_TOO_SLOW = (
    "Fewer single leaves (world.near_m) and fewer rays (beam.model, beam.target_m) are faster too; "
    "`vlp16emu accuracy` reports their errors."
)


def plan(
    scene: SceneName,
    *,
    settings: Settings = None,
    ideal: Ideal = False,
    threads: Threads = 0,
    audit: Audit = True,
    as_json: AsJson = False,
) -> None:
    """Report what a scene needs and what it leaves out, and measure whether a stream keeps up.

    The first two seconds are recorded into no file, when the world is grown and the kernels are loaded: the speed holds
    for this machine, as busy as it is now. A walk needs a new window of the world every 7 s, which is not in it.
    """
    began_s = time.perf_counter()
    workers = threads or os.cpu_count() or 1
    emulator = make_emulator(scene, settings, ideal=ideal, threads=workers, audit=audit)
    from vlp16emu.extras.plan import libraries, needs, stream_outlook, surroundings

    emulator.record(os.devnull, duration_s=min(0.1, emulator.scenario.duration_s))
    started_s = time.perf_counter() - began_s
    measured = emulator.record(os.devnull, duration_s=min(_MEASURED_S, emulator.scenario.duration_s))
    audited, engine = measured.audit is not None and not measured.audit.exact, emulator.engine
    stream = stream_outlook(engine, measured.real_time_factor, workers)
    tree: dict[str, Any] = {
        "scene": scene,
        "seed": emulator.scenario.seed,
        "threads": workers,
        "libraries": libraries(),
        "features": needs(engine, audited=audited),
        "world": surroundings(engine),
        "measured": {
            "started_s": started_s,
            "simulated_s": measured.simulated_s,
            "wall_s": measured.wall_s,
            "real_time_factor": measured.real_time_factor,
        },
        "stream": stream,
    }
    if as_json:
        print_json(tree)
        return
    for title, on in (("has", True), ("leaves out", False)):
        print_rows(f"{scene} {title}", {need.name: need.costs for need in tree["features"] if need.on is on})
    print_rows("in reach", rows_of(tree["world"]))
    print_rows("libraries", {name: "loaded" if on else "left out" for name, on in tree["libraries"].items()})
    print_rows(f"measured now, on {workers} threads", rows_of(tree["measured"]))
    print_rows("stream", rows_of(stream))
    if not stream.keeps_up:
        print(_TOO_SLOW)
