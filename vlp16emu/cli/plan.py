"""`vlp16emu plan`: what a scene needs, what it leaves out, what a recording takes, and whether a stream keeps up."""

import os
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from vlp16emu.cli.arguments import AsJson, Duration, Ideal, NoAudit, SceneName, Settings, Threads
from vlp16emu.cli.output import count, print_json, print_rows, size
from vlp16emu.cli.start import make_emulator, starting

if TYPE_CHECKING:
    from vlp16emu.cli.trial import Trial
    from vlp16emu.emulator import Emulator

__all__ = ["plan"]

_SENT_S = 0.4
"""Of packets that are sent, to no other program, in order to measure what sending takes."""
_SCARCE = 1.2
"""Speed below which other programs, a driver on the same machine for instance, may make a stream late."""
_TOO_SLOW = (
    "Fewer single leaves (world.near_m) and fewer rays (beam.model, beam.target_m) are faster too; "
    "`vlp16emu accuracy` reports their errors."
)


def plan(
    scene: SceneName,
    *,
    duration: Duration = None,
    settings: Settings = None,
    ideal: Ideal = False,
    threads: Threads = 0,
    no_audit: NoAudit = False,
    as_json: AsJson = False,
) -> None:
    """Report what a scene needs, what a recording takes, and whether a stream keeps up.

    Opens the first two windows of the world, carries out short pieces of the run as `record` does, and
    extrapolates: figures hold for this machine, as busy as it is now.
    """
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    with starting():
        workers = threads or os.cpu_count() or 1
        emulator = make_emulator(scene, settings, ideal=ideal, threads=workers, audit=not no_audit)
        scenario = emulator.scenario
        _, stop_s = scenario.span_s(0.0, duration, where="--start")
        from vlp16emu.cli.needs import libraries, needs, surroundings
        from vlp16emu.cli.trial import try_out
        from vlp16emu.report import Spent
    emulator.packets(0.0, stop_s)  # checks the span
    trial = try_out(emulator, stop_s, workers, Spent(wall_s, cpu_s))
    loaded = libraries()
    tree: dict[str, Any] = {"scene": scene, "title": scenario.title, "seed": scenario.seed}
    tree |= {"duration_s": stop_s, "threads": workers}
    tree |= {"features": [asdict(need) for need in needs(emulator)]}
    tree |= {"world": surroundings(emulator, trial.windows), "libraries": loaded}
    tree |= {"forecast": _forecast(trial, stop_s, workers), "measured": _measured(trial)}
    tree |= {"stream": _stream(emulator, tree["forecast"]["steady_factor"], stop_s, workers)}
    if as_json:
        print_json(tree)
    else:
        _print(tree)


def _forecast(trial: "Trial", stop_s: float, workers: int) -> dict[str, Any]:
    """Foretell the whole run, in the types of JSON."""
    from vlp16emu.report import forecast

    told = forecast(
        until_first_packet=trial.until_first_packet,
        pieces=trial.pieces,
        windows=trial.windows - 1,
        per_window=trial.second_window,
        simulated_s=stop_s,
        spare=max((os.cpu_count() or 1) / workers, 1.0),
    )
    first_s = trial.until_first_packet.wall_s
    return asdict(told) | {"first_packet_s": first_s, "peak_memory_bytes": trial.peak_bytes}


def _stream(emulator: "Emulator", engine_speed: float, stop_s: float, workers: int) -> dict[str, Any]:
    """Say whether `stream` keeps up in real time, in the types of JSON."""
    from vlp16emu.report.keeping_up import settings_that_keep_up, speed_beside_sender
    from vlp16emu.sinks import sending_share

    share = sending_share(list(emulator.packets(0.0, min(_SENT_S, stop_s))))
    speed = speed_beside_sender(engine_speed, share, workers, os.cpu_count() or 1)
    keeps_up = speed >= 1.0
    return {
        "keeps_up": keeps_up,
        "real_time_factor": speed,
        "sender_share": share,
        "keeps_up_with": [] if keeps_up else settings_that_keep_up(emulator.scenario, speed, 1.0),
    }


