"""`vlp16emu plan`: what a scene needs and leaves out, and how fast two seconds of it are."""

import os
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

from vlp16emu.cli.arguments import AsJson, Ideal, NoAudit, SceneName, Settings, Threads
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import count, print_json, print_rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from vlp16emu.extras.plan import StreamOutlook, Surroundings

_MEASURED_S = 2.0
_WORDS = {"loaded": True, "left out": False}
_SCARCE = 1.2
"""Speed below which other programs, a driver on the same machine for instance, may make a stream late."""
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
    no_audit: NoAudit = False,
    as_json: AsJson = False,
) -> None:
    """Report what a scene needs and what it leaves out, and measure whether a stream keeps up.

    The first two seconds are recorded into no file, when the world is grown and the kernels are loaded: the speed holds
    for this machine, as busy as it is now. A walk needs a new window of the world every 7 s, which is not in it.
    """
    began_s = time.perf_counter()
    workers = threads or os.cpu_count() or 1
    emulator = make_emulator(scene, settings, ideal=ideal, threads=workers, audit=not no_audit)
    from vlp16emu.extras.plan import libraries, needs, stream_outlook, surroundings

    emulator.record(os.devnull, duration_s=min(0.1, emulator.scenario.duration_s))
    started_s = time.perf_counter() - began_s
    measured = emulator.record(os.devnull, duration_s=min(_MEASURED_S, emulator.scenario.duration_s))
    audited, engine = measured.audit is not None and not measured.audit.exact, emulator.engine
    features, world, loaded = needs(engine, audited=audited), surroundings(engine), libraries()
    stream = stream_outlook(engine, measured.real_time_factor, workers)
    figures = {
        "started_s": started_s,
        "simulated_s": measured.simulated_s,
        "wall_s": measured.wall_s,
        "real_time_factor": measured.real_time_factor,
    }
    if as_json:
        tree = {"scene": scene, "seed": emulator.scenario.seed, "threads": workers, "libraries": loaded}
        parts = {"world": asdict(world), "measured": figures, "stream": asdict(stream)}
        print_json({**tree, "features": [asdict(need) for need in features], **parts})
        return
    for title, on in (("has", True), ("leaves out", False)):
        if rows := {need.name: need.costs for need in features if need.on is on}:
            print_rows(f"{scene} {title}", rows)
    _print_world(world, loaded)
    speed = f"{measured.simulated_s:g} s in {measured.wall_s:.1f} s, {measured.real_time_factor:.2f} x real time"
    start = {"start": f"{started_s:.1f} s", "record": speed}
    print_rows(f"measured now, on {workers} threads", start | _stream_rows(stream))
    if not stream.keeps_up:
        print(_TOO_SLOW)


def _print_world(world: "Surroundings", loaded: "Mapping[str, bool]") -> None:
    reach = {kind: count(number) for kind, number in world.placed.items() if number}
    species = f"{len(world.species)} grown: {', '.join(world.species)}".rstrip(": ")
    print_rows("in reach", {**reach, "species": species})
    of = {word: [name for name, is_loaded in loaded.items() if is_loaded is on] for word, on in _WORDS.items()}
    print_rows("libraries", {word: ", ".join(names) for word, names in of.items()})


def _stream_rows(found: "StreamOutlook") -> dict[str, str]:
    """Write whether a stream keeps up."""
    if not found.keeps_up:
        speed = f"no, {found.real_time_factor:.2f} x real time: packets will be late"
    elif found.real_time_factor < _SCARCE:
        speed = f"yes, {found.real_time_factor:.2f} x real time, with next to nothing left for other programs"
    else:
        speed = f"yes, {found.real_time_factor:.1f} x real time"
    rows = {"stream keeps up": speed, "sender": f"{found.sender_share:.0%} of a core, accounted for"}
    return rows | ({"to keep up": ", or ".join(found.keeps_up_with)} if found.keeps_up_with else {})
