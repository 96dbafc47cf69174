"""`vlp16emu points`: what a sensor of any kind sees of a scene, or saw in a capture, as points in the world."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from vlp16emu.cli import arguments as args
from vlp16emu.cli.printer import finish
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.cli.terminal import stop_on_ctrl_c
from vlp16emu.errors import InputError
from vlp16emu.options import Option
from vlp16emu.run.options import Span, WhichUnit

_MOST_S = 7 * 86_400
_FARTHEST = 1e6
_MOUNT, _DRIFT = "X,Y,Z,ROLL,PITCH,YAW", "EAST,NORTH,UP,YAW"


def _numbers(names: str) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of as many numbers as there are names."""

    def parse(text: str) -> tuple[float, ...]:
        numbers = tuple(map(float, text.split(",")))
        if len(numbers) != len(names.split(",")) or not all(abs(one) <= _FARTHEST for one in numbers):
            raise ValueError(text)
        return numbers

    return parse


def points(
    scene: args.SceneOrCapture,
    out: Annotated[
        Path,
        Option(
            "File to write, .npz, .ply, .csv, .pcd, .las or .laz by its suffix; overwritten if it exists.", name="OUT"
        ),
    ],
    span: Span,
    *,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    truth: Annotated[bool, Option("Label what each point lies on: class, part, leaf or wood, plant, species.")] = False,
    labels: Annotated[
        str | None,
        Option(
            "Classes as data sets have them: for-instance, digiforests, asprs or semantickitti. Beside them dense numbers of trees, "
            "height above the ground and the viewpoint.",
            "SCHEME",
        ),
    ] = None,
    truth_folder: Annotated[
        Path | None,
        Option(
            "Of a scene: write beside them what `record --truth` writes: trajectory, IMU, GNSS, rig, scenario. Of a capture: read "
            "from there what `record --truth-returns` has written, for --truth and --labels; by default from the folder of --trajectory.",
            "DIR",
        ),
    ] = None,
    unit: WhichUnit = 1,
    trajectory: args.TrajectoryFile = None,
    mount: Annotated[
        object | None,
        Option(
            "Of a capture: where the sensor sits on the body of the trajectory, in m and degrees; with the true trajectory a wrong "
            "boresight and lever arm.",
            _MOUNT,
            parse=_numbers(_MOUNT),
            expected=f"the numbers {_MOUNT}",
        ),
    ] = None,
    drift: Annotated[
        object | None,
        Option(
            "Of a capture: let the trajectory drift, in m per minute and degrees per minute from its first pose on.",
            _DRIFT,
            parse=_numbers(_DRIFT),
            expected=f"the numbers {_DRIFT}",
        ),
    ] = None,
    time_offset_s: Annotated[
        float,
        Option(
            "Of a capture: seconds added to the time of a pulse before its pose is looked up.",
            "S",
            ge=-_MOST_S,
            le=_MOST_S,
            shown=False,
        ),
    ] = 0.0,
    clock: args.WhichClock = None,
    threads: args.Threads = 0,
    as_json: args.AsJson = False,
) -> None:
    """Write the points of a scene, for a sensor of any beam table, or of a capture with a trajectory.

    Each point is in the world and in the sensor's frame at the instant of its pulse, as a user would
    compute it. No packets are made: ranges are not on their 2 mm grid. Ctrl-C leaves a valid file.
    A capture is put into the world by a trajectory, the true one, an estimate, or one with errors on purpose.
    """
    from vlp16emu.packets.capture import is_capture_name

    errors = {"--mount": mount, "--drift": drift, "--time-offset": time_offset_s}
    if trajectory is not None or is_capture_name(scene):
        spans = {"--duration": span.duration_s, "--start": span.start_s}
        _refuse(spans | {"--set": settings, "--ideal": ideal, "--threads": threads}, f"the capture {scene}", "a scene")
        _deskew(
            Path(scene), out, trajectory, errors, (truth, labels, truth_folder), unit=unit, clock=clock, as_json=as_json
        )
        return
    _refuse(errors | {"--clock": clock}, "a scene", "a capture and its --trajectory")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, settings, ideal=ideal, threads=threads)
    from vlp16emu.extras.clouds.points import write_points

    with running(emulator, "scanning", span) as hooks:
        asked = {"unit": unit, "truth": truth, "labels": labels, "truth_to": truth_folder}
        cloud = write_points(emulator, out, **asked, **vars(span), **hooks)  # type: ignore[arg-type]
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
    errors: Mapping[str, Any],
    wanted: tuple[bool, str | None, Path | None],
    *,
    unit: int,
    clock: str | None,
    as_json: bool,
) -> None:
    """Write the points of a capture; `wanted` are truth, labels and the folder that they come from."""
    if trajectory is None:
        expected = "--trajectory DIR or FILE.tum; `vlp16emu decode` leaves points in the sensor"
        raise InputError(str(capture), "is a capture", expected)
    from vlp16emu.extras.clouds.deskew import CaptureTruth, Trajectory, TrajectoryErrors, write_deskewed
    from vlp16emu.extras.clouds.labels import label_scheme

    names = {"--mount": "mount", "--drift": "drift", "--time-offset": "time_offset_s"}
    made = TrajectoryErrors(**{names[name]: value for name, value in errors.items() if value})
    way, truth, (is_true, labels, folder) = Trajectory(trajectory, unit, made), None, wanted
    if is_true or labels:
        if not (folder := folder or trajectory).is_dir():
            expected = "--truth-folder DIR beside it, the folder that `record --truth-returns` has written"
            raise InputError("--labels" if labels else "--truth", "found a trajectory alone", expected)
        truth = CaptureTruth(folder, unit, label_scheme(labels, where="--labels") if labels else None)
    with stop_on_ctrl_c() as stop:
        cloud = write_deskewed(capture, out, way, truth, stop=stop, clock=clock)
    finish(cloud, as_json=as_json)
