"""Verbs that write or show a run, a scene or a capture.

They are truth, points, bag, dataset, picture, images and view.
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import AsJson, CaptureFile, UnitName, WhichClock
from vlp16emu.cli.printer import count, finish, print_json, print_rows, print_table, size
from vlp16emu.cli.terminal import Progress, compile_first, make_emulator, running, stop_on_ctrl_c
from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.extras.options import DatasetOptions, ImageOptions, PictureLook, PointOptions, TrajectoryErrors
from vlp16emu.hosts import LAST_PORT, is_wildcard, url_of
from vlp16emu.libraries import of_extra
from vlp16emu.run.options import (
    BagOptions,
    Option,
    Span,
    TruthPackets,
    TruthRate,
    TruthReturns,
    TruthTo,
    WhichUnit,
)

if TYPE_CHECKING:
    from vlp16emu.extras.dataset import DatasetEstimate, Probe
    from vlp16emu.extras.viewer.editor import Opened
    from vlp16emu.run.emulator import Emulator


def truth(
    scene: args.SceneName,
    folder: Annotated[Path, Option("Folder to write: new, empty, or of an earlier run.", name="DIR")],
    span: Span,
    changes: args.SceneOptions,
    *,
    rate_hz: TruthRate = TruthTo.rate_hz,
    per_packet: TruthPackets = TruthTo.per_packet,
    per_return: TruthReturns = TruthTo.per_return,
    as_json: args.AsJson = False,
) -> None:
    """Write the ground truth of a run without casting its pulses: trajectory, IMU, GNSS, rig, scenario.

    The files equal byte for byte the files of `record --truth` over the same span. Ctrl-C ends them early.
    """
    emulator = make_emulator(scene, changes)
    from vlp16emu.extras.truth.truth import write_truth

    with running(emulator, "writing", span) as hooks:
        simulated_s = write_truth(
            emulator, TruthTo(folder, rate_hz, per_packet, per_return), **vars(span), **hooks
        )
    sizes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    found = {"folder": folder, "simulated_s": simulated_s, "interrupted": hooks["stop"].is_set()}
    finish(
        found | ({"files": sizes} if as_json else {name: size(n) for name, n in sizes.items()}),
        as_json=as_json,
    )


def points(
    scene: args.SceneOrCapture,
    out: Annotated[
        Path,
        Option(
            "File to write, .npz, .ply, .csv, .pcd, .las or .laz by its suffix; overwritten if it exists.",
            name="OUT",
        ),
    ],
    options: PointOptions,
    making: args.EmulatorOptions,
    errors: TrajectoryErrors,
    *,
    trajectory: args.TrajectoryFile = None,
    clock: args.WhichClock = None,
    as_json: args.AsJson = False,
) -> None:
    """Write the points of a scene with any beam table, or of a capture with a trajectory.

    Each point is given in the world and in the sensor's frame at the instant of its pulse, as a user would
    compute it. No packets are made, so ranges are not on their 2 mm grid. Ctrl-C leaves a valid file.
    Points of a capture are placed in the world by a trajectory: the true one, an estimate, or one with errors
    on purpose.
    """
    from vlp16emu.captures.capture import is_capture_name

    if trajectory is not None or is_capture_name(scene):
        spans = {"--duration": options.duration_s, "--start": options.start_s}
        made = {"--set": making.settings, "--ideal": making.ideal, "--threads": making.threads}
        _refuse({**spans, **made}, f"the capture {scene}", "a scene")
        _deskew(Path(scene), out, trajectory, errors, options, clock=clock, as_json=as_json)
        return
    wrong = {"--time-offset": errors.time_offset_s != 0.0, "--mount": errors.mount, "--drift": errors.drift}
    _refuse({**wrong, "--clock": clock}, "a scene", "a capture and its --trajectory")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, making)
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
    if trajectory is None:
        expected = "--trajectory DIR or FILE.tum, or `vlp16emu decode` for points in the sensor's frame"
        raise InputError(str(capture), "is a capture", expected)
    from vlp16emu.extras.clouds.cloud import label_scheme
    from vlp16emu.extras.clouds.deskew import CaptureTruth, Trajectory, write_deskewed

    way = Trajectory(trajectory, options.unit, errors)
    truth = None
    labels = options.labels
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


def bag(
    file: CaptureFile,
    out: Annotated[
        Path,
        Option(
            "Bag to write: .mcap (ROS 2), .bag (ROS 1), or a new folder without ending (ROS 2, SQLite).",
            name="OUT",
        ),
    ],
    options: BagOptions,
    *,
    truth: Annotated[
        Path | None,
        Option(
            "Folder of truth of the same run: odometry, transforms, inertial unit and fixes go into the bag.",
            "DIR",
        ),
    ] = None,
    images: Annotated[
        Path | None,
        Option(
            "Folder of `vlp16emu images` of the same run: its images go into the bag. Needs --truth.", "DIR"
        ),
    ] = None,
    unit: UnitName = None,
    clock: WhichClock = None,
    as_json: AsJson = False,
) -> None:
    """Write a capture as a bag for ROS 1 or ROS 2, without ROS.

    Works on recordings of real sensors too. Topics and frames are named as in the velodyne driver and REP
    105. All sensors
    are written unless --unit names one. Ctrl-C ends it early and leaves a valid bag.
    """
    from vlp16emu.extras.bag.write import write_bag

    with stop_on_ctrl_c() as stop:
        result = write_bag(
            file, out, truth, images=images, unit=unit, clock=clock, options=options, stop=stop
        )
    finish(result, as_json=as_json)


def dataset(
    spec: Annotated[Path, Option("File that describes the dataset.", name="SPEC.toml")],
    out: Annotated[Path, Option("Folder: new, or of an earlier run.", name="OUT")],
    options: DatasetOptions,
    *,
    dry_run: Annotated[
        bool,
        Option(
            "Print number of walks, size and hours, measured in short runs on this machine, and write "
            "nothing.",
            name="--dry-run",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Make a dataset of stands, seeds, paths and sensors from one file.

    Walks that an earlier run has finished are kept after a check of their sha256; the others are made.
    OUT/manifest.json lists every file with its sha256 and the split of its stand. Ctrl-C ends it; the same
    command goes on with the walks that are missing.
    """
    from vlp16emu.extras.dataset import estimate_dataset, load_spec, make_dataset, walks_of

    walks = walks_of(load_spec(spec), spec.absolute().parent)
    if dry_run:
        with Progress(0.0, "measuring"):
            estimate = estimate_dataset(walks, out, **vars(options))
        if as_json:
            print_json(estimate)
        else:
            _print_estimate(estimate)
        return
    with Progress(sum(walk.scenario.duration_s for walk in walks)) as bar:
        show = lambda done_s: bar.show("making walks", done_s)  # noqa: E731
        result = make_dataset(walks, out, progress=show, **vars(options))
    finish(result, as_json=as_json)


