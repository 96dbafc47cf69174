"""`vlp16emu decode`: a capture into numbers and points."""

from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

from vlp16emu.cli.arguments import AsJson, CaptureFile, UnitName, WhichClock
from vlp16emu.cli.printer import finish
from vlp16emu.cli.terminal import stop_on_ctrl_c
from vlp16emu.options import Option

if TYPE_CHECKING:
    from vlp16emu.packets import CaptureReader, PointFrame, Summary


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


def _tree(summary: "Summary") -> dict[str, Any]:
    """Return what a capture holds."""
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
        "clock": summary.clock,
        "host_ahead_s": round(summary.host_ahead_s, 6),
        "gps": gps and {"pps": gps.pps.name.lower(), "sentence": gps.sentence.decode("ascii", "replace").strip()},
        "cut": summary.cut,
        "repeats": summary.repeats,
    }


def _utc(stamp_ns: int) -> str:
    """Write the stamp of a capture, which has microseconds."""
    at = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=stamp_ns // 1000)
    return at.isoformat().replace("+00:00", "Z")