def _measured(trial: "Trial") -> dict[str, Any]:
    """Put what was measured into the types of JSON."""
    return {
        "simulated_s": sum(piece.simulated_s for piece in trial.pieces),
        "pieces": [asdict(piece) for piece in trial.pieces],
        "second_window": asdict(trial.second_window),
    }


def _print(tree: dict[str, Any]) -> None:
    """Print the plan for people."""
    world, told = tree["world"], tree["forecast"]
    for title, on in (("has", True), ("leaves out", False)):
        rows = {row["name"]: row["costs"] for row in tree["features"] if row["on"] is on}
        if rows:
            print_rows(f"{tree['scene']} {title}", rows)
    print_rows("in reach", _reach(world))
    loaded = tree["libraries"]
    print_rows(
        "libraries",
        {
            word: ", ".join(name for name, is_loaded in loaded.items() if is_loaded is on)
            for word, on in (("loaded", True), ("left out", False))
        },
    )
    peak = told["peak_memory_bytes"]
    print_rows(
        f"`record` of {tree['duration_s']:g} s on {tree['threads']} threads will take",
        {
            "run time": f"{told['wall_s']:.1f} s, {told['real_time_factor']:.2f} x real time",
            "first packet": f"after {told['first_packet_s']:.1f} s",
            "then": f"{told['steady_factor']:.2f} x real time",
            "processor": f"{told['cpu_s']:.1f} s of all threads",
            "memory": "not told by this system" if peak is None else f"{size(peak)} at most",
        },
    )
    print_rows("`stream` in real time", _stream_rows(tree["stream"]))
    _print_how(tree)


def _stream_rows(found: dict[str, Any]) -> dict[str, str]:
    """Write whether a stream keeps up."""
    if not found["keeps_up"]:
        speed = f"no, {found['real_time_factor']:.2f} x real time: packets will be late"
    elif found["real_time_factor"] < _SCARCE:
        speed = (
            f"yes, {found['real_time_factor']:.2f} x real time, with next to nothing left for other programs"
        )
    else:
        speed = f"yes, {found['real_time_factor']:.1f} x real time"
    rows = {"keeps up": speed, "sender": f"{found['sender_share']:.0%} of a core, accounted for"}
    if found["keeps_up_with"]:
        rows["to keep up"] = ", or ".join(found["keeps_up_with"])
    return rows


def _reach(world: dict[str, Any]) -> dict[str, str]:
    """Write what stands in reach of the sensor."""
    rows = {}
    for kind, number in world["first_window"].items():
        if not number:
            continue
        text = count(number)
        if world["windows"] > 1:
            text += f"; {count(round(world['mean'][kind]))} on average over the walk"
        rows[kind] = text
    rows["species"] = f"{len(world['species'])} grown: {', '.join(world['species'])}".rstrip(": ")
    rows |= _geometry(world["geometry"])
    rows["windows"] = f"{count(world['windows'])} over the run, of which two at a time are kept"
    return rows


def _geometry(held: dict[str, Any]) -> dict[str, str]:
    """Write what is cast as faces, and what beyond them is a medium of voxels."""
    faces = f"{count(held['faces'])} in {size(held['bytes'])}, placed {count(held['placed'])}"
    if held["near_m"] is None:
        return {"faces": f"{faces}, at any range"}
    medium = f"{count(held['voxels'])} in {size(held['medium_bytes'])}, {count(held['tiles'])} tiles"
    return {
        "faces": f"{faces}, within {held['near_m']:g} m",
        "voxels": f"{medium}, beyond {held['near_m']:g} m",
    }


def _print_how(tree: dict[str, Any]) -> None:
    """Say where the figures are from."""
    measured = tree["measured"]
    second = measured["second_window"]["wall_s"]
    opened = f", the second window in {second:.2f} s" if second else ""
    print(
        f"Measured now on this machine: {measured['simulated_s']:.1f} s of the run in {len(measured['pieces'])} pieces"
        f"{opened}; memory is the peak of doing so, the rest extrapolated."
    )
    if not tree["stream"]["keeps_up"]:
        print(_TOO_SLOW)
