"""Verbs that write files of a run, a scene or a capture: record, truth, points, decode, bag, images and dataset."""

import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack, nullcontext, redirect_stdout
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import AsJson, CaptureFile, UnitName, WhichClock
from vlp16emu.cli.printer import finish, size
from vlp16emu.cli.terminal import Progress, make_emulator, running, stop_on_ctrl_c
from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.options import DatasetOptions, ImageOptions, PointOptions, TrajectoryErrors
from vlp16emu.options import Option, options_of
from vlp16emu.run.options import BagOptions, RecordOptions, Span, TruthPackets, TruthRate, TruthReturns, TruthTo

if TYPE_CHECKING:
    from vlp16emu.packets import CaptureReader, PointFrame, Summary


def record(
    scene: args.SceneName,
    out: Annotated[
        str,
        Option(
            "File to write, classic pcap (.pcap, .cap, .dump or no ending); overwritten if it exists. - is standard output; the report "
            "then goes to stderr. With .mcap (ROS 2), .bag (ROS 1), or a slash at its end (new folder, ROS 2) a bag, with the truth in it.",
            name="OUT",
        ),
    ],
    options: RecordOptions,
    *,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    threads: args.Threads = 0,
    audit: args.Audit = True,
    as_json: args.AsJson = False,
) -> None:
    """Record a scene into a pcap file, or a bag.

    The file holds data and position packets in order of sending, in the frames of a real sensor and
    stamped with simulated time. Ctrl-C ends it early and leaves a valid file. Until its end it is
    OUT.xxxxxxxx.part, which after kill -9 holds all whole packets.
    """
    from vlp16emu.output import STDOUT

    if Path(out) == STDOUT and sys.stdout is None:
        raise OutputError("standard output", "closed", "a file or a pipe")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, settings, ideal=ideal, threads=threads, audit=audit)
    with running(emulator, "recording", options) as hooks:
        recording = emulator.record(out, **vars(options), **hooks)
    recording = replace(recording, wall_s=time.perf_counter() - began_s)  # of the whole command
    with redirect_stdout(sys.stderr) if Path(out) == STDOUT else nullcontext():
        finish(recording, as_json=as_json)


def truth(
    scene: args.SceneName,
    folder: Annotated[Path, Option("Folder to write: new, empty, or of an earlier run.", name="DIR")],
    span: Span,
    *,
    rate_hz: TruthRate = TruthTo.rate_hz,
    per_packet: TruthPackets = TruthTo.per_packet,
    per_return: TruthReturns = TruthTo.per_return,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    as_json: args.AsJson = False,
) -> None:
    """Write the ground truth of a run without casting its pulses: trajectory, IMU, GNSS, rig, scenario.

    The files are those of `record --truth` over the same span, byte for byte. Ctrl-C ends them early.
    """
    emulator = make_emulator(scene, settings, ideal=ideal)
    from vlp16emu.extras.truth.truth import write_truth

    with running(emulator, "writing", span) as hooks:
        simulated_s = write_truth(emulator, TruthTo(folder, rate_hz, per_packet, per_return), **vars(span), **hooks)
    sizes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    found = {"folder": folder, "simulated_s": simulated_s, "interrupted": hooks["stop"].is_set()}
    finish(found | ({"files": sizes} if as_json else {name: size(n) for name, n in sizes.items()}), as_json=as_json)


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
    if trajectory is None:
        expected = "--trajectory DIR or FILE.tum; `vlp16emu decode` leaves points in the sensor"
        raise InputError(str(capture), "is a capture", expected)
    from vlp16emu.extras.clouds.cloud import label_scheme
    from vlp16emu.extras.clouds.deskew import CaptureTruth, Trajectory, write_deskewed

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


