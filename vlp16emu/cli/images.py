"""`vlp16emu images`: what a camera in the place of the sensor sees of a scene."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import finite, pixels
from vlp16emu.cli.printer import finish
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.options import Option
from vlp16emu.run.options import Span, WhichUnit


def images(
    scene: args.SceneName,
    folder: Annotated[Path, Option("Folder, new or empty.", name="OUT")],
    span: Span,
    *,
    kind: Annotated[str, Option("panorama, all around; or pinhole, towards azimuth 0.", "KIND")] = "panorama",
    size_px: Annotated[
        object | None,
        Option(
            "Pixels; 2048x512 of a panorama, 1024x768 of a pinhole camera if left out.",
            "WxH",
            parse=pixels,
            expected="width and height in pixels, such as 2048x512",
        ),
    ] = None,
    fov_deg: Annotated[
        float | None,
        Option(
            "Field of view of a pinhole camera, from left to right; 90 if left out.",
            "DEG",
            parse=finite,
            expected="a number of degrees",
        ),
    ] = None,
    every_s: Annotated[
        float, Option("Simulated seconds from image to image.", "S", parse=finite, expected="a number of seconds")
    ] = 1.0,
    settings: args.Settings = None,
    unit: WhichUnit = 1,
    threads: args.Threads = 0,
    as_json: args.AsJson = False,
) -> None:
    """Write depth, labels and colours of a scene as images, from the place of the sensor.

    They lie on the points of `vlp16emu points` and `record` at the same instant: cameras.json and poses.tum
    say where each point is in the image. PNG, and OpenEXR with exact values. Ctrl-C keeps the images so far.
    """
    emulator = make_emulator(scene, settings, threads=threads)
    from vlp16emu.extras.images.images import write_images

    with running(emulator, "casting", span) as hooks:
        camera = {"kind": kind, "size": size_px, "fov_deg": fov_deg, "every_s": every_s}
        run = write_images(emulator, folder, **camera, unit=unit, **vars(span), **hooks)  # type: ignore[arg-type]
    finish(run, as_json=as_json)
