"""`vlp16emu images`: what a camera in the place of the sensor sees of a scene."""

import math
from pathlib import Path
from typing import Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import argument, checked, option, pixels
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.cli.terminal import count, finish, size, tree_of


def images(
    scene: args.SceneName,
    folder: Annotated[Path, argument("OUT", "Folder, new or empty.")],
    *,
    kind: Annotated[str, option("--kind", "panorama, all around; or pinhole, towards azimuth 0.", "KIND")] = "panorama",
    image_size: Annotated[
        str | None, option("--size", "Pixels; 2048x512 of a panorama, 1024x768 of a pinhole camera if left out.", "WxH")
    ] = None,
    fov: Annotated[
        float | None,
        option(
            "--fov",
            "Of a pinhole camera, from left to right; 90 if left out.",
            "DEG",
            checked("--fov", float, math.isfinite, "a number of degrees"),
        ),
    ] = None,
    every: Annotated[
        float,
        option(
            "--every",
            "Simulated seconds from image to image.",
            "S",
            checked("--every", float, math.isfinite, "a number of seconds"),
        ),
    ] = 1.0,
    duration: args.Duration = None,
    start: args.Start = 0.0,
    settings: args.Settings = None,
    unit: args.WhichUnit = 1,
    threads: args.Threads = 0,
    as_json: args.AsJson = False,
) -> None:
    """Write depth, labels and colours of a scene as images, from the place of the sensor.

    They lie on the points of `vlp16emu points` and `record` at the same instant: cameras.json and poses.tum
    say where each point is in the image. PNG, and OpenEXR with exact values. Ctrl-C keeps the images so far.
    """
    expected = "width and height in pixels, such as 2048x512"
    wanted_px = None if image_size is None else pixels(image_size, expected)
    emulator = make_emulator(scene, settings, threads=threads)
    from vlp16emu.extras.images.images import write_images

    with running(emulator, "casting", start, duration) as span:
        run = write_images(emulator, folder, kind=kind, size=wanted_px, fov_deg=fov, every_s=every, unit=unit, **span)
    rows = {
        "scene": run.scene,
        "camera": f"{run.kind}, {run.width} x {run.height} pixels, in the place of sensor {run.unit}",
        "images": count(run.images),
        "size": size(run.bytes),
    }
    finish(tree_of(run), run.folder, rows, as_json=as_json)
