"""`vlp16emu decode`: a capture into numbers and points."""

from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vlp16emu.cli.arguments import AsJson, CaptureFile, one_of, option
from vlp16emu.cli.terminal import INTERRUPTED, count, print_json, print_rows, stop_on_ctrl_c

if TYPE_CHECKING:
    from vlp16emu.packets import CaptureReader, PointFrame, Summary


def decode(
    file: CaptureFile,
    *,
    out: Annotated[
        Path | None,
        option("--out", "Write the points too: .npz, .ply, .csv, .pcd, .las or .laz by its suffix.", "FILE"),
    ] = None,
    unit: Annotated[
        str | None,
        option(
            "--unit",
            "Which sensor, where the capture holds several: its number, or its address and data port.",
            "N|ADDRESS:PORT",
        ),
    ] = None,
    frame: Annotated[
        str,
        option(
            "--frame",
            "Axes of the points: x forward, y left, as ROS drivers have them (sensor); or x right, y forward, as the manual "
            "of Velodyne and VeloView do (manual).",
            "sensor|manual",
        ),
    ] = "sensor",
    model: Annotated[
        str | None,
        one_of(
            "--model",
            "What a unit from before release is, whose packets name an HDL-32E (product 0x21).",
            "vlp-16",
            "puck-hi-res",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Decode a capture by the formulas of the sensor's manual.

    Works on recordings of real sensors too. Points are in metres in the sensor: x forward (azimuth 0), y left,
    z up, unless --frame chooses other axes. Pulses without return become no points. Ctrl-C and a packet at fault leave a
    valid file with the points before.
    """
    from vlp16emu.packets import CaptureReader, chosen_unit, frame_named
    from vlp16emu.types import SensorModel

    axes, chosen = frame_named(frame, where="--frame"), chosen_unit(file, unit, where="--unit")
    with CaptureReader(file, chosen, axes, SensorModel(model) if model else None) as reader, stop_on_ctrl_c() as stop:
        _read(reader, file, out, axes, stop)
    summary, interrupted = reader.summary, stop.is_set()
    if as_json:
        tree = {"file": str(file), "out": out and str(out)} | _tree(summary)
        print_json(tree | {"interrupted": interrupted})
    else:
        _print(file, out, summary, interrupted=interrupted)
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def _read(reader: "CaptureReader", file: Path, out: Path | None, axes: "PointFrame", stop: Event) -> None:
    """Read a capture until it ends or reading is to stop, and write its points where they are wanted."""
    with ExitStack() as stack:
        writer = None
        if out:
            from vlp16emu.extras.clouds.cloud import CAPTURE_COLUMNS, CloudAbout, capture_comments, point_file

            about = CloudAbout(capture_comments(axes))
            opened = point_file(out, CAPTURE_COLUMNS, about, where=f"--out {out}", inputs=[file])
            writer = stack.enter_context(opened)
        for chunk in reader.points():
            if writer:
                writer.write(chunk.columns)
            if stop.is_set():
                break


def _tree(summary: "Summary") -> dict[str, Any]:
    """Write the summary in the types of JSON."""
    gps, ranges_m = summary.gps, summary.range_m
    return {
        "model": summary.model,
        "return_mode": summary.return_mode,
        "rpm": round(summary.rpm, 2),
        "packets": summary.packets,
        "position_packets": summary.position_packets,
        "other_datagrams": summary.other_datagrams,
        "points": summary.points,
        "no_returns": summary.no_returns,
        "scans": summary.scans,
        "records_per_scan": summary.records_per_scan,
        "range_m": ranges_m and dict(zip(("min", "median", "max"), (round(r, 3) for r in ranges_m), strict=True)),
        "start_utc": _utc(summary.first_stamp_ns),
        "duration_s": summary.duration_s,
        "gps": gps and {"pps": gps.pps.name.lower(), "sentence": gps.sentence.decode("ascii", "replace").strip()},
        "cut": summary.cut,
        "repeats": summary.repeats,
    }


def _print(file: Path, out: Path | None, summary: "Summary", *, interrupted: bool) -> None:
    per_scan = f", {count(summary.records_per_scan)} records each" if summary.records_per_scan else ""
    gps = "no position packet"
    if summary.gps:
        sentence = summary.gps.sentence.decode("ascii", "replace").strip()
        gps = f"{summary.gps.pps.name.lower()}, {sentence or 'no sentence'}"
    low, middle, high = summary.range_m or (0.0, 0.0, 0.0)
    rows = {
        "sensor": f"{summary.model}, {summary.return_mode}, {summary.rpm:.1f} rpm",
        "time": f"{summary.duration_s:.3f} s from {_utc(summary.first_stamp_ns)}",
        "packets": f"{count(summary.packets)} data, {count(summary.position_packets)} position",
        "records": f"{count(summary.points)} points, {count(summary.no_returns)} without return",
        "scans": f"{summary.scans}{per_scan}",
        "range": f"{low:.3f} to {high:.3f} m, median {middle:.3f} m" if summary.points else "no return at all",
        "gps": gps,
    }
    if summary.other_datagrams:
        rows["passed over"] = f"{count(summary.other_datagrams)} datagrams of another length"
    if summary.repeats:
        rows["repeats"] = f"{count(summary.repeats)} packets that the capture has twice were left out"
    if summary.cut:
        rows["end"] = "in the middle of a packet, which was left out"
    if interrupted:
        rows["end"] = "interrupted"
    if out:
        rows["kept" if interrupted else "wrote"] = str(out)
    print_rows(str(file), rows)


def _utc(stamp_ns: int) -> str:
    """Write a capture's stamp, which has microseconds."""
    return (
        (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=stamp_ns // 1000)).isoformat().replace("+00:00", "Z")
    )