def decode(
    file: CaptureFile,
    *,
    out: Annotated[
        Path | None, Option("Write the points too: .npz, .ply, .csv, .pcd, .las or .laz by its suffix.", "FILE")
    ] = None,
    unit: UnitName = None,
    clock: WhichClock = None,
    frame: Annotated[
        str,
        Option(
            "Axes of the points: x forward, y left, as ROS drivers have them (sensor); or x right, y forward, as the manual "
            "of Velodyne and VeloView do (manual).",
            words=("sensor", "manual"),
        ),
    ] = "sensor",
    model: Annotated[
        str | None,
        Option(
            "What a unit from before release is, whose packets name an HDL-32E (product 0x21).",
            words=("vlp-16", "puck-hi-res"),
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Decode a capture by the formulas of the sensor's manual.

    Works on recordings of real sensors too. Points are in metres in the sensor: x forward (azimuth 0), y left,
    z up, unless --frame chooses other axes. Pulses without return become no points. Ctrl-C and a broken packet leave a
    valid file with the points before.
    """
    from vlp16emu.packets import CaptureReader, chosen_unit, frame_named, packet_clock
    from vlp16emu.types import SensorModel

    axes, chosen = frame_named(frame, where="--frame"), chosen_unit(file, unit, where="--unit")
    product = SensorModel(model) if model else None
    stamps = packet_clock(file, chosen, clock, where="--clock")
    with CaptureReader(file, chosen, axes, product, stamps) as reader, stop_on_ctrl_c() as stop:
        _read(reader, file, out, axes, stop)
    interrupted = stop.is_set()
    title = f"{file}, interrupted" if interrupted else str(file)
    tree = {"file": file, "out": out} if as_json else {"wrote": out}
    finish(tree | _tree(reader.summary) | {"interrupted": interrupted}, title, as_json=as_json)


def _read(reader: "CaptureReader", file: Path, out: Path | None, axes: "PointFrame", stop: Event) -> None:
    """Read a capture to its end or until `stop`, and write its points if `out` is given."""
    with ExitStack() as stack:
        writer = None
        if out:
            from vlp16emu.extras.clouds.cloud import CAPTURE_COLUMNS, CloudAbout, capture_comments, point_file

            about = CloudAbout(capture_comments(axes, f"{reader.clock.clock}'s"))
            opened = point_file(out, CAPTURE_COLUMNS, about, where=f"--out {out}", inputs=[file])
            writer = stack.enter_context(opened)
        for chunk in reader.points():
            if writer:
                writer.write(chunk.columns)
            if stop.is_set():
                break


_DECODED = (
    *("model", "return_mode", "rpm", "packets", "position_packets", "other_datagrams", "points", "no_returns", "scans"),
    *("records_per_scan", "range_m", "start_utc", "duration_s", "clock", "host_ahead_s", "gps", "cut", "repeats"),
)


def _tree(summary: "Summary") -> dict[str, Any]:
    gps, ranges_m = summary.gps, summary.range_m
    start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=summary.first_stamp_ns // 1000)
    own = {
        "rpm": round(summary.rpm, 2),
        "range_m": ranges_m and dict(zip(("min", "median", "max"), (round(r, 3) for r in ranges_m), strict=True)),
        "start_utc": start.isoformat().replace("+00:00", "Z"),
        "host_ahead_s": round(summary.host_ahead_s, 6),
        "gps": gps and {"pps": gps.pps.name.lower(), "sentence": gps.sentence.decode("ascii", "replace").strip()},
    }
    return {name: own[name] if name in own else getattr(summary, name) for name in _DECODED}


def bag(
    file: CaptureFile,
    out: Annotated[
        Path,
        Option(
            "Bag to write: .mcap (ROS 2), .bag (ROS 1), or a new folder without ending (ROS 2, SQLite).", name="OUT"
        ),
    ],
    options: BagOptions,
    *,
    truth: Annotated[
        Path | None,
        Option(
            "Folder of truth of the same run: odometry, transforms, inertial unit and fixes go into the bag.", "DIR"
        ),
    ] = None,
    unit: UnitName = None,
    clock: WhichClock = None,
    as_json: AsJson = False,
) -> None:
    """Write a capture as a bag for ROS 1 or ROS 2, without ROS.

    Works on recordings of real sensors too. Topics and frames are those of the velodyne driver and of REP 105. All sensors are
    written unless --unit names one. Ctrl-C ends it early and leaves a valid bag.
    """
    from vlp16emu.extras.bag import write_bag

    with stop_on_ctrl_c() as stop:
        result = write_bag(file, out, truth, unit=unit, clock=clock, options=options, stop=stop)
    finish(result, as_json=as_json)


def images(
    scene: args.SceneName,
    folder: Annotated[Path, Option("Folder, new or empty.", name="OUT")],
    options: ImageOptions,
    *,
    settings: args.Settings = None,
    threads: args.Threads = 0,
    as_json: args.AsJson = False,
) -> None:
    """Write depth, labels and colours of a scene as images, from the place of the sensor.

    They lie on the points of `vlp16emu points` and `record` at the same instant: cameras.json and poses.tum
    say where each point is in the image. PNG, and OpenEXR with exact values. Ctrl-C keeps the images so far.
    """
    emulator = make_emulator(scene, settings, threads=threads)
    from vlp16emu.extras.images.images import write_images

    with running(emulator, "casting", options) as hooks:
        run = write_images(emulator, folder, **vars(options), **hooks)
    finish(run, as_json=as_json)


def dataset(
    spec: Annotated[Path, Option("File that describes the dataset.", name="SPEC.toml")],
    out: Annotated[Path, Option("Folder: new, or of an earlier run.", name="OUT")],
    options: DatasetOptions,
    *,
    as_json: AsJson = False,
) -> None:
    """Make a dataset: stands, seeds, paths and sensors from one file.

    Walks that an earlier run has finished are kept, after a check of their sha256; the others are made.
    OUT/manifest.json names every file with its sha256, and the split of its stand.
    """
    from vlp16emu.extras.dataset import load_spec, make_dataset, walks_of

    walks = walks_of(load_spec(spec), spec.absolute().parent)
    with Progress(sum(walk.scenario.duration_s for walk in walks)) as bar:
        show = lambda done_s: bar.show("making walks", done_s)  # noqa: E731
        result = make_dataset(walks, out, progress=show, **vars(options))
    finish(result, as_json=as_json)