def _print_estimate(estimate: "DatasetEstimate") -> None:
    rows = {
        "simulated": _duration(estimate.simulated_s),
        "size": f"{_gigabytes(estimate.bytes)}, {_gigabytes(estimate.free_bytes)} are free",
        "CPU time": _duration(3600 * estimate.cpu_hours),
        "run time": f"{_duration(3600 * estimate.hours)} at least, on {_quantity(estimate.cores, 'core')}",
        "measured": f"{len(estimate.probes)} of {_quantity(estimate.kinds, 'pair')} of stand and sensor, "
        "on this machine",
    }
    print_rows(f"{count(estimate.missing)} of {_quantity(estimate.walks, 'walk')} to be made", rows)
    if estimate.probes:
        print()
        head = ["stand and sensor", "measured", "growth, CPU", "CPU per s", "MB per s"]
        print_table([head, *map(_probe_cells, estimate.probes)])


def _probe_cells(probe: "Probe") -> list[str]:
    times = f"{probe.measured_s:.3g} s", f"{probe.grow_cpu_s:.2f} s", f"{probe.cpu_s_per_s:.2f} s"
    return [f"{probe.stand}, {probe.sensor}", *times, f"{probe.bytes_per_s / 1e6:.3f}"]


def _quantity(number: int, thing: str) -> str:
    return f"{count(number)} {thing}{'' if number == 1 else 's'}"


def _duration(duration_s: float) -> str:
    if duration_s < 120:
        return f"{duration_s:.3g} s"
    return f"{duration_s / 60:.3g} min" if duration_s < 7200 else f"{duration_s / 3600:.4g} h"


def _gigabytes(number_of_bytes: int) -> str:
    return size(number_of_bytes) if number_of_bytes < 1e9 else f"{number_of_bytes / 1e9:.4g} GB"


def picture(
    scene: args.SceneOrCapture,
    out: Annotated[
        Path,
        Option(
            "File to write: .png, or .gif for a film of the walk; overwritten if it exists.", name="OUT.png"
        ),
    ],
    look: PictureLook,
    span: Span,
    changes: args.SceneOptions,
    *,
    trajectory: args.TrajectoryFile = None,
    as_json: args.AsJson = False,
) -> None:
    """Draw what a sensor sees of a scene, or saw in a capture: all of it at a slant, or one revolution.

    Points of whole revolutions of the first sensor are accumulated; a capture without --trajectory shows its
    first revolution in the sensor's frame. A film has a frame for each revolution, ten per second. Needs the
    extra 'picture'.
    """
    from vlp16emu.captures.capture import is_capture_name
    from vlp16emu.extras.viewer.picture import (
        check_suffix,
        draw_picture,
        is_film,
        source_of_capture,
        source_of_scene,
    )

    check_suffix(out)
    if look.from_deg is not None and look.view != "slant":
        raise InputError("--from", f"found beside --view {look.view}", "--view slant")
    is_capture = is_capture_name(scene)
    if trajectory is not None and not is_capture:
        raise InputError("--trajectory", "found beside a scene", "a capture")
    with ExitStack() as stack:
        stop = stack.enter_context(stop_on_ctrl_c())
        stack.enter_context(Progress(0.0, "drawing"))
        if is_capture:
            in_sensor = is_film(out) and look.view != "slant"
            source = source_of_capture(Path(scene), trajectory, span, in_sensor=in_sensor)
        else:
            emulator = make_emulator(scene, changes).stopped_by(stop)
            source = source_of_scene(emulator, span, Path(scene).stem)
        made = draw_picture(source, out, look, stop)
    finish(made, as_json=as_json)


