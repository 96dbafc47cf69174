"""`vlp16emu plan`: what a scene needs, what it leaves out, what a recording takes, and whether a stream keeps up."""

import os
import time
from typing import TYPE_CHECKING

from vlp16emu.cli.arguments import AsJson, Duration, Ideal, NoAudit, SceneName, Settings, Threads
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import count, print_json, print_rows, size, tree_of

if TYPE_CHECKING:
    from vlp16emu.report.plan.geometry import GeometrySize
    from vlp16emu.report.plan.needs import Surroundings
    from vlp16emu.report.plan.run import Measured, Plan, StreamOutlook


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
    workers = threads or os.cpu_count() or 1
    emulator = make_emulator(scene, settings, ideal=ideal, threads=workers, audit=not no_audit)
    _, stop_s = emulator.scenario.span_s(0.0, duration)
    from vlp16emu.report import Spent
    from vlp16emu.report.plan.run import plan_run

    audited = emulator.audit is not None and not emulator.audit.exact
    made = plan_run(emulator, stop_s, workers, Spent(wall_s, cpu_s), scene=scene, audited=audited)
    if as_json:
        print_json(tree_of(made))
    else:
        _print(made)


def _print(plan: "Plan") -> None:
    for title, on in (("has", True), ("leaves out", False)):
        rows = {need.name: need.costs for need in plan.features if need.on is on}
        if rows:
            print_rows(f"{plan.scene} {title}", rows)
    print_rows("in reach", _reach(plan.world))
    print_rows(
        "libraries",
        {
            word: ", ".join(name for name, is_loaded in plan.libraries.items() if is_loaded is on)
            for word, on in (("loaded", True), ("left out", False))
        },
    )
    expected = plan.forecast
    peak = expected.peak_memory_bytes
    print_rows(
        f"`record` of {plan.duration_s:g} s on {plan.threads} threads will take",
        {
            "run time": f"{expected.wall_s:.1f} s, {expected.real_time_factor:.2f} x real time",
            "first packet": f"after {expected.first_packet_s:.1f} s",
            "then": f"{expected.steady_factor:.2f} x real time",
            "processor": f"{expected.cpu_s:.1f} s of all threads",
            "memory": "not reported by this system" if peak is None else f"{size(peak)} at most",
        },
    )
    print_rows("`stream` in real time", _stream_rows(plan.stream))
    print(_how(plan.measured, keeps_up=plan.stream.keeps_up))


def _stream_rows(found: "StreamOutlook") -> dict[str, str]:
    """Write whether a stream keeps up."""
    if not found.keeps_up:
        speed = f"no, {found.real_time_factor:.2f} x real time: packets will be late"
    elif found.real_time_factor < _SCARCE:
        speed = f"yes, {found.real_time_factor:.2f} x real time, with next to nothing left for other programs"
    else:
        speed = f"yes, {found.real_time_factor:.1f} x real time"
    rows = {"keeps up": speed, "sender": f"{found.sender_share:.0%} of a core, accounted for"}
    if found.keeps_up_with:
        rows["to keep up"] = ", or ".join(found.keeps_up_with)
    return rows


def _reach(world: "Surroundings") -> dict[str, str]:
    rows = {}
    for kind, number in world.first_window.items():
        if not number:
            continue
        text = count(number)
        if world.windows > 1:
            text += f"; {count(round(world.mean[kind]))} on average over the walk"
        rows[kind] = text
    rows["species"] = f"{len(world.species)} grown: {', '.join(world.species)}".rstrip(": ")
    rows |= _geometry(world.geometry)
    rows["windows"] = f"{count(world.windows)} over the run, two at a time are kept"
    return rows


def _geometry(held: "GeometrySize") -> dict[str, str]:
    """Write what is cast as faces, and what beyond them is a medium of voxels."""
    faces = f"{count(held.faces)} in {size(held.bytes)}, placed {count(held.placed)}"
    if held.near_m is None:
        return {"faces": f"{faces}, at any range"}
    medium = f"{count(held.voxels)} in {size(held.medium_bytes)}, {count(held.tiles)} tiles"
    return {
        "faces": f"{faces}, within {held.near_m:g} m",
        "voxels": f"{medium}, beyond {held.near_m:g} m",
    }


def _how(measured: "Measured", *, keeps_up: bool) -> str:
    """Say what the figures are from, and what makes a run faster that is too slow to stream."""
    second = measured.second_window.wall_s
    opened = f", the second window in {second:.2f} s" if second else ""
    text = (
        f"Measured now on this machine: {measured.simulated_s:.1f} s of the run in {len(measured.pieces)} pieces"
        f"{opened}; memory is the peak of doing so, the rest extrapolated."
    )
    return text if keeps_up else f"{text}\n{_TOO_SLOW}"
