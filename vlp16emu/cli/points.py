"""`vlp16emu points`: what a sensor of any kind sees of a scene, as points."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import argument, option
from vlp16emu.cli.deskew import Drift, LabelsWanted, MountedAt, TimeOffset, deskew
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.cli.terminal import count, finish, revolutions, size, tree_of
from vlp16emu.errors import InputError

_OF_SCENES = frozenset({"duration", "start", "settings", "ideal", "threads"})
_OF_CAPTURES = frozenset({"mount", "drift", "time_offset"})


def points(
    context: typer.Context,
    scene: args.SceneOrCapture,
    out: Annotated[
        Path,
        argument("OUT", "File to write, .npz, .ply, .csv, .pcd, .las or .laz by its suffix; overwritten if it exists."),
    ],
    *,
    duration: args.Duration = None,
    start: args.Start = 0.0,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    truth: Annotated[
        bool, option("--truth", "Label what each point lies on: class, part, leaf or wood, plant, species.")
    ] = False,
    labels: Annotated[
        str | None,
        option(
            "--labels",
            "Classes as data sets have them: for-instance, digiforests, asprs or semantickitti. Beside them dense numbers of trees, "
            "height above the ground and the viewpoint.",
            "SCHEME",
        ),
    ] = None,
    truth_folder: Annotated[
        Path | None,
        option(
            "--truth-folder",
            "Of a scene: write beside them what `record --truth` writes: trajectory, IMU, GNSS, rig, scenario. Of a capture: read "
            "from there what `record --truth-returns` has written, for --truth and --labels; by default from the folder of --trajectory.",
            "DIR",
        ),
    ] = None,
    unit: args.WhichUnit = 1,
    trajectory: args.TrajectoryFile = None,
    mount: MountedAt = None,
    drift: Drift = None,
    time_offset: TimeOffset = 0.0,
    threads: args.Threads = 0,
    as_json: args.AsJson = False,
) -> None:
    """Write the points of a scene, for a sensor of any beam table, or of a capture with a trajectory.

    Each point is in the world and in the sensor's frame at the instant of its pulse, as a user would
    compute it. No packets are made: ranges are not on their 2 mm grid. Ctrl-C leaves a valid file.
    A capture is put into the world by a trajectory, the true one, an estimate, or one with errors on purpose.
    """
    from vlp16emu.packets.capture import is_capture_name

    if trajectory is not None or is_capture_name(scene):
        _refuse(context, _OF_SCENES, f"found beside the capture {scene}", "a scene, or no such option")
        from vlp16emu.extras.clouds.deskew import TrajectoryErrors

        given = {key: value for key, value in (("mount", mount), ("drift", drift)) if value is not None}
        errors, wanted = TrajectoryErrors(time_offset, **given), LabelsWanted(truth, labels, truth_folder)  # type: ignore[arg-type]
        deskew(Path(scene), out, trajectory, errors, wanted, unit=unit, as_json=as_json)
        return
    _refuse(context, _OF_CAPTURES, "found beside a scene", "a capture and its --trajectory")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, settings, ideal=ideal, threads=threads)
    from vlp16emu.extras.clouds.points import write_points

    with running(emulator, "scanning", start, duration) as span:
        cloud = write_points(emulator, out, unit=unit, truth=truth, labels=labels, truth_to=truth_folder, **span)
    wall_s = time.perf_counter() - began_s  # of the whole command
    cloud = replace(cloud, wall_s=wall_s, real_time_factor=cloud.simulated_s / wall_s)
    low, high = cloud.elevation_deg
    returns = ", ".join(f"{count(n)} {name.replace('_', ' ')}" for name, n in cloud.returns.items() if n)
    rows = {
        "scene": f"{cloud.scene}, seed {cloud.seed}",
        "sensor": f"{cloud.sensor}: {cloud.beams} beams from {low:g} to {high:g} deg",
        "rotor": f"{cloud.turn.rpm} rpm",
        "pulses": f"{count(round(cloud.pulses_per_s))} per second",
        "simulated": f"{cloud.simulated_s:.1f} s",
        "revolutions": revolutions([cloud.turn]),
        "points": f"{count(cloud.points)}{f': {returns}' if returns else ''}",
        "labels": "yes" if cloud.truth else "no, see --truth",
        "size": size(cloud.bytes),
        "run time": f"{cloud.wall_s:.1f} s, {cloud.real_time_factor:.2f} x real time",
    }
    finish(tree_of(cloud), cloud.file, rows, as_json=as_json)


def _refuse(context: typer.Context, names: frozenset[str], found: str, expected: str) -> None:
    for given in context.command.params:
        source = context.get_parameter_source(given.name or "")
        if given.name in names and source is not None and source.name == "COMMANDLINE":
            raise InputError(given.opts[0], found, expected)