def images(
    scene: args.SceneName,
    out: Annotated[Path, Option("Folder to write, new or empty.", name="OUT")],
    options: ImageOptions,
    making: args.EmulatorOptions,
    *,
    as_json: args.AsJson = False,
) -> None:
    """Write what a camera beside the sensor sees: colour, depth, classes and instances.

    The table [camera] of the scene sets lens, mount, size, rate and shutter; without it the camera is at the
    sensor and looks ahead. Intrinsics and poses come as cameras.json, TUM, COLMAP's text model and
    nerfstudio's transforms.json. Ctrl-C keeps the images so far. Needs the extra 'picture'.
    """
    emulator = make_emulator(scene, making)
    from vlp16emu.extras.camera.folder import write_images

    with running(emulator, "taking images", options) as hooks:
        result = write_images(emulator, out, **vars(options), **hooks)
    finish(result, as_json=as_json)


def view(
    scene: args.SceneOrCapture,
    *,
    settings: args.Settings = None,
    unit: WhichUnit = 1,
    truth: Annotated[
        Path | None,
        Option(
            "For a capture: the folder of `record --truth DIR --truth-returns`, for positions in the "
            "world and labels.",
            "DIR",
        ),
    ] = None,
    save: Annotated[
        Path | None,
        Option(
            "File in which the page saves the scene with the edited path; replaced if it exists.", "FILE.toml"
        ),
    ] = None,
    radius_m: Annotated[
        float, Option("Distance from the path up to which the stand is drawn.", "M", ge=1, le=100)
    ] = 25.0,
    host: Annotated[
        str,
        Option(
            "Address of this machine to listen on, 0.0.0.0 or :: for all; other machines can then open the page.",
            "ADDRESS",
        ),
    ] = "127.0.0.1",
    port: Annotated[int, Option("Port of the page, 0 for any free one.", "N", ge=0, le=LAST_PORT)] = 8016,
) -> None:
    """Show a scene in the browser: the stand, the sweep at any time, and the path of a walk, to be edited.

    Drag way points over the ground; see at once length, run time and packets, and what is in the way; save
    the scene with the new path. For a capture, the page shows its sweeps and marks faulty packets. Needs the
    extra 'viewer'. Ctrl-C ends it.
    """
    from vlp16emu.captures.capture import is_capture_name

    capture = Path(scene) if is_capture_name(scene) else None
    if truth is not None and capture is None:
        raise InputError("--truth", "found beside a scene", "a capture; a scene knows its own")
    if save is not None and capture is not None:
        raise InputError("--save", f"found beside the capture {scene}", "a scene, whose path can be edited")
    with of_extra("viewer", "the page in the browser", "viser", "websockets"):
        from vlp16emu.extras.viewer.page import capture_page, guarded_server, scene_page
    opened = None if capture is not None else _open_scene(scene, settings or (), save)
    with guarded_server(host, port) as server:
        others = ", for other machines by any address of this one" if is_wildcard(host) else ""
        print(f"{url_of(host, server.get_port())}{others}  Ctrl-C ends it", flush=True)
        if opened is None:
            assert capture is not None
            page = capture_page(server, capture, truth, unit)
        else:
            emulator = _emulator_of(opened)
            with Progress(0.0):
                page = scene_page(server, emulator, opened, unit, radius_m)
        page.run()


def _open_scene(scene: str, settings: Sequence[str], save: Path | None) -> "Opened":
    """Read a scene for the page, and check the file in which it is to be saved."""
    from vlp16emu.extras.viewer.draft import walk_of
    from vlp16emu.extras.viewer.editor import Opened
    from vlp16emu.extras.viewer.scene_file import check_place
    from vlp16emu.scenario import find, load, named_files

    scenario = load(scene, settings)
    file = find(scene)
    if scenario.motion.takes_poses:
        raise InputError("motion.kind", "found live", "a scene whose path is known before it runs")
    inputs = [file, *named_files(scenario)]
    if save is not None:
        walk_of(scenario)
        check_place(save, inputs)
    return Opened(file, settings, scenario, inputs, save)


def _emulator_of(opened: "Opened") -> "Emulator":
    """Return the emulator of a scene, with fewer way points if nobody can walk through all of them."""
    compile_first(opened.scenario.world.kind)
    from vlp16emu.run.emulator import Emulator

    try:
        return Emulator(opened.scenario)
    except TrajectoryError as error:
        return Emulator(opened.walkable(error))
