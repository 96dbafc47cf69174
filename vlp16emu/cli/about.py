"""Verbs about scenes and this machine: scenes, schema, plan, doctor and cache."""

import os
import time
from typing import Annotated, Any

import typer

from vlp16emu.cli.arguments import AsJson, RunOptions, SceneName
from vlp16emu.cli.printer import count, print_json, print_rows, rows_of, size
from vlp16emu.cli.terminal import compile_first, make_emulator
from vlp16emu.errors import InputError
from vlp16emu.options import Option


def scenes(*, as_json: AsJson = False) -> None:
    """List the scenes that can be called by name.

    They come with the program; those in the folder that the variable VLP16EMU_SCENES names come first.
    """
    from vlp16emu.scenario import load, scene_files

    known = {name: (load(str(path)), path) for name, path in scene_files().items()}
    if not as_json:
        print_rows("scenes", {name: f"{s.duration_s:g} s  {s.title}" for name, (s, _) in known.items()})
        return
    rows = [
        {"name": name, "title": s.title, "duration_s": s.duration_s}
        | {"motion": s.motion.kind, "world": s.world.kind, "file": path}
        for name, (s, path) in known.items()
    ]
    print_json({"scenes": rows})


def schema() -> None:
    """Print the JSON Schema of the scene file.

    Editors that know TOML complete keys and show errors with it.
    """
    from vlp16emu.scenario import schema as scene_schema

    print_json(scene_schema())


_MEASURED_S = 2.0
_TOO_SLOW = (
    "Fewer single leaves (world.near_m) and fewer rays (beam.model, beam.target_m) are faster too; "
    "`vlp16emu accuracy` reports their errors."
)


def plan(scene: SceneName, making: RunOptions, *, as_json: AsJson = False) -> None:
    """Report what a scene needs and what it leaves out, and measure whether a stream keeps up.

    The first two seconds are recorded into no file, when the world is grown and the kernels are loaded: the speed holds
    for this machine, as busy as it is now. A walk needs a new window of the world every 7 s, which is not in it.
    """
    began_s = time.perf_counter()
    emulator = make_emulator(scene, making)
    from vlp16emu.extras.plan import libraries, needs, stream_outlook, surroundings

    emulator.record(os.devnull, duration_s=min(0.1, emulator.scenario.duration_s))
    started_s = time.perf_counter() - began_s
    measured = emulator.record(os.devnull, duration_s=min(_MEASURED_S, emulator.scenario.duration_s))
    audited, engine = measured.audit is not None and not measured.audit.exact, emulator.engine
    stream = stream_outlook(emulator.scenario, measured.real_time_factor)
    tree: dict[str, Any] = {
        "scene": scene,
        "seed": emulator.scenario.seed,
        "threads": engine.threads,
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
    print_rows(f"measured now, on {engine.threads} threads", rows_of(tree["measured"]))
    print_rows("stream", rows_of(stream))
    if not stream["keeps_up"]:
        print(_TOO_SLOW)


def doctor(*, as_json: AsJson = False) -> None:
    """Check this machine: cores, kernels, Embree, ports, rights, clock, wake-ups, buffers, extras, disk.

    Each row is ok, a warning if some runs will suffer, or a problem if some will fail, with what mends it. The
    exit code is 1 if there is a problem. Wake-ups are measured now, beside all that this machine is doing.
    """
    from vlp16emu.extras.doctor import Condition, all_checks

    checks = list(all_checks())
    counts = {finding.value: sum(check.finding is finding for check in checks) for finding in Condition}
    if as_json:
        print_json({"checks": checks, **counts})
    else:
        mends = [f"; {check.mend}" if check.mend else "" for check in checks]
        pairs = zip(checks, mends, strict=True)
        print_rows("this machine", {one.name: f"{one.finding:<7}  {one.found}{mend}" for one, mend in pairs})
    if counts[Condition.PROBLEM]:
        raise typer.Exit(1)


def cache(
    *,
    clear: Annotated[bool, Option("Remove all of it; files that are not ours stay where they are.")] = False,
    compile_all: Annotated[
        bool, Option("Compile the kernels of all runs that are not there, for images and CI.", name="--compile")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show what is kept on disk from run to run, and where.

    That is compiled kernels and what worlds were grown into. A run without them takes longer to start,
    and gives the same bytes. VLP16EMU_CACHE_DIR names another folder for worlds (`off` for none),
    VLP16EMU_CACHE_MB how much they may take, NUMBA_CACHE_DIR another one for kernels.
    """
    from vlp16emu.kernels.cache import user_kernels
    from vlp16emu.store import user_store

    if clear and compile_all:
        raise InputError("--compile", "found --clear", "one of both")
    if compile_all:
        compile_first(None)
    tree: dict[str, Any] = {"cleared": clear}
    rows = {}
    for name, kept in ("worlds", user_store()), ("kernels", user_kernels()):
        files, used = kept.clear() if clear else kept.kept()
        folder = str(kept.folder) if kept.folder else None
        tree[name] = {"folder": folder, "files": files, "bytes": used, "most_bytes": kept.most_bytes}
        limit = "" if clear else f" of at most {size(kept.most_bytes)}"
        rows[name] = f"{count(files)} files, {size(used)}{limit}, in {folder or 'no folder: nothing is kept'}"
    if as_json:
        print_json(tree)
    else:
        print_rows("removed" if clear else "kept on disk", rows)
