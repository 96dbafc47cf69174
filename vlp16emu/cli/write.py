"""Verbs that write or show a run, a scene or a capture.

They are truth, points, bag, dataset, picture, images and view.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli.arguments import (
    AsJson,
    CaptureFile,
    EmulatorOptions,
    SceneName,
    SceneOptions,
    SceneOrCapture,
    Settings,
    TrajectoryFile,
    UnitName,
    WhichClock,
)
from vlp16emu.cli.printer import finish, print_json, print_rows, print_table, quantity, size
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
from vlp16emu.trees import Tree
from vlp16emu.units import count_text

if TYPE_CHECKING:
    from viser import ViserServer

    from vlp16emu.extras.dataset import DatasetEstimate, Probe
    from vlp16emu.extras.viewer.editor import OpenScene
    from vlp16emu.run.emulator import Emulator


def truth(
    scene: SceneName,
    folder: Annotated[Path, Option("Folder to write: new, empty, or of an earlier run.", name="DIR")],
    span: Span,
    scene_options: SceneOptions,
    *,
    rate_hz: TruthRate = TruthTo.rate_hz,
    per_packet: TruthPackets = TruthTo.per_packet,
    per_return: TruthReturns = TruthTo.per_return,
    as_json: AsJson = False,
) -> None:
    """Write the ground truth of a run without casting its pulses: trajectory, IMU, GNSS, rig, scenario.

    The files equal byte for byte the files of `record --truth` over the same span. Ctrl-C ends them early.
    """
    emulator = make_emulator(scene, scene_options)
    from vlp16emu.extras.truth.truth import write_truth

    to = TruthTo(folder, rate_hz, per_packet, per_return)
    with running(emulator, "writing", span) as hooks:
        simulated_s = write_truth(emulator, to, **vars(span), **hooks)
    files = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    report: Tree = {"folder": folder, "simulated_s": simulated_s, "interrupted": hooks["stop"].is_set()}
    report |= {"files": files} if as_json else {name: size(length) for name, length in files.items()}
    finish(report, as_json=as_json)


def points(
    scene: SceneOrCapture,
    out: Annotated[
        Path,
        Option(
            "File to write, .npz, .ply, .csv, .pcd, .las or .laz by its suffix; overwritten if it exists.",
            name="OUT",
        ),
    ],
    options: PointOptions,
    emulator_options: EmulatorOptions,
    errors: TrajectoryErrors,
    *,
    trajectory: TrajectoryFile = None,
    clock: WhichClock = None,
    as_json: AsJson = False,
) -> None:
    """Write the points of a scene with any beam table, or of a capture with a trajectory.

    Each point is given in the world and in the sensor's frame at the instant of its pulse, as a user would
    compute it. No packets are made, so ranges are not on their 2 mm grid. Ctrl-C leaves a valid file.
    Points of a capture are placed in the world by a trajectory: the true one, an estimate, or one with errors
    on purpose.
    """
    from vlp16emu.captures.capture import is_capture_name

    if trajectory is not None or is_capture_name(scene):
        of_scenes = {
            "--duration": options.duration_s,
            "--start": options.start_s,
            "--set": emulator_options.settings,
            "--ideal": emulator_options.ideal,
            "--threads": emulator_options.threads,
        }
        _refuse(of_scenes, f"the capture {scene}", "a scene")
        _deskew(Path(scene), out, trajectory, errors, options, clock=clock, as_json=as_json)
        return
    of_captures = {
        "--time-offset": errors.time_offset_s != 0.0,
        "--mount": errors.mount,
        "--drift": errors.drift,
        "--clock": clock,
    }
    _refuse(of_captures, "a scene", "a capture and its --trajectory")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, emulator_options)
    from vlp16emu.extras.clouds.points import write_points

    with running(emulator, "scanning", options) as hooks:
        cloud = write_points(emulator, out, **vars(options), **hooks)
    wall_s = time.perf_counter() - began_s  # of the whole command
    finish(replace(cloud, wall_s=wall_s, real_time_factor=cloud.simulated_s / wall_s), as_json=as_json)


def _refuse(values: Mapping[str, object], beside: str, expected: str) -> None:
    """Raise InputError for the first option that is given; `values` are by name, false if it is not given."""
    for name, value in values.items():
        if value:
            raise InputError(name, f"found beside {beside}", expected)


def _deskew(
    capture: Path,
    out: Path,
    trajectory_file: Path | None,
    errors: TrajectoryErrors,
    options: PointOptions,
    *,
    clock: str | None,
    as_json: bool,
) -> None:
    if trajectory_file is None:
        expected = "--trajectory DIR or FILE.tum, or `vlp16emu decode` for points in the sensor's frame"
        raise InputError(str(capture), "is a capture", expected)
    from vlp16emu.extras.clouds.cloud import label_scheme
    from vlp16emu.extras.clouds.deskew import CaptureTruth, Trajectory, write_deskewed

    trajectory = Trajectory(trajectory_file, options.unit, errors)
    truth = None
    labels = options.labels
    if options.truth or labels:
        truth_to = TruthTo.of(options.truth_to)
        folder = truth_to.folder if truth_to else trajectory_file
        if not folder.is_dir():
            expected = "--truth-folder DIR beside it, the folder that `record --truth-returns` has written"
            raise InputError("--labels" if labels else "--truth", "found a trajectory alone", expected)
        truth = CaptureTruth(folder, options.unit, label_scheme(labels, where="--labels") if labels else None)
    with stop_on_ctrl_c() as stop:
        cloud = write_deskewed(capture, out, trajectory, truth, stop=stop, clock=clock)
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
    105. All sensors are written unless --unit names one. Ctrl-C ends it early and leaves a valid bag.
    """
    from vlp16emu.extras.bag.write import write_bag

    with stop_on_ctrl_c() as stop, Progress(100.0, "reading", unit="%") as bar:
        result = write_bag(
            file,
            out,
            truth,
            images=images,
            unit=unit,
            clock=clock,
            options=options,
            stop=stop,
            progress=partial(bar.show_share, "reading"),
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
        result = make_dataset(walks, out, progress=partial(bar.show, "making walks"), **vars(options))
    finish(result, as_json=as_json)


def _print_estimate(estimate: "DatasetEstimate") -> None:
    pairs = quantity(estimate.kinds, "pair")
    rows = {
        "simulated": _duration(estimate.simulated_s),
        "size": f"{_gigabytes(estimate.bytes)}, {_gigabytes(estimate.free_bytes)} are free",
        "CPU time": _duration(3600 * estimate.cpu_hours),
        "run time": f"{_duration(3600 * estimate.hours)} at least, on {quantity(estimate.cores, 'core')}",
        "measured": f"{len(estimate.probes)} of {pairs} of stand and sensor, on this machine",
    }
    print_rows(f"{count_text(estimate.missing)} of {quantity(estimate.walks, 'walk')} to be made", rows)
    if estimate.probes:
        print()
        head = ["stand and sensor", "measured", "growth, CPU", "CPU per s", "MB per s"]
        print_table([head, *map(_probe_cells, estimate.probes)])


def _probe_cells(probe: "Probe") -> list[str]:
    return [
        f"{probe.stand}, {probe.sensor}",
        f"{probe.measured_s:.3g} s",
        f"{probe.grow_cpu_s:.2f} s",
        f"{probe.cpu_s_per_s:.2f} s",
        f"{probe.bytes_per_s / 1e6:.3f}",
    ]


def _duration(duration_s: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if duration_s < 120:
        return f"{duration_s:.3g} s"
    if duration_s < 7200:
        return f"{duration_s / 60:.3g} min"
    return f"{duration_s / 3600:.4g} h"


def _gigabytes(number_of_bytes: int) -> str:
    """Format a size in GB (10^9 bytes), a smaller one as `size`."""
    return size(number_of_bytes) if number_of_bytes < 1e9 else f"{number_of_bytes / 1e9:.4g} GB"


def picture(
    scene: SceneOrCapture,
    out: Annotated[
        Path,
        Option(
            "File to write: .png, or .gif for a film of the walk; overwritten if it exists.", name="OUT.png"
        ),
    ],
    look: PictureLook,
    span: Span,
    scene_options: SceneOptions,
    *,
    trajectory: TrajectoryFile = None,
    as_json: AsJson = False,
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
            emulator = make_emulator(scene, scene_options).stopped_by(stop)
            source = source_of_scene(emulator, span, Path(scene).stem)
        report = draw_picture(source, out, look, stop)
    finish(report, as_json=as_json)


def images(
    scene: SceneName,
    out: Annotated[Path, Option("Folder to write, new or empty.", name="OUT")],
    options: ImageOptions,
    emulator_options: EmulatorOptions,
    *,
    as_json: AsJson = False,
) -> None:
    """Write what a camera beside the sensor sees: colour, depth, classes and instances.

    The table [camera] of the scene sets lens, mount, size, rate and shutter; without it the camera is at the
    sensor and looks ahead. Intrinsics and poses come as cameras.json, TUM, COLMAP's text model and
    nerfstudio's transforms.json. Ctrl-C keeps the images so far. Needs the extra 'picture'.
    """
    emulator = make_emulator(scene, emulator_options)
    from vlp16emu.extras.camera.folder import write_images

    with running(emulator, "taking images", options) as hooks:
        result = write_images(emulator, out, **vars(options), **hooks)
    finish(result, as_json=as_json)


def view(
    scene: SceneOrCapture,
    *,
    settings: Settings = None,
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
            "Address of this machine to listen on, 0.0.0.0 or :: for all; other machines can then open "
            "the page.",
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

    is_capture = is_capture_name(scene)
    if truth is not None and not is_capture:
        raise InputError("--truth", "found beside a scene", "a capture; a scene knows its own")
    if save is not None and is_capture:
        raise InputError("--save", f"found beside the capture {scene}", "a scene, whose path can be edited")
    with of_extra("viewer", "the page in the browser", "viser", "websockets"):
        from vlp16emu.extras.viewer.page import capture_page, scene_page
    if is_capture:
        with _page_server(host, port) as server:
            capture_page(server, Path(scene), truth, unit).run()
        return
    open_scene = _open_scene(scene, settings or (), save)
    with _page_server(host, port) as server:
        emulator = _emulator_of(open_scene)
        with Progress(0.0):
            page = scene_page(server, emulator, open_scene, unit, radius_m)
        page.run()


@contextmanager
def _page_server(host: str, port: int) -> Iterator["ViserServer"]:
    """Serve the page and print its address."""
    from vlp16emu.extras.viewer.page import guarded_server

    with guarded_server(host, port) as server:
        others = ", for other machines by any address of this one" if is_wildcard(host) else ""
        print(f"{url_of(host, server.get_port())}{others}  Ctrl-C ends it", flush=True)
        yield server


def _open_scene(scene: str, settings: Sequence[str], save: Path | None) -> "OpenScene":
    """Read a scene for the page, and check the file in which it is to be saved."""
    from vlp16emu.extras.viewer.draft import walk_of
    from vlp16emu.extras.viewer.editor import OpenScene
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
    return OpenScene(file, settings, scenario, inputs, save)


def _emulator_of(scene: "OpenScene") -> "Emulator":
    """Return the emulator of a scene, with fewer way points if nobody can walk through all of them."""
    compile_first(scene.scenario.world.kind)
    from vlp16emu.run.emulator import Emulator

    try:
        return Emulator(scene.scenario)
    except TrajectoryError as error:
        return Emulator(scene.walkable(error))
