"""`vlp16emu points`: what a sensor of any kind sees of a scene, or saw in a capture, as points in the world."""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.printer import finish
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.cli.terminal import stop_on_ctrl_c
from vlp16emu.errors import InputError
from vlp16emu.extras.options import PointOptions, TrajectoryErrors
from vlp16emu.options import Option, options_of
from vlp16emu.run.options import TruthTo


def points(
    scene: args.SceneOrCapture,
    out: Annotated[
        Path,
        Option(
            "File to write, .npz, .ply, .csv, .pcd, .las or .laz by its suffix; overwritten if it exists.", name="OUT"
        ),
    ],
    options: PointOptions,
    errors: TrajectoryErrors,
    *,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    trajectory: args.TrajectoryFile = None,
    threads: args.Threads = 0,
    clock: args.WhichClock = None,
    as_json: args.AsJson = False,
) -> None:
    """Write the points of a scene, for a sensor of any beam table, or of a capture with a trajectory.

    Each point is in the world and in the sensor's frame at the instant of its pulse, as a user would
    compute it. No packets are made: ranges are not on their 2 mm grid. Ctrl-C leaves a valid file.
    A capture is put into the world by a trajectory, the true one, an estimate, or one with errors on purpose.
    """
    from vlp16emu.packets.capture import is_capture_name

    of_capture = {one.name: getattr(errors, one.field) != one.default for one in options_of(TrajectoryErrors)}
    if trajectory is not None or is_capture_name(scene):
        spans = {"--duration": options.duration_s, "--start": options.start_s}
        _refuse(spans | {"--set": settings, "--ideal": ideal, "--threads": threads}, f"the capture {scene}", "a scene")
        _deskew(Path(scene), out, trajectory, errors, options, clock=clock, as_json=as_json)
        return
    _refuse(of_capture | {"--clock": clock}, "a scene", "a capture and its --trajectory")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, settings, ideal=ideal, threads=threads)
    from vlp16emu.extras.clouds.points import write_points

    with running(emulator, "scanning", options) as hooks:
        cloud = write_points(emulator, out, **vars(options), **hooks)
    wall_s = time.perf_counter() - began_s  # of the whole command
    finish(replace(cloud, wall_s=wall_s, real_time_factor=cloud.simulated_s / wall_s), as_json=as_json)


def _refuse(options: Mapping[str, object], beside: str, expected: str) -> None:
    for name, value in options.items():
        if value:
            raise InputError(name, f"found beside {beside}", expected)


def _deskew(
    capture: Path,
    out: Path,
    trajectory: Path | None,
    errors: TrajectoryErrors,
    options: PointOptions,
    *,
    clock: str | None,
    as_json: bool,
) -> None:
    """Write the points of a capture."""
    if trajectory is None:
        expected = "--trajectory DIR or FILE.tum; `vlp16emu decode` leaves points in the sensor"
        raise InputError(str(capture), "is a capture", expected)
    from vlp16emu.extras.clouds.deskew import CaptureTruth, Trajectory, write_deskewed
    from vlp16emu.extras.clouds.labels import label_scheme

    way, truth, labels = Trajectory(trajectory, options.unit, errors), None, options.labels
    if options.truth or labels:
        place = TruthTo.of(options.truth_to)
        folder = place.folder if place else trajectory
        if not folder.is_dir():
            expected = "--truth-folder DIR beside it, the folder that `record --truth-returns` has written"
            raise InputError("--labels" if labels else "--truth", "found a trajectory alone", expected)
        truth = CaptureTruth(folder, options.unit, label_scheme(labels, where="--labels") if labels else None)
    with stop_on_ctrl_c() as stop:
        cloud = write_deskewed(capture, out, way, truth, stop=stop, clock=clock)
    finish(cloud, as_json=as_json)
