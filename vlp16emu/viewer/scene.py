"""The page of a scene: grown and drawn, and again whenever its stand is changed."""

from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event

import viser

from vlp16emu.emulator import Emulator
from vlp16emu.motion.settings import Walk
from vlp16emu.report.forest.survey import Survey, survey, way_m
from vlp16emu.scenario import Scenario
from vlp16emu.viewer.draft import Draft
from vlp16emu.viewer.editor import Editor
from vlp16emu.viewer.page import Page, draw_stand
from vlp16emu.viewer.planter import Planter
from vlp16emu.viewer.stand import pieces_of
from vlp16emu.viewer.sweeps import SceneSweeps
from vlp16emu.world.stand.forest import ForestWorld


class ScenePage:
    """A scene, grown and drawn; of one that walks, path and stand can be drawn anew.

    Parameters
    ----------
    scene, settings : that the emulator is of
    unit : of a rig, from 1
    radius_m : how far from the path its stand is drawn
    save : file for what is drawn; None where nothing is to be saved
    progress : called with the share of the first stand that has grown

    Raises
    ------
    InputError
        where there is no such unit, or the stand cannot be grown
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: str,
        emulator: Emulator,
        *,
        settings: Sequence[str] = (),
        unit: int = 1,
        radius_m: float = 25.0,
        save: Path | None = None,
        progress: Callable[[float], None] = lambda _: None,
    ) -> None:
        self._server, self._unit, self._radius_m = server, unit, radius_m
        self._text = server.gui.add_markdown("growing the world")
        self._root: viser.FrameHandle | None = None
        seen, scenario, editor = self._grow(emulator, progress), emulator.scenario, None
        if isinstance(scenario.motion, Walk):
            draft = Draft(scene, scenario, seen, settings)
            editor = Editor(server, draft, scenario.duration_s, save)
            if draft.world:
                Planter(server, draft, editor, scenario.world, self._grow_again)
        self._page = Page(server, SceneSweeps(emulator, unit), seen.species, self._root, editor)

    def run(self, stop: Event) -> None:
        """Draw what is wanted, until the end."""
        self._page.run(stop)

    def _grow(self, emulator: Emulator, progress: Callable[[float], None] = lambda _: None) -> Survey:
        """Grow what an emulator has along its path, and draw it in place of what was there."""
        scenario, parts = emulator.scenario, emulator.parts
        bare = getattr(parts.world, "bare", parts.world)
        for share in bare.growing(way_m(scenario, parts.motion)) if isinstance(bare, ForestWorld) else ():
            progress(share)
            self._text.content = f"growing the world, {share:.0%} of its tiles"
        seen = survey(scenario, min(self._radius_m, scenario.sensor.max_range_m), parts)
        if self._root is not None:
            self._root.remove()
        self._root = draw_stand(self._server, pieces_of(seen), seen.path_m, hall=seen.hall is not None)
        self._text.content = ""
        return seen

    def _grow_again(self, scenario: Scenario) -> Survey:
        """Grow another stand, and turn the page to it."""
        emulator = Emulator(scenario)
        seen = self._grow(emulator)
        self._page.turn_to(SceneSweeps(emulator, self._unit), seen.species, self._root)
        return seen
