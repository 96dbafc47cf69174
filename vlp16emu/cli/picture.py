"""`vlp16emu picture`: what a sensor saw, as a picture or a film."""

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import argument, checked, one_of, option, pixels
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import count, finish, size, stop_on_ctrl_c, tree_of
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from threading import Event

    from vlp16emu.extras.viewer.picture import PictureLook, PictureRun


_LARGEST_PX, _FROM_DEG = 8_192, 205.0


def picture(
    scene: args.SceneOrCapture,
    out: Annotated[
        Path, argument("OUT", "File to write: .png, or as a film of the walk .gif or .mp4; overwritten if it exists.")
    ],
    *,
    colour: Annotated[
        str | None,
        option(
            "--colour",
            "natural, class, part, species, instance, range, reflectivity, ring or time; the last four of a capture.",
            "LAYER",
            shown="natural, of a capture reflectivity",
        ),
    ] = None,
    view: Annotated[
        str,
        one_of(
            "--view",
            "slant, of points that add up; sweep, a revolution from straight above with circles of range; or image, a"
            " revolution as rows of lasers over azimuth.",
            "slant",
            "sweep",
            "image",
        ),
    ] = "slant",
    look_from: Annotated[
        float | None,
        option(
            "--from",
            "Where the eye is, clockwise from north, of --view slant.",
            "DEG",
            checked("--from", float, lambda deg: 0 <= deg < 360, "a number from 0 to 360"),
            shown="205",
        ),
    ] = None,
    image_size: Annotated[str, option("--size", "Of the picture, in pixels.", "WxH")] = "1280x720",
    duration: args.Duration = None,
    start: args.Start = 0.0,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    trajectory: args.TrajectoryFile = None,
    as_json: args.AsJson = False,
) -> None:
    """Draw what a sensor sees of a scene, or saw in a capture: all of it at a slant, or one revolution.

    Points of whole revolutions add up; of a capture without --trajectory they are as in the sensor, of its first
    revolution. A film shows how they add up, or one revolution after the other, ten per second. Needs the extra 'picture'.
    """
    from vlp16emu.extras.viewer.picture import PictureLook
    from vlp16emu.packets.capture import is_capture_name

    if look_from is not None and view != "slant":
        raise InputError("--from", f"found beside --view {view}", "--view slant")

    is_capture = is_capture_name(scene)
    if trajectory is not None and not is_capture:
        raise InputError("--trajectory", "found beside a scene", "a capture")
    colour = colour or ("reflectivity" if is_capture else "natural")
    expected = f"WIDTHxHEIGHT, even numbers from 64 to {_LARGEST_PX}"
    size_px = pixels(image_size, expected, lambda n: 64 <= n <= _LARGEST_PX and n % 2 == 0)
    look = PictureLook(colour, _FROM_DEG if look_from is None else look_from, size_px, view)
    with stop_on_ctrl_c() as stop:
        if is_capture:
            made = _of_capture(Path(scene), trajectory, (start, duration), out, look, stop)
        else:
            made = _of_scene(scene, settings, (start, duration), out, look, stop, ideal=ideal)
    rows = {
        "revolutions": count(made.revolutions),
        "points": f"{count(made.points)}, by {made.colour}",
        "size": size(made.bytes),
    }
    finish(tree_of(made), made.file, rows, as_json=as_json)


def _of_capture(
    capture: Path,
    trajectory: Path | None,
    span: tuple[float, float | None],
    out: Path,
    look: "PictureLook",
    stop: "Event",
) -> "PictureRun":
    """Draw a capture; without poses its first revolution, or as a film all of them."""
    from vlp16emu.extras.viewer.picture import draw_picture, sweeps_of_capture, way_of
    from vlp16emu.packets.layout import LASERS

    is_film = out.suffix.lower() != ".png"
    sweeps = sweeps_of_capture(capture, trajectory, *span)
    if trajectory is None and not is_film:
        sweeps = islice(sweeps, 1)
    way_m, inputs = way_of(trajectory), [capture, *([trajectory] if trajectory else [])]
    return draw_picture(sweeps, out, look, way_m=way_m, rings=LASERS, species={}, stop=stop, inputs=inputs)


def _of_scene(
    scene: str,
    settings: list[str] | None,
    span: tuple[float, float | None],
    out: Path,
    look: "PictureLook",
    stop: "Event",
    *,
    ideal: bool,
) -> "PictureRun":
    import numpy as np

    from vlp16emu.extras.images.images import species_of
    from vlp16emu.extras.viewer.picture import draw_picture
    from vlp16emu.extras.viewer.sweeps import sweeps_of_scene

    emulator = make_emulator(scene, settings, ideal=ideal)
    start_s, stop_s = emulator.scenario.span_s(*span, where="--start")
    t_ns = emulator.scenario.start_ns + (np.linspace(start_s, stop_s, 200) * 1e9).astype(np.int64)
    way_m = emulator.parts.motion.poses_at(t_ns).world_p_body_m
    species, rings = species_of(emulator.parts.world), len(emulator.parts.units[0].head.beams.elevation_deg)
    sweeps, inputs = sweeps_of_scene(emulator, *span), emulator.run.files
    return draw_picture(sweeps, out, look, way_m=way_m, rings=rings, species=species, stop=stop, inputs=inputs)
