"""`vlp16emu view`: a page in the browser with the stand, the path and what the sensor sees."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli.arguments import SceneOrCapture, Settings
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import Progress
from vlp16emu.errors import InputError, MissingExtraError
from vlp16emu.options import Option
from vlp16emu.run.options import WhichUnit

if TYPE_CHECKING:
    import viser


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
    from vlp16emu.motion.settings import takes_poses

    emulator = make_emulator(scene, settings)
    if takes_poses(emulator.scenario.motion):
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
