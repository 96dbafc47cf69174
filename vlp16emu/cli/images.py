"""`vlp16emu images`: what a camera in the place of the sensor sees of a scene."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vlp16emu.cli.arguments import AsJson, Duration, SceneName, Settings, Start, Threads, WhichUnit, checked
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import INTERRUPTED, Progress, count, print_json, print_rows, size, stop_on_ctrl_c, tree_of
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.extras.images.images import ImageRun


Folder = Annotated[Path, typer.Argument(metavar="OUT", help="Folder, new or empty.", show_default=False)]
Kind = Annotated[
    str, typer.Option("--kind", metavar="KIND", help="panorama, all around; or pinhole, towards azimuth 0.")
]
Size = Annotated[
    str | None,
    typer.Option(
        "--size", metavar="WxH", help="Pixels; 2048x512 of a panorama, 1024x768 of a pinhole camera if left out."
    ),
]
FieldOfView = Annotated[
    float | None,
    typer.Option(
        "--fov",
        metavar="DEG",
        parser=checked("--fov", float, math.isfinite, "a number of degrees"),
        help="Of a pinhole camera, from left to right; 90 if left out.",
    ),
]
Every = Annotated[
    float,
    typer.Option(
        "--every",
        metavar="S",
        parser=checked("--every", float, math.isfinite, "a number of seconds"),
        help="Simulated seconds from image to image.",
    ),
]


def images(
    scene: SceneName,
    folder: Folder,
    *,
    kind: Kind = "panorama",
    pixels: Size = None,
    fov: FieldOfView = None,
    every: Every = 1.0,
    duration: Duration = None,
    start: Start = 0.0,
    settings: Settings = None,
    unit: WhichUnit = 1,
    threads: Threads = 0,
    as_json: AsJson = False,
) -> None:
    """Write depth, labels and colours of a scene as images, from the place of the sensor.

    They lie on the points of `vlp16emu points` and `record` at the same instant: cameras.json and poses.tum
    say where each point is in the image. PNG, and OpenEXR with exact values. Ctrl-C keeps the images so far.
    """
    wanted_px = None if pixels is None else _size(pixels)
    emulator = make_emulator(scene, settings, threads=threads)
    from vlp16emu.extras.images.images import write_images

    start_s, stop_s = emulator.scenario.span_s(start, duration, where="--start")
    with stop_on_ctrl_c() as stop, Progress(stop_s - start_s) as progress:
        run = write_images(
            emulator,
            folder,
            kind=kind,
            size=wanted_px,
            fov_deg=fov,
            every_s=every,
            start_s=start,
            duration_s=duration,
            unit=unit,
            progress=lambda done_s: progress.show("casting", done_s),
            stop=stop,
        )
    if as_json:
        print_json(tree_of(run))
    else:
        _print(run)
    if run.interrupted:
        raise typer.Exit(INTERRUPTED)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InputError("--size", f"found {text}", "width and height in pixels, such as 2048x512")
    return int(width), int(height)


def _print(run: "ImageRun") -> None:
    print_rows(
        f"{'interrupted, kept' if run.interrupted else 'wrote'} {run.folder}",
        {
            "scene": run.scene,
            "camera": f"{run.kind}, {run.width} x {run.height} pixels, in the place of sensor {run.unit}",
            "images": count(run.images),
            "size": size(run.bytes),
        },
    )
