"""Verbs that show what a sensor sees: picture and view."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import SceneOrCapture, Settings
from vlp16emu.cli.printer import finish
from vlp16emu.cli.terminal import Progress, make_emulator, stop_on_ctrl_c
from vlp16emu.errors import InputError, MissingExtraError
from vlp16emu.extras.options import PictureLook
from vlp16emu.options import Option
from vlp16emu.run.options import Span, WhichUnit

if TYPE_CHECKING:
    import viser


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
    from vlp16emu.extras.viewer.picture import check_suffix, draw_picture, source_of_capture, source_of_scene
    from vlp16emu.packets.capture import is_capture_name

    check_suffix(out)
    if look.from_deg is not None and look.view != "slant":
        raise InputError("--from", f"found beside --view {look.view}", "--view slant")
    is_capture = is_capture_name(scene)
    if trajectory is not None and not is_capture:
        raise InputError("--trajectory", "found beside a scene", "a capture")
    with ExitStack() as stack:
        stop, _ = stack.enter_context(stop_on_ctrl_c()), stack.enter_context(Progress(0.0, "drawing"))
        if is_capture:
            is_film = out.suffix.lower() != ".png"
            source = source_of_capture(Path(scene), trajectory, span, whole=is_film or trajectory is not None)
        else:
            emulator = make_emulator(scene, settings, ideal=ideal)
            source = source_of_scene(emulator, span)
            stack.enter_context(emulator.engine.windows.stopped_by(stop))
        made = draw_picture(source, out, look, stop)
    finish(made, as_json=as_json)


def view(
    scene: SceneOrCapture,
    *,
    settings: Settings = None,
    unit: WhichUnit = 1,
    truth: Annotated[
        Path | None,
        Option(
            "Of a capture: what `record --truth DIR --truth-returns` has written beside it, for places in the world and labels.",
            "DIR",
        ),
    ] = None,
    save: Annotated[
        Path | None,
        Option("File to which the page saves the scene with the path drawn in it; comments stay.", "OUT.toml"),
    ] = None,
    radius_m: Annotated[float, Option("How far from the path the stand is drawn.", "M", ge=1, le=100)] = 25.0,
    host: Annotated[
        str, Option("Address of this machine to listen on; others can then see the page.", "ADDRESS")
    ] = "127.0.0.1",
    port: Annotated[int, Option("Port of the page, 0 for any that is free.", "N", ge=0, le=65_535)] = 8016,
) -> None:
    """Show a scene in the browser: the stand, the path, and the sweep at any time; draw the path anew.

    Of a capture its sweeps, with what is wrong with its packets marked. Needs the extra 'viewer'. Ctrl-C ends it.
    """
    from vlp16emu.packets.capture import is_capture_name

    capture = Path(scene) if is_capture_name(scene) else None
    if save is not None and (settings or capture):
        raise InputError("--save", "found beside --set or a capture", "a scene as its file has it")
    if truth is not None and capture is None:
        raise InputError("--truth", "found beside a scene", "a capture; a scene knows its own")
    try:
        from vlp16emu.extras.viewer.guard import guarded_server
    except ImportError as error:
        raise MissingExtraError(error.name or "viser", "viewer", "the page in the browser") from None
    with guarded_server(host, port, "vlp16emu") as server:
        print(f"http://{host}:{server.get_port()}/  Ctrl-C ends it", flush=True)
        if capture is not None:
            _show_capture(server, capture, truth, unit)
        else:
            _show_scene(server, scene, settings, unit, radius_m, save)


def _show_capture(server: "viser.ViserServer", capture: Path, truth: Path | None, unit: int) -> None:
    import numpy as np

    from vlp16emu.extras.viewer.page import Page, look_from
    from vlp16emu.extras.viewer.sweeps import CaptureSweeps

    text = server.gui.add_markdown("reading the capture")
    with closing(CaptureSweeps(capture, truth, unit)) as sweeps:
        text.content = "  \n".join(sweeps.health or ["packets as a sensor sends them"])
        pose = sweeps.at(0.0).scan.world_T_sensor
        world_T_sensor = np.eye(4) if pose is None else pose
        look_from(server, world_T_sensor[:3, 3], world_T_sensor[:3, 0])
        Page(server, sweeps, sweeps.species).run()


def _show_scene(
    server: "viser.ViserServer", scene: str, settings: list[str] | None, unit: int, radius_m: float, save: Path | None
) -> None:
    from vlp16emu.extras.viewer.page import scene_page

    emulator = make_emulator(scene, settings)
    if emulator.scenario.motion.takes_poses:
        raise InputError("motion.kind", "found live", "a scene whose path is known before it runs")
    with Progress(100.0) as bar:
        page = scene_page(
            server,
            scene,
            emulator,
            unit=unit,
            radius_m=radius_m,
            save=save,
            progress=lambda share: bar.show("growing the world, % of tiles", 100 * share),
        )
    page.run()
