"""`vlp16emu picture`: what a sensor saw, as a picture or a film."""

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.printer import finish
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import Progress, stop_on_ctrl_c
from vlp16emu.errors import InputError
from vlp16emu.extras.options import PictureLook
from vlp16emu.options import Option
from vlp16emu.run.options import Span

if TYPE_CHECKING:
    from threading import Event

    from vlp16emu.extras.viewer.picture import PictureRun


def picture(
    scene: args.SceneOrCapture,
    out: Annotated[
        Path,
        Option("File to write: .png, or as a film of the walk .gif or .mp4; overwritten if it exists.", name="OUT"),
    ],
    look: PictureLook,
    span: Span,
    *,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    trajectory: args.TrajectoryFile = None,
    as_json: args.AsJson = False,
) -> None:
    """Draw what a sensor sees of a scene, or saw in a capture: all of it at a slant, or one revolution.

    Points of whole revolutions add up; of a capture without --trajectory they are as in the sensor, of its first
    revolution. A film shows how they add up, or one revolution after the other, ten per second. Needs the extra 'picture'.
    """
    from vlp16emu.extras.plots import check_matplotlib

    check_matplotlib()
    from vlp16emu.extras.viewer.picture import check_suffix
    from vlp16emu.packets.capture import is_capture_name

    check_suffix(out)
    if look.from_deg is not None and look.view != "slant":
        raise InputError("--from", f"found beside --view {look.view}", "--view slant")
    is_capture = is_capture_name(scene)
    if trajectory is not None and not is_capture:
        raise InputError("--trajectory", "found beside a scene", "a capture")
    with stop_on_ctrl_c() as stop, Progress(0.0, "drawing"):
        if is_capture:
            made = _of_capture(Path(scene), trajectory, (span.start_s, span.duration_s), out, look, stop)
        else:
            made = _of_scene(scene, settings, (span.start_s, span.duration_s), out, look, stop, ideal=ideal)
    finish(made, as_json=as_json)


def _of_capture(
    capture: Path,
    trajectory: Path | None,
    span: tuple[float, float | None],
    out: Path,
    look: PictureLook,
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
    look: PictureLook,
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
    with emulator.engine.windows.stopped_by(stop):
        return draw_picture(sweeps, out, look, way_m=way_m, rings=rings, species=species, stop=stop, inputs=inputs)
