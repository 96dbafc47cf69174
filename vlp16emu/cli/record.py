"""Verbs of the core, which work without forests and extras: record and decode."""

import sys
import time
from contextlib import ExitStack, nullcontext, redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli.arguments import AsJson, CaptureFile, RunOptions, SceneName, UnitName, WhichClock
from vlp16emu.cli.printer import finish, members
from vlp16emu.cli.terminal import Progress, make_emulator, running, stop_on_ctrl_c
from vlp16emu.errors import CaptureError, InputError, OutputError
from vlp16emu.run.options import Option, RecordOptions

if TYPE_CHECKING:
    from vlp16emu.captures import CaptureReader
    from vlp16emu.packets import PointFrame

_BLOCK_PACKETS = 250  # whose points are written at once: 6 MB, which stay in the processor's cache


def record(
    scene: SceneName,
    out: Annotated[
        str,
        Option(
            "File to write, classic pcap (.pcap, .cap, .dump or no ending); overwritten if it exists. - "
            "is standard output; the report then goes to stderr. With .mcap (ROS 2), .bag (ROS 1), or a "
            "slash at its end (new folder, ROS 2) a bag, with the truth in it.",
            name="OUT",
        ),
    ],
    options: RecordOptions,
    emulator_options: RunOptions,
    *,
    as_json: AsJson = False,
) -> None:
    """Record a scene into a pcap file, or a bag.

    The file holds data and position packets in order of sending, in the frames of a real sensor and stamped
    with simulated time. Ctrl-C ends it early and leaves a valid file, before the first packet none. While it
    is written, its name is OUT.xxxxxxxx.part; after kill -9 that file holds all complete packets.
    """
    from vlp16emu.output import STDOUT

    is_stdout = Path(out) in (STDOUT, Path("/dev/stdout"))
    if is_stdout and sys.stdout is None:
        raise OutputError("standard output", "closed", "a file or a pipe")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, emulator_options)
    with running(emulator, "recording", options) as hooks:
        recording = emulator.record(out, **vars(options), **hooks)
    wall_s = time.perf_counter() - began_s  # of the whole command
    recording = replace(recording, wall_s=wall_s)
    with redirect_stdout(sys.stderr) if is_stdout else nullcontext():
        finish(recording, as_json=as_json)


def decode(
    file: CaptureFile,
    *,
    out: Annotated[
        Path | None,
        Option("Write the points too: .npz, .ply, .csv, .pcd, .las or .laz by its suffix.", "FILE"),
    ] = None,
    pcap: Annotated[
        Path | None,
        Option("Write the packets as classic pcap, also those of a bag; no points then.", "FILE.pcap"),
    ] = None,
    unit: UnitName = None,
    clock: WhichClock = None,
    frame: Annotated[
        str,
        Option(
            "Axes of the points: x forward, y left, as ROS drivers have them (sensor); or x right, y "
            "forward, as the manual of Velodyne and VeloView do (manual).",
            words=("sensor", "manual"),
        ),
    ] = "sensor",
    model: Annotated[
        str | None,
        Option(
            "Sensor model of a prototype unit, whose packets name an HDL-32E (product 0x21).",
            words=("vlp-16", "puck-hi-res"),
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Decode a capture by the formulas of the sensor's manual.

    Works on recordings of real sensors too. Points are in metres in the sensor's frame: x forward (azimuth
    0), y left, z up, unless --frame chooses other axes. Pulses without return give no points. After Ctrl-C or
    a broken packet the file is valid and holds the points before it.
    """
    if pcap is not None:
        from vlp16emu.extras.replay import write_pcap

        if out is not None:
            raise InputError("--pcap", "found beside --out", "only one of the two")
        with stop_on_ctrl_c() as stop:
            result = write_pcap(file, pcap, unit, stop=stop)
        finish(result, as_json=as_json)
        return
    from vlp16emu.captures import CaptureReader, Survey, packet_clock
    from vlp16emu.packets import PointFrame
    from vlp16emu.types import SensorModel

    axes = PointFrame(frame)
    with Progress(100.0, "reading", unit="%") as bar:
        sensor = Survey(file, progress=partial(bar.show_share, "finding sensors")).chosen(
            unit, where="--unit"
        )
        product = SensorModel(model) if model else None
        unit_clock = packet_clock(file, sensor, clock, where="--clock", model=product)
        progress = partial(bar.show_share, "decoding")
        with stop_on_ctrl_c() as stop:
            reader = CaptureReader(file, sensor, product, unit_clock, stop=stop, progress=progress)
            _read_points(reader, file, out, axes, stop)
    interrupted = stop.is_set()
    title = f"{file}, interrupted" if interrupted else str(file)
    tree = {"file": file, "out": out} if as_json else {"wrote": out}
    finish(tree | dict(members(reader.summary)) | {"interrupted": interrupted}, title, as_json=as_json)


def _read_points(
    reader: "CaptureReader", file: Path, out: Path | None, axes: "PointFrame", stop: Event
) -> None:
    """Read a capture until its end or `stop`, and write its points into `out` unless it is None."""
    with ExitStack() as stack:
        writer = None
        if out:
            from vlp16emu.extras.clouds.cloud import (
                CAPTURE_COLUMNS,
                CloudMetadata,
                capture_comments,
                point_file,
            )

            metadata = CloudMetadata(capture_comments(axes, reader.clock.clock.whose))
            points = point_file(out, CAPTURE_COLUMNS, metadata, where=f"--out {out}", inputs=[file])
            writer = stack.enter_context(points)
        try:
            for table in reader.tables():
                if writer:
                    for begin in range(0, len(table), _BLOCK_PACKETS):
                        writer.write(reader.columns(table[begin : begin + _BLOCK_PACKETS], axes))
                if stop.is_set():
                    break
        except CaptureError:
            if stop.is_set() and not reader.first_stamp_ns:  # a pipe without data
                raise KeyboardInterrupt from None
            raise
