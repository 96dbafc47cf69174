"""`vlp16emu images`: what a camera in the place of the sensor sees of a scene."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.printer import finish
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.extras.options import ImageOptions
from vlp16emu.options import Option


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
